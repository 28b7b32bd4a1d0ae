//! The text table: one row per scheme and configuration; with several seeds the mean over seeds, and below it the
//! smallest and largest value.

use std::fmt::Write as _;

use crate::results::coverage::REGIONS;
use crate::results::document::{LossStage, SchemeSummary, SeedSummary};
use crate::results::text_table::{TextTable, length, side_by_side};

/// Stages in the order of processing; the table's columns.
pub const STAGES: [&str; 6] = ["extract", "seal", "decode", "retrieve", "match", "pose"];

/// Columns that identify rows.
const NAMES: [&str; 5] = ["condition", "scheme", "recipe", "score", "gravity °"];

/// The summaries as a table, split into several if one would be too wide.
pub fn table(rows: &[SchemeSummary]) -> String {
    // Out-of-map images have no recall.
    let recalls = rows.iter().map(|row| &row.recall).max_by_key(|recall| recall.len());
    let thresholds: Vec<&String> = recalls.map(|recall| recall.keys().collect()).unwrap_or_default();
    let figures = ["hypotheses", "localized", "trusted", "rot °", "trans"].map(str::to_owned);
    let recalls = thresholds.iter().map(|t| format!("≤{t} %"));
    let mut found = block(figures.into_iter().chain(recalls).chain(["inliers %".to_owned()]));
    let stages = STAGES.iter().map(|stage| format!("{stage} ms"));
    let mut cost = block(stages.chain(["sealed bytes".to_owned()]));
    for row in rows {
        let names = names_of(row, rows);
        let with = |cells: Vec<String>| names.iter().cloned().chain(cells).collect();
        found.push(with(figures_of(row, &thresholds)));
        cost.push(with(cost_of(row)));
        if !row.per_seed.is_empty() {
            let with =
                |cells: Vec<String>| vec![String::new(); NAMES.len()].into_iter().chain(cells).collect();
            found.push(with(spread_of(row, &thresholds)));
            cost.push(with(cost_spread_of(row)));
        }
    }
    let mut text = side_by_side([found, cost]);
    text += &sent(rows);
    text += &coverage(rows);
    text += &lost(rows);
    if text.contains('~') {
        text.push_str("~ the median number of hypotheses when the search stops by itself\n");
    }
    if let Some(seeds) = rows.iter().map(|r| r.per_seed.len()).max().filter(|n| *n > 0) {
        let _ = writeln!(
            text,
            "Means over {seeds} seeds; where they differ, below each the smallest and the largest"
        );
    }
    text
}

/// Data sent per query; empty if nothing is sealed.
fn sent(rows: &[SchemeSummary]) -> String {
    let mut table = block(["mean rows", "mean bytes", "mean exposed"].map(str::to_owned));
    for row in rows {
        let Some(sent) = &row.sent else { continue };
        let mut cells = names_of(row, rows);
        cells.extend(
            [(sent.mean_rows, 1), (sent.mean_bytes, 0), (sent.mean_exposed, 1)].map(|(n, d)| fixed(n, d)),
        );
        table.push(cells);
    }
    if !table.has_numbers() {
        return String::new();
    }
    format!(
        "\nPer query: rows that the server received, bytes of all messages, and rows whose image position the pose reveals\n\
         (its inliers).\n\n{}",
        table.render()
    )
}

/// Coverage of the covariances of trusted poses; empty without data.
fn coverage(rows: &[SchemeSummary]) -> String {
    let shares = |what: &'static str| REGIONS.iter().map(move |region| format!("{what} {region} %"));
    let columns = ["trusted".to_owned()].into_iter().chain(shares("centre")).chain(shares("pose"));
    let mut table = block(columns.chain(["error / ±".to_owned()]));
    let mut known = false;
    for row in rows {
        let Some(uncertainty) = &row.uncertainty else { continue };
        known = true;
        let mut cells = names_of(row, rows);
        cells.push(row.trusted.unwrap_or(0).to_string());
        for shares in [&uncertainty.coverage, &uncertainty.coverage_pose] {
            let share = |region: &u32| number(shares.get(&region.to_string()).map(|s| 100.0 * s), 1);
            cells.extend(REGIONS.iter().map(share));
        }
        cells.push(number(uncertainty.center_error_over_sd, 2));
        table.push(cells);
    }
    if !known {
        return String::new();
    }
    format!(
        "\nOf the trusted poses, the share whose true camera centre and pose lie in the region of the covariance that\n\
         should hold 50, 90 and 99 % (in percent), the median error of the centre over its ±,\n\
         and the median ± of all poses.\n\n{}",
        table.render()
    )
}

