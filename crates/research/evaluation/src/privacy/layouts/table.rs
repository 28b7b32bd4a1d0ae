//! Text tables: poses and baseline, gains of adversaries, and the numbering of layouts.

use super::document::{LayoutRow, LayoutsDocument};
use crate::privacy::adversaries::Adversary;
use crate::results::text_table::{TextTable, percent};

/// Poses and baseline, then adversaries, one row per layout, numbered as in the plot.
pub fn layouts_table(document: &LayoutsDocument) -> String {
    let stresses: Vec<&str> = document
        .rows
        .first()
        .map_or_else(Vec::new, |row| row.conditions.iter().map(|c| c.stress.as_str()).collect());
    let mut head = vec!["#".to_owned(), "error".to_owned(), "tail".to_owned(), "rotation".to_owned()];
    head.extend(stresses.iter().map(|s| (*s).to_owned()));
    head.extend(["prior px", "other pencil", "as paper"].map(str::to_owned));
    let mut poses = TextTable::new(head, 1);
    let adversaries: Vec<Adversary> = Adversary::ALL
        .into_iter()
        .filter(|a| document.rows.iter().any(|row| row.bits.contains_key(a.name())))
        .collect();
    let mut head = vec!["#".to_owned()];
    head.extend(
        adversaries.iter().map(|a| a.name().replace("neighbours", "neigh.").replace("pose-server", "pose")),
    );
    let mut gains = TextTable::new(head, 1);
    let mut names = Vec::new();
    for (index, row) in document.rows.iter().enumerate() {
        let number = (index + 1).to_string();
        names.push(format!("{number:>3}  {}\n", row.layout));
        poses.push(of_poses(&number, row));
        let mut cells = vec![number];
        cells.extend(adversaries.iter().map(|a| of_adversary(row, *a)));
        gains.push(cells);
    }
    let names = names.concat();
    format!(
        "{names}\nPose errors relative to points on the same {} queries (seeds: {}): median and 90 % quantile of the position,\n\
         median of the orientation, geometric means over conditions; then median and quantile by condition.\n\
         Other pencil: share of the {} true nearest neighbours.\n\n{}\n\
         Gain of adversaries over the prior-only baseline, bits per keypoint, and their median error, pixels\n\
         ({} queries attacked); true neighbours are for comparison: no attacker has them.\n\n{}",
        document.queries,
        document.seeds,
        document.k,
        poses.render(),
        document.attacked,
        gains.render()
    )
}

fn of_poses(number: &str, row: &LayoutRow) -> Vec<String> {
    let mut cells = vec![number.to_owned()];
    cells.extend([row.error_over_points, row.tail_over_points, row.rotation_over_points].map(ratio));
    cells.extend(
        row.conditions
            .iter()
            .map(|c| format!("{} / {}", ratio(c.error_over_points), ratio(c.tail_over_points))),
    );
    cells.push(row.prior_mean_px.map_or_else(String::new, |px| format!("{px:.1}")));
    cells.push(row.other_pencil_neighbours.map_or_else(String::new, percent));
    cells.push(row.protects_as_paper.map_or("", |yes| if yes { "yes" } else { "no" }).to_owned());
    cells
}

fn of_adversary(row: &LayoutRow, adversary: Adversary) -> String {
    let found = row.adversaries.iter().find(|a| a.adversary == adversary.name());
    found.map_or_else(String::new, |a| format!("{:+.2} / {:.0}", a.bits, a.median_px))
}

fn ratio(value: Option<f64>) -> String {
    value.map_or_else(|| "∞".to_owned(), |v| format!("{v:.2}"))
}

#[cfg(test)]
mod tests {
    use super::super::document::tests::{document, row};
    use super::*;

    #[test]
    fn both_tables_have_one_row_per_layout() {
        let rows = vec![
            row("dcl:paper", 2.8, 80.0, [-0.1, 4.0]),
            row("dcl:axis=1:sectors=2:anchors=0/0+1/1", 1.4, 90.0, [0.25, 5.0]),
        ];
        let text = layouts_table(&document(rows));
        assert!(text.contains("  2  dcl:axis=1:sectors=2:anchors=0/0+1/1\n"), "{text}");
        assert!(text.contains("+0.25 / 40") && text.contains("1.40") && text.contains('∞'), "{text}");
        assert!(text.lines().all(|line| line.chars().count() <= 120), "{text}");
        assert!(!text.contains("network"), "no network was given: {text}");
    }
}
