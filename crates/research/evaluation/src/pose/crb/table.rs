//! The two text tables: errors relative to the bound, and coverage of the covariance.

use std::collections::BTreeSet;

use super::{BoundCell, BoundEvaluation};
use crate::results::coverage::REGIONS;
use crate::results::metrics::finite;
use crate::results::metrics::mean;
use crate::results::text_table::{TextTable, length};

/// Both tables, each with an explanation.
pub fn table(document: &BoundEvaluation) -> String {
    format!(
        "Median error relative to the Cramér–Rao bound ({} problems per row, {} matches each).\n\
         Found: at least half of the right matches agree with the pose; ratios and medians are over those; `all` is\n\
         the mean over the rows above, for ratios the geometric one.\n\n{}\n\
         Share of the true poses (six degrees of freedom) and camera centres (three) within the region of the estimated\n\
         covariance that should hold 50, 90 and 99 % of them.\n\n{}",
        document.problems,
        document.matches,
        bound(document),
        coverage(document)
    )
}

fn bound(document: &BoundEvaluation) -> String {
    let mut table = TextTable::new(
        [
            "scene",
            "scheme",
            "noise px",
            "outliers %",
            "found %",
            "inliers %",
            "trans / bound",
            "rot / bound",
            "trans",
            "rot °",
        ],
        2,
    );
    for cell in &document.cells {
        table.push(vec![
            cell.scene.clone(),
            cell.scheme.clone(),
            cell.noise_px.to_string(),
            percent(cell.outlier_ratio, 0),
            percent(cell.found, 1),
            percent(cell.inlier_recall, 1),
            number(cell.translation_ratio, 2),
            number(cell.rotation_ratio, 2),
            cell.median_translation.map_or_else(missing, length),
            number(cell.median_rotation_deg, 4),
        ]);
    }
    let mut schemes: Vec<&String> = document.cells.iter().map(|c| &c.scheme).collect();
    let mut seen = BTreeSet::new();
    schemes.retain(|scheme| seen.insert(*scheme));
    for scheme in schemes.into_iter().filter(|_| document.cells.len() > seen.len()) {
        let cells: Vec<&BoundCell> = document.cells.iter().filter(|c| c.scheme == *scheme).collect();
        let average = |of: fn(&BoundCell) -> f64| mean(&cells.iter().map(|c| of(c)).collect::<Vec<_>>());
        table.push(vec![
            "all".to_owned(),
            scheme.clone(),
            String::new(),
            String::new(),
            percent(average(|c| c.found), 1),
            percent(average(|c| c.inlier_recall), 1),
            number(geometric_mean(cells.iter().filter_map(|c| c.translation_ratio)), 2),
            number(geometric_mean(cells.iter().filter_map(|c| c.rotation_ratio)), 2),
        ]);
    }
    table.render()
}

/// The mean of ratios, by their logarithms.
fn geometric_mean(ratios: impl Iterator<Item = f64>) -> Option<f64> {
    let logarithms: Vec<f64> = ratios.map(f64::ln).collect();
    finite(mean(&logarithms).exp())
}

fn coverage(document: &BoundEvaluation) -> String {
    let head = ["scene", "scheme", "noise px", "poses"].map(str::to_owned);
    let columns = |what: &'static str| REGIONS.iter().map(move |region| format!("{what} {region} %"));
    let mut table = TextTable::new(head.into_iter().chain(columns("pose")).chain(columns("centre")), 2);
    for row in &document.coverage {
        let mut cells = vec![
            row.scene.clone(),
            row.scheme.clone(),
            row.noise_px.map(|n| n.to_string()).unwrap_or_default(),
            row.poses.to_string(),
        ];
        for shares in [&row.pose, &row.center] {
            let share = |region: &u32| shares.get(&region.to_string()).filter(|_| row.poses > 0);
            cells.extend(REGIONS.iter().map(|r| share(r).map_or("—".to_owned(), |s| percent(*s, 1))));
        }
        table.push(cells);
    }
    table.render()
}

fn percent(share: f64, digits: usize) -> String {
    format!("{:.digits$}", 100.0 * share)
}

fn missing() -> String {
    "—".to_owned()
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(missing, |v| format!("{v:.digits$}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::crb::{SyntheticEvaluation, SyntheticScene, evaluate_bound};
    use crate::results::text_table::WIDTH;
    use veiloc_protocol::Scheme;

    #[test]
    fn table_has_every_cell() {
        let evaluation = SyntheticEvaluation {
            scenes: vec![SyntheticScene::Deep, SyntheticScene::Narrow],
            schemes: vec![Scheme::Points, Scheme::default()],
            noises_px: vec![0.5, 2.0],
            outlier_shares: vec![0.25],
            problems: 3,
            matches: 80,
            ..SyntheticEvaluation::default()
        };
        let document = evaluate_bound(&evaluation, &()).expect("evaluated");
        let text = table(&document);
        assert!(text.lines().all(|l| l.chars().count() <= WIDTH), "{text}");
        assert_eq!(text.lines().filter(|l| l.starts_with("deep") || l.starts_with("narrow")).count(), 16);
        assert_eq!(text.lines().filter(|l| l.starts_with("all ")).count(), 4, "two schemes in two tables");
    }

    #[test]
    fn ratios_have_geometric_mean() {
        assert!((geometric_mean([0.5, 2.0].into_iter()).expect("two") - 1.0).abs() < 1e-12);
        assert_eq!(geometric_mean(std::iter::empty()), None);
    }
}