/// Lost queries by stage; empty if none was lost.
fn lost(rows: &[SchemeSummary]) -> String {
    if rows.iter().all(|row| row.lost.is_empty()) {
        return String::new();
    }
    let mut table = block(["lost", "retrieval", "matching", "search", "objective"].map(str::to_owned));
    for row in rows {
        let mut cells = names_of(row, rows);
        cells.push(row.lost.values().sum::<usize>().to_string());
        let count = |stage: LossStage| row.lost.get(&stage).copied().unwrap_or(0).to_string();
        cells.extend(LossStage::ALL.map(count));
        table.push(cells);
    }
    format!(
        "\nQueries beyond every threshold, by the stage in which they were lost: the retrieved images, or all images of the\n\
         map, hold fewer than 15 keypoints with a true match; the search missed the optimum at the true pose; or the\n\
         estimator prefers another pose.\n\n{}",
        table.render()
    )
}

/// A table with the names of rows and these columns.
fn block(columns: impl IntoIterator<Item = String>) -> TextTable {
    TextTable::new(NAMES.map(str::to_owned).into_iter().chain(columns), NAMES.len())
}

fn names_of(row: &SchemeSummary, rows: &[SchemeSummary]) -> Vec<String> {
    let has_conditions = rows.iter().any(|r| r.condition.is_some());
    // The name of an estimator implies its score; beside conditions there is no room for one that all rows share.
    let (recipe, score) = if rows.iter().any(|other| other.variant.recipe != rows[0].variant.recipe) {
        (row.variant.recipe.clone().unwrap_or_default(), String::new())
    } else if has_conditions {
        (String::new(), String::new())
    } else {
        (String::new(), row.score.clone())
    };
    let condition = match &row.condition {
        None if has_conditions => "none".to_owned(),
        condition => condition.clone().unwrap_or_default(),
    };
    vec![condition, row.scheme.clone(), recipe, score, row.variant.gravity.clone().unwrap_or_default()]
}

fn figures_of(row: &SchemeSummary, thresholds: &[&String]) -> Vec<String> {
    let seeds = row.per_seed.len().max(1);
    let whole = |total: usize| {
        if total.is_multiple_of(seeds) {
            (total / seeds).to_string()
        } else {
            fixed(total as f64 / seeds as f64, 1)
        }
    };
    let or_mean = |own: Option<f64>, of: fn(&SeedSummary) -> Option<f64>| {
        if row.per_seed.is_empty() { own } else { mean(row, of) }
    };
    // With several seeds the columns show the spread; trust and inliers are then in the document only.
    let one_seed = row.per_seed.is_empty();
    let mut trusted = row.trusted.filter(|_| one_seed).map(whole).unwrap_or_default();
    if let Some(wrong) = row.trusted_wrong.filter(|n| one_seed && *n > 0) {
        let _ = write!(trusted, " ({wrong} wrong)");
    }
    let mut cells = vec![
        hypotheses(row),
        format!("{}/{}", whole(row.localized), row.queries / seeds),
        trusted,
        number(or_mean(row.median_rotation_deg, |s| s.median_rotation_deg), 3),
        or_mean(row.median_translation, |s| s.median_translation).map_or_else(missing, length),
    ];
    cells.extend(thresholds.iter().map(|t| number(row.recall.get(*t).map(|r| 100.0 * r), 1)));
    cells.push(if one_seed { number(row.mean_inlier_ratio.map(|r| 100.0 * r), 1) } else { String::new() });
    cells
}

