//! The two tables: how well it localizes, and how much it leaks.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use super::format::{degrees, escape, length, milliseconds, percent, pixels, scheme_words};
use veiloc_audit::{Attack, AttackSummary, capital};
use veiloc_results::{STAGES, SchemeSummary};

pub(super) fn localization(rows: &[SchemeSummary]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let mut thresholds: Vec<&String> =
        rows.iter().flat_map(|r| r.recall.keys()).collect::<BTreeSet<_>>().into_iter().collect();
    let key = |t: &str| t.split_once('/').and_then(|(d, _)| d.parse::<f64>().ok()).unwrap_or(f64::INFINITY);
    thresholds.sort_by(|a, b| key(a).total_cmp(&key(b)).then(a.cmp(b)));
    let several_scores = rows.iter().any(|a| rows.iter().any(|b| a.scheme == b.scheme && a.score != b.score));
    let mut out = String::from(
        "<section><h2>How well cameras are found</h2>\
         <p>Each hidden view was sent under every scheme, and the server answered where the camera stood. \
         Errors are measured against the true pose; a view that was not localized counts as infinitely wrong.</p>\
         <div class=\"scroll\"><table><thead><tr><th>Scheme</th><th>Localized</th><th>Position error<br>(median)</th>\
         <th>Rotation error<br>(median)</th>",
    );
    for t in &thresholds {
        let _ = write!(out, "<th>Within<br>{}</th>", threshold_words(t));
    }
    out.push_str("<th>Agreeing<br>matches</th><th>Query size</th></tr></thead><tbody>");
    for row in rows {
        let (name, what) = scheme_words(&row.scheme);
        let score = if several_scores { format!(" · {}", escape(&row.score)) } else { String::new() };
        let _ = write!(
            out,
            "<tr><th>{name}{score}<small>{what}</small></th><td>{} of {}</td><td>{}</td><td>{}</td>",
            row.localized,
            row.queries,
            length(row.median_translation),
            degrees(row.median_rotation_deg)
        );
        for t in &thresholds {
            let share = row.recall.get(*t).copied();
            let _ = write!(out, "<td>{}{}</td>", percent(share), bar(share));
        }
        let bytes = row.sealed_bytes.map_or_else(|| "–".to_owned(), |b| format!("{:.1} kB", b as f64 / 1e3));
        let _ = write!(out, "<td>{}</td><td>{bytes}</td></tr>", percent(row.mean_inlier_ratio));
    }
    out.push_str("</tbody></table></div>");
    out.push_str(&stage_times(rows, several_scores));
    out.push_str("</section>");
    out
}

fn stage_times(rows: &[SchemeSummary], several_scores: bool) -> String {
    let known: BTreeSet<&String> = rows.iter().flat_map(|r| r.median_ms.keys()).collect();
    // As a query goes through them; what is not on that road comes last.
    let place = |stage: &str| STAGES.iter().position(|s| *s == stage).unwrap_or(STAGES.len());
    let mut stages: Vec<&String> = known.into_iter().collect();
    stages.sort_by_key(|stage| place(stage));
    if stages.is_empty() {
        return String::new();
    }
    let mut out = String::from(
        "<h3>Time per query, median</h3><div class=\"scroll\"><table><thead><tr><th>Scheme</th>",
    );
    for stage in &stages {
        let _ = write!(out, "<th>{}</th>", escape(stage));
    }
    out.push_str("</tr></thead><tbody>");
    for row in rows {
        let score = if several_scores { format!(" · {}", escape(&row.score)) } else { String::new() };
        let _ = write!(out, "<tr><th>{}{score}</th>", scheme_words(&row.scheme).0);
        for stage in &stages {
            let _ = write!(out, "<td>{}</td>", milliseconds(row.median_ms.get(*stage).copied()));
        }
        out.push_str("</tr>");
    }
    out.push_str("</tbody></table></div>");
    out
}

/// `"0.05/5"` as `5.0 cm, 5°`.
fn threshold_words(key: &str) -> String {
    let parsed = key.split_once('/').and_then(|(t, d)| Some((t.parse().ok()?, d.parse::<f64>().ok()?)));
    match parsed {
        Some((t, d)) => format!("{}, {d}°", length(Some(t)).replace(".0 ", " ").replace(".00 ", " ")),
        None => escape(key),
    }
}

fn bar(share: Option<f64>) -> String {
    let width = share.filter(|s| s.is_finite()).unwrap_or(0.0).clamp(0.0, 1.0);
    format!("<span class=\"bar\"><i style=\"width:{:.0}%\"></i></span>", 100.0 * width)
}

pub(super) fn attacks(rows: &[AttackSummary]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let mut out = String::from(
        "<section><h2>What an attacker learns</h2>\
         <p>The attacker sees what the server sees and tries to put every keypoint back into the image. \
         To be on the safe side it is told which keypoints are neighbours. \
         The guess uses nothing but the single line: an attack is only worth something where it beats the guess.</p>\
         <div class=\"scroll attacks\"><table><thead><tr><th>Scheme</th><th>Attack</th><th>Mean error</th><th>Median error</th>\
         <th>Recovered to<br>within 30 px</th><th>Learned beyond<br>the guess</th><th>Images</th><th>Time a<br>image</th>\
         </tr></thead><tbody>",
    );
    let mut last = None;
    for row in rows {
        let guess = row.attack == Attack::PRIOR;
        let group = last.is_some_and(|l| l != &row.scheme);
        let name = if last == Some(&row.scheme) { String::new() } else { scheme_words(&row.scheme).0 };
        last = Some(&row.scheme);
        let class = match (guess, group) {
            (true, true) => " class=\"guess group\"",
            (true, false) => " class=\"guess\"",
            (false, true) => " class=\"group\"",
            (false, false) => "",
        };
        let leak = if !guess && row.under_30px > 0.5 { " class=\"leak\"" } else { "" };
        let bits = Some(row.bits_over_prior).filter(|b| b.is_finite() && !guess);
        let _ = write!(
            out,
            "<tr{class}><th>{name}</th><td>{}</td><td>{}</td><td>{}</td><td{leak}>{}{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            escape(&capital(row.attack.words)),
            pixels(row.mean_px),
            pixels(row.median_px),
            percent(Some(row.under_30px)),
            bar(Some(row.under_30px)),
            bits.map_or_else(|| "–".to_owned(), |b| format!("{b:+.1} bits")),
            row.images,
            milliseconds(Some(row.ms)),
        );
    }
    out.push_str(
        "</tbody></table></div><p class=\"note\">One bit more than the guess halves the attacker's error; a negative \
         number means that the attack did worse than guessing. A large error therefore shows that this attack fails, \
         not that no attack can succeed.</p></section>",
    );
    out
}
