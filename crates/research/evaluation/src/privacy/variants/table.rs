//! The figures as two tables for people: what attackers get, and what localization keeps.

use super::document::{AttackFigures, TradeoffDocument, VariantFigures};
use crate::results::text_table::{TextTable, percent};

/// Privacy, then localization, a row a variant; the number is that of the plot.
pub fn tradeoff_table(document: &TradeoffDocument) -> String {
    let attacks: Vec<&str> = document
        .variants
        .first()
        .map_or_else(Vec::new, |v| v.attacks.iter().map(|a| a.attack.as_str()).collect());
    let told: Vec<&str> = attacks.iter().copied().filter(|a| *a != "guess").collect();
    let mut errors = columns(&["sent"], &attacks);
    errors.extend(["shape", "precision", "at random"].map(str::to_owned));
    let mut medians = TextTable::new(errors, 2);
    let mut found = TextTable::new(columns(&[], &told), 2);
    for (index, v) in document.variants.iter().enumerate() {
        let names = || vec![(index + 1).to_string(), v.variant.clone()];
        let mut row = names();
        row.push(if v.decoys > 0.0 {
            format!("{:.0}+{:.0}", v.sent, v.decoys)
        } else {
            format!("{:.0}", v.sent)
        });
        row.extend(attacks.iter().map(|a| cell(v, a, |f| f.median_px.map(|x| format!("{x:.1}")))));
        row.push(cell(v, "graph", |f| f.shape_median_px.map(|x| format!("{x:.1}"))));
        row.push(v.precision.map_or_else(String::new, percent));
        row.push(percent(v.chance));
        medians.push(row);
        let mut row = names();
        row.extend(told.iter().map(|a| {
            cell(v, a, |f| f.under_10px.map(|share| format!("{:.0} ({})", f.found_10px, percent(share))))
        }));
        found.push(row);
    }
    format!(
        "Median error of the sent keypoints, pixels ({} of {} images attacked); shape: of `graph`, each side scaled to \
         fit;\nprecision: of {} predicted neighbours.\n\n{}\n\
         Keypoints of an image within 10 px of the truth, and their share of those sent.\n\n{}\n\
         Poses (seeds: {}, queries of each: {}).\n\n{}",
        document.attacked,
        document.queries,
        document.k,
        medians.render(),
        found.render(),
        document.seeds,
        document.queries,
        localization(document).render()
    )
}

fn localization(document: &TradeoffDocument) -> TextTable {
    let thresholds = &document.thresholds;
    let mut head = vec!["#".to_owned(), "variant".to_owned(), "matches".to_owned()];
    head.extend(thresholds.iter().map(|t| format!("≤{t} %")));
    head.extend(["trans", "rot °", "trusted %", "wrong"].map(str::to_owned));
    let mut table = TextTable::new(head, 2);
    for (index, v) in document.variants.iter().enumerate() {
        let l = &v.localization;
        let mut row = vec![(index + 1).to_string(), v.variant.clone(), format!("{:.0}", l.matches)];
        row.extend(thresholds.iter().map(|t| format!("{:.1}", 100.0 * l.recall[t])));
        row.push(l.median_translation.map_or_else(|| "∞".to_owned(), |t| format!("{t:.4}")));
        row.push(l.median_rotation_deg.map_or_else(|| "∞".to_owned(), |r| format!("{r:.3}")));
        row.push(format!("{:.1}", 100.0 * l.trusted as f64 / l.queries.max(1) as f64));
        row.push(l.trusted_wrong.to_string());
        table.push(row);
    }
    table
}

fn columns(first: &[&str], attacks: &[&str]) -> Vec<String> {
    ["#", "variant"].iter().chain(first).chain(attacks).map(|name| (*name).to_owned()).collect()
}

fn cell(v: &VariantFigures, attack: &str, of: impl Fn(&AttackFigures) -> Option<String>) -> String {
    v.attack(attack).and_then(of).unwrap_or_default()
}