/// The fixed number, or the number at which the adaptive search stopped.
fn hypotheses(row: &SchemeSummary) -> String {
    match (row.variant.fixed_hypotheses, row.median_hypotheses) {
        (Some(count), _) => count.to_string(),
        (None, Some(drawn)) => format!("~{drawn:.0}"),
        (None, None) => String::new(),
    }
}

fn spread_of(row: &SchemeSummary, thresholds: &[&String]) -> Vec<String> {
    let mut cells = vec![
        String::new(),
        spread(row, 0, |s| Some(s.localized as f64)),
        String::new(),
        spread(row, 3, |s| s.median_rotation_deg),
        spread_as(row, length, |s| s.median_translation),
    ];
    let recall = |t: &String| spread(row, 1, |s| s.recall.get(t).map(|r| 100.0 * r));
    cells.extend(thresholds.iter().map(|t| recall(t)));
    cells
}

fn cost_of(row: &SchemeSummary) -> Vec<String> {
    let ms = |stage: &str| {
        let own = row.median_ms.get(stage).copied();
        let value =
            if row.per_seed.is_empty() { own } else { mean(row, |s| s.median_ms.get(stage).copied()) };
        value.map(|ms| fixed(ms, 1)).unwrap_or_default()
    };
    let bytes = row.sealed_bytes.map(|b| b.to_string()).unwrap_or_default();
    STAGES.iter().map(|stage| ms(stage)).chain([bytes]).collect()
}

fn cost_spread_of(row: &SchemeSummary) -> Vec<String> {
    STAGES
        .iter()
        .map(|stage| {
            let known = row.median_ms.contains_key(*stage);
            if known { spread(row, 1, |s| s.median_ms.get(*stage).copied()) } else { String::new() }
        })
        .collect()
}

/// Mean over seeds; infinite (none) if one seed has no value.
fn mean(row: &SchemeSummary, of: impl Fn(&SeedSummary) -> Option<f64>) -> Option<f64> {
    let values: Option<Vec<f64>> = row.per_seed.iter().map(of).collect();
    values.map(|v| crate::results::metrics::mean(&v))
}

/// Smallest and largest value over seeds, empty if they are equal; a missing value is infinite.
fn spread(row: &SchemeSummary, digits: usize, of: impl Fn(&SeedSummary) -> Option<f64>) -> String {
    spread_as(row, |v| number(Some(v), digits), of)
}

/// As [`spread`], with the format of a number.
fn spread_as(
    row: &SchemeSummary,
    format: impl Fn(f64) -> String,
    of: impl Fn(&SeedSummary) -> Option<f64>,
) -> String {
    let values: Vec<f64> = row.per_seed.iter().map(|s| of(s).unwrap_or(f64::INFINITY)).collect();
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let end = |v: f64| if v.is_finite() { format(v) } else { missing() };
    let (least, most) = (end(least), end(most));
    if least == most { String::new() } else { format!("{least}..{most}") }
}

fn fixed(value: f64, digits: usize) -> String {
    format!("{value:.digits$}")
}

fn missing() -> String {
    "—".to_owned()
}

