//! The text table of conditions; results from the true pose are printed below if they do not fit beside.

use super::document::{StressDocument, StressRow, TruthSummary};
use crate::results::text_table::{TextTable, length, side_by_side};

/// Columns that identify rows: stress and scheme.
const NAMES: usize = 2;

/// One row per stress and scheme.
pub fn table(document: &StressDocument) -> String {
    let thresholds: Vec<&String> =
        document.rows.first().map(|r| r.recall.keys().collect()).unwrap_or_default();
    let block = |columns: Vec<String>| {
        TextTable::new(["stress", "scheme"].map(str::to_owned).into_iter().chain(columns), NAMES)
    };
    let recalls = |of: &str| -> Vec<String> { thresholds.iter().map(|t| format!("{of}≤{t} %")).collect() };
    let figures = ["trans", "±", "rot °", "trusted", "(wrong)", "doubtful", "not found"].map(str::to_owned);
    let mut found = block(recalls("").into_iter().chain(figures).collect());
    let of_truth = |of: &str| recalls(of).into_iter().chain([format!("{of}trans")]);
    let mut optimum = block(of_truth("optimum ").chain(["lost".to_owned()]).collect());
    let mut floor = block(of_truth("floor ").collect());
    for row in &document.rows {
        let suffix = if row.gravity_sd_deg.is_some() { " + gravity" } else { "" };
        let names = [row.stress.clone(), format!("{}{suffix}", row.scheme)];
        let with = |cells: Vec<String>| names.iter().cloned().chain(cells).collect();
        let lost = row.search_failures.map(|n| n.to_string());
        found.push(with(figures_of(row, &thresholds)));
        optimum.push(with(truth_of(row.optimum.as_ref(), &thresholds).into_iter().chain(lost).collect()));
        floor.push(with(truth_of(row.floor.as_ref(), &thresholds)));
    }
    if !optimum.has_numbers() {
        return found.render();
    }
    let mut text = side_by_side([found, optimum, floor]);
    text.push_str(
        "optimum: the engine's own, from the true pose; floor: least squares on the true matches;\n\
         lost: wrong or without a pose where the optimum is right\n",
    );
    text
}

fn figures_of(row: &StressRow, thresholds: &[&String]) -> Vec<String> {
    let recalls = thresholds.iter().map(|t| percent(row.recall.get(*t)));
    let medians = [
        row.median_translation.map_or_else(missing, length),
        number(row.median_position_sd, 4),
        number(row.median_rotation_deg, 3),
    ];
    let counts = [row.trusted, row.trusted_wrong, row.doubtful, row.not_found].map(|n| n.to_string());
    recalls.chain(medians).chain(counts).collect()
}

fn truth_of(summary: Option<&TruthSummary>, thresholds: &[&String]) -> Vec<String> {
    let Some(summary) = summary else { return Vec::new() };
    let recalls = thresholds.iter().map(|t| percent(summary.recall.get(*t)));
    recalls.chain([summary.median_translation.map_or_else(missing, length)]).collect()
}

fn percent(share: Option<&f64>) -> String {
    number(share.map(|s| 100.0 * s), 1)
}

fn missing() -> String {
    "—".to_owned()
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(missing, |v| format!("{v:.digits$}"))
}

#[cfg(test)]
mod tests {
    use super::super::document::tests::{evaluation, query};
    use super::*;
    use crate::results::text_table::WIDTH;
    use veiloc_pose::State;

    #[test]
    fn rows_fit_the_terminal_with_and_without_truth() {
        let mut document = StressDocument::new(&evaluation(), "place".to_owned());
        let right = Some((0.1, 0.0123));
        let mut queries = vec![query(State::Trusted, right, right), query(State::NotFound, None, right)];
        for of in &mut queries {
            of.scheme = "coordinate-permutation".to_owned();
            of.stress = "low-resolution".to_owned();
        }
        document.rows.extend(StressRow::of(&queries, &evaluation()));
        let text = table(&document);
        assert!(text.lines().all(|l| l.chars().count() <= WIDTH), "{text}");
        let cells: Vec<&str> = text.lines().nth(2).expect("a row").split_whitespace().collect();
        let expected =
            ["low-resolution", "coordinate-permutation", "50.0", "50.0", "—", "—", "—", "1", "0", "0", "1"];
        assert_eq!(cells, expected);
        for words in ["optimum ≤0.05/5 %", "floor trans", "lost", "lost: wrong"] {
            assert!(text.contains(words), "{words}: {text}");
        }
        (document.rows[0].optimum, document.rows[0].floor, document.rows[0].search_failures) =
            (None, None, None);
        assert!(!table(&document).contains("floor"), "{}", table(&document));
    }
}
