//! Gains of adversaries as a text table: realistic adversaries first, an oracle last.

use crate::results::text_table::{TextTable, percent};

use super::adversary::Adversary;
use super::document::{AdversariesDocument, AdversaryRow};

/// One table per scene or file, followed by the adversaries' knowledge.
pub fn adversaries_table(document: &AdversariesDocument) -> String {
    let mut data: Vec<&str> = Vec::new();
    for row in &document.rows {
        if !data.contains(&row.data.as_str()) {
            data.push(&row.data);
        }
    }
    let tables: Vec<String> = data.iter().map(|data| of_data(document, data)).collect();
    let there = |a: &Adversary| document.rows.iter().any(|row| row.adversary == a.name());
    let missing: Vec<&str> = document.missing.iter().map(|a| a.name()).collect();
    let knows: Vec<String> = (Adversary::ALL.iter().filter(|a| there(a)))
        .map(|a| format!("{:<22} {}\n", a.name(), a.knows()))
        .collect();
    let knows = knows.concat();
    let missing = if missing.is_empty() {
        String::new()
    } else {
        format!("Skipped, because their resources are missing: {}.\n", missing.join(", "))
    };
    format!(
        "{}\nEach adversary with its best attack; prior and median in pixels, prior: the best answer from the single line.\n\
         For servers with the pose, errors are measured on keypoints that their map does not show, or on a private\n\
         region of the image.\n\n{knows}{missing}",
        tables.join("\n")
    )
}

fn of_data(document: &AdversariesDocument, data: &str) -> String {
    let head = ["adversary", "scheme", "attack", "true", "prior", "median", "< 10 px", "< 30 px", "bits"];
    let mut table = TextTable::new(head, 3);
    let rows = || document.rows.iter().filter(|row| row.data == data);
    let mut last = "";
    for row in rows() {
        table.push(cells(row, row.adversary == last));
        last = row.adversary;
    }
    let images = rows().map(|row| row.images).max().unwrap_or(0);
    let auc = |row: &AdversaryRow| {
        let auc = row.hiding_auc?;
        Some(format!(
            "{}, {}: AUC of private rows among unexplained ones: {auc:.2}\n",
            row.adversary, row.scheme
        ))
    };
    format!(
        "{data}, {images} images attacked\n{}{}",
        table.render(),
        rows().filter_map(auc).collect::<String>()
    )
}

fn cells(row: &AdversaryRow, again: bool) -> Vec<String> {
    let frames = row.frames.map_or_else(String::new, |n| format!(", {n}"));
    vec![
        if again { String::new() } else { row.adversary.to_owned() },
        row.scheme.clone(),
        format!("{}{frames}", row.attack),
        row.precision.map_or_else(String::new, percent),
        format!("{:.1}", row.prior_median_px),
        format!("{:.1}", row.median_px),
        percent(row.under_10px),
        percent(row.under_30px),
        format!("{:+.2}", row.bits_over_prior),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(data: &str, adversary: Adversary, scheme: &str, frames: Option<usize>) -> AdversaryRow {
        AdversaryRow {
            data: data.to_owned(),
            adversary: adversary.name(),
            realistic: adversary.is_realistic(),
            scheme: scheme.to_owned(),
            attack: if frames.is_some() { "several-frames" } else { "closed-form-consensus" }.to_owned(),
            frames,
            images: 3,
            measured: 1.0,
            precision: frames.is_none().then_some(0.045),
            prior_median_px: 101.5,
            median_px: 148.25,
            under_10px: 0.03,
            under_30px: 0.102,
            bits_over_prior: -0.61,
            hiding_auc: None,
            attacks: Vec::new(),
        }
    }

    #[test]
    fn table_has_all_rows_and_lists_missing_adversaries() {
        let rows = vec![
            row("kitchen", Adversary::QueryOnlyStatistic, "coordinate-permutation", None),
            row("kitchen", Adversary::QueryOnlyStatistic, "dcl", None),
            row("kitchen", Adversary::SeveralFrames, "dcl", Some(8)),
            row("photos", Adversary::QueryOnlyStatistic, "dcl", None),
            AdversaryRow {
                hiding_auc: Some(0.951),
                ..row("photos", Adversary::PoseServerPrivate, "dcl", None)
            },
        ];
        let missing = vec![Adversary::QueryOnlyNeighbours, Adversary::MapServer];
        let document =
            AdversariesDocument { version: 1, command: "eval adversaries", k: 20, seed: 0, missing, rows };
        let text = adversaries_table(&document);
        assert!(text.contains("kitchen, 3 images attacked\n") && text.contains("photos, 3 images"), "{text}");
        assert_eq!(text.matches("-0.61").count(), 5, "{text}");
        assert!(text.contains("among unexplained ones: 0.95"), "{text}");
        assert_eq!(text.matches("query-only-statistic").count(), 3, "once a table, once below: {text}");
        assert!(text.contains("several-frames, 8") && text.contains("4.5 %"), "{text}");
        assert!(text.contains("their resources are missing: query-only-neighbours, map-server"), "{text}");
        assert!(text.lines().all(|line| line.chars().count() <= 120), "{text}");
    }
}
