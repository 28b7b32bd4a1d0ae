//! The two text tables: poses of single frames, and leakage of several frames.

use crate::results::text_table::{TextTable, length, percent};

use super::document::{SessionRow, SessionsDocument};

/// Single frames by scheme and anchors, then the attacks; bits for each number of frames side by side.
pub fn table(document: &SessionsDocument) -> String {
    let missing = || "\u{2014}".to_owned();
    let thresholds: Vec<&String> =
        document.frames.first().map_or_else(Vec::new, |f| f.summary.recall.keys().collect());
    let mut head =
        ["scheme", "anchors", "gyro °", "drift °", "starts", "keypoints", "trusted", "rot °", "trans"]
            .map(str::to_owned)
            .to_vec();
    head.extend(thresholds.iter().map(|t| format!("≤{t} %")));
    let mut singles = TextTable::new(head, 2);
    for f in &document.frames {
        let s = &f.summary;
        let mut row = vec![
            s.scheme.clone(),
            f.condition.anchors.to_string(),
            f.condition.gyro_deg.to_string(),
            f.condition.drift_deg.to_string(),
            f.starts.to_string(),
            format!("{:.0}", f.keypoints),
            format!("{}/{}", s.trusted.unwrap_or(0), s.queries),
            s.median_rotation_deg.map_or_else(missing, |x| format!("{x:.3}")),
            s.median_translation.map_or_else(missing, length),
        ];
        row.extend(thresholds.iter().map(|t| s.recall.get(*t).map_or_else(missing, |r| percent(*r))));
        singles.push(row);
    }

    let mut counts: Vec<usize> = document.rows.iter().map(|r| r.frames).collect();
    counts.sort_unstable();
    counts.dedup();
    let mut head = ["scheme", "anchors", "motion", "gyro °", "drift °", "of", "by", "keypoints", "prior px"]
        .map(str::to_owned)
        .to_vec();
    head.extend(counts.iter().flat_map(|n| [format!("{n}: bits"), "px".to_owned()]));
    let mut attacks = TextTable::new(head, 7);
    let mut rest: &[SessionRow] = &document.rows;
    while let Some(first) = rest.first() {
        let same = rest.iter().take_while(|r| r.is_like(first)).count();
        let (group, others) = rest.split_at(same.max(1));
        rest = others;
        let mut row = vec![
            first.scheme.clone(),
            first.condition.anchors.to_string(),
            first.motion.to_string(),
            first.condition.gyro_deg.to_string(),
            first.condition.drift_deg.to_string(),
            first.target.word().to_owned(),
            first.method.word().to_owned(),
            first.keypoints.to_string(),
            first.prior_median_px.map_or_else(missing, |x| format!("{x:.0}")),
        ];
        for count in &counts {
            let of = group.iter().find(|r| r.frames == *count);
            row.push(of.and_then(|r| r.bits_over_prior).map_or_else(missing, |x| format!("{x:+.2}")));
            row.push(of.and_then(|r| r.median_px).map_or_else(missing, |x| format!("{x:.0}")));
        }
        attacks.push(row);
    }
    format!(
        "Single frames of the trajectory, each localized from its sealed bytes.\n\n{}\n\
         Leakage of several frames: bits per keypoint over the prior-only baseline, and median error, by number of frames.\n\n{}",
        singles.render(),
        attacks.render()
    )
}