/// Numbers above a thousand are shown without decimals.
fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(missing, |v| fixed(v, if v < 1000.0 { digits } else { 0 }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::results::document::SentSummary;
    use crate::results::summary::{summarize, tests::query};
    use crate::results::text_table::WIDTH;

    fn row(errors: &[(u64, Option<(f64, f64)>)]) -> SchemeSummary {
        let queries: Vec<_> = errors.iter().map(|(seed, error)| query(*seed, *error)).collect();
        let thresholds = ["0.05/5".parse().expect("well written"), "0.25/2".parse().expect("well written")];
        summarize(&queries.iter().collect::<Vec<_>>(), &thresholds)
    }

    #[test]
    fn one_seed_is_one_line_with_dashes_for_failures() {
        let text = table(&[row(&[(0, Some((0.1, 0.01))), (0, None), (0, None)])]);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 4, "{text}");
        let cells: Vec<&str> = lines[2].split_whitespace().collect();
        assert_eq!(
            cells,
            ["dcl", "likelihood", "~100", "1/3", "1", "—", "—", "33.3", "33.3", "50.0", "5.0", "1000"]
        );
        assert!(
            !text.contains("gravity") && !text.contains("recipe") && !text.contains("condition"),
            "{text}"
        );
        assert!(lines[..3].iter().all(|l| l.chars().count() == lines[1].chars().count()), "{text}");
    }

    #[test]
    fn several_seeds_show_mean_and_spread_within_120_columns() {
        let mut rows = vec![row(&[
            (0, Some((0.1, 0.01))),
            (0, Some((0.1, 0.03))),
            (1, Some((0.3, 0.04))),
            (1, Some((0.3, 0.06))),
        ])];
        rows[0].variant.recipe = Some("likelihood+prior".to_owned());
        rows[0].scheme = "random-lines".to_owned();
        rows[0].variant.gravity = Some("3".to_owned());
        let text = table(&rows);
        let lines: Vec<&str> = text.lines().collect();
        for word in ["2/2", "0.0350", "75.0", "0.200"] {
            assert!(lines[2].contains(word), "{word}: {text}");
        }
        for word in ["0.0200..0.0500", "50.0..100.0", "0.100..0.300"] {
            assert!(lines[3].contains(word), "{word}: {text}");
        }
        assert!(lines.iter().all(|l| l.chars().count() <= WIDTH), "{text}");
        assert!(!lines[3].contains("2..2"), "{text}");
        assert_eq!(number(Some(12_345.678), 4), "12346");
        assert!(lines.last().is_some_and(|l| l.starts_with("Means over 2 seeds")), "{text}");
    }

    #[test]
    fn sent_data_has_its_own_table() {
        let mut sealed = row(&[(0, Some((0.1, 0.01)))]);
        sealed.sent = Some(SentSummary { mean_rows: 300.25, mean_bytes: 51_234.4, mean_exposed: 71.5 });
        let text = table(&[sealed]);
        let line = text.lines().find(|line| line.contains("51234")).expect("a row");
        assert_eq!(
            line.split_whitespace().collect::<Vec<_>>(),
            ["dcl", "likelihood", "300.2", "51234", "71.5"]
        );
    }

    #[test]
    fn conditions_are_named_and_fit() {
        let mut rows = vec![row(&[(0, Some((0.1, 0.01)))]); 2];
        for row in &mut rows {
            (row.scheme, row.variant.recipe) = ("coordinate-permutation".to_owned(), None);
        }
        rows[1].condition = Some("low-resolution".to_owned());
        rows[1].recall.clear();
        let text = table(&rows);
        assert!(text.lines().all(|l| l.chars().count() <= WIDTH), "{text}");
        let names: Vec<_> = text.lines().skip(2).take(2).map(|l| l.split_whitespace().next()).collect();
        assert_eq!(names, [Some("none"), Some("low-resolution")]);
        assert!(text.contains("≤0.25/2 %") && !text.contains("likelihood"), "{text}");
    }

    #[test]
    fn many_stages_have_their_own_table() {
        let mut wide = row(&[(0, Some((0.1, 0.01)))]);
        wide.scheme = "coordinate-permutation".to_owned();
        wide.median_ms = STAGES.iter().map(|s| ((*s).to_owned(), 12.3)).collect();
        let text = table(&[wide]);
        assert_eq!(text.matches("coordinate-permutation").count(), 2, "{text}");
        assert_eq!(text.matches("──\n").count(), 2, "{text}");
        assert!(text.lines().all(|l| l.chars().count() <= WIDTH), "{text}");
        assert!(text.contains("likelihood"), "{text}");
    }
}
