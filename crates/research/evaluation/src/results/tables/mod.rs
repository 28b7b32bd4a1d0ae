//! Tables of evaluations as in papers, made from documents: Markdown, LaTeX, CSV.
//!
//! Scenes are columns, schemes are rows. Published figures are shown only for exactly the same data.

mod document;
mod interval;
mod layout;
mod published;

use std::str::FromStr;

use crate::results::document::QueryResult;
use crate::results::metrics::{PoseErrors, Threshold, median, recall};
use crate::results::table::STAGES;
use interval::interval;
use layout::FormattedTable;

pub use document::{ErrorCurve, TableData};
pub use layout::Format;

/// Content of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cells {
    /// Median position error in hundredths of the map unit (centimetres for metres), median rotation error, recall at
    /// the first threshold.
    MediansAndRecall,
    /// The two medians only.
    Medians,
    /// Recall at every threshold.
    Recalls,
}

impl FromStr for Cells {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "medians-recall" => Ok(Self::MediansAndRecall),
            "medians" => Ok(Self::Medians),
            "recalls" => Ok(Self::Recalls),
            _ => Err(format!("{text:?} is none of medians-recall, medians and recalls")),
        }
    }
}

/// Options of tables.
#[derive(Debug, Clone)]
pub struct TableOptions {
    /// Output format.
    pub format: Format,
    /// Content of cells; `None`: as in the paper for the data set.
    pub cells: Option<Cells>,
    /// Thresholds of recall; empty: as in the paper for the data set.
    pub thresholds: Vec<Threshold>,
    /// Whether published figures are shown beside figures of the same data.
    pub published: bool,
    /// Bootstrap samples of the intervals.
    pub bootstrap_samples: usize,
    /// Seed of the bootstrap.
    pub seed: u64,
}

/// All tables of a document: errors beside published figures, intervals, the ablation if its schemes were run, times.
pub fn tables(data: &TableData, options: &TableOptions) -> String {
    let sheets = [
        Some(errors(data, options)),
        Some(intervals(data, options)),
        ablation(data, options),
        Some(times(data)),
    ];
    let parts: Vec<String> = sheets.into_iter().flatten().map(|sheet| sheet.render(options.format)).collect();
    parts.join("\n")
}

fn cells_of(data: &TableData, options: &TableOptions) -> Cells {
    options.cells.unwrap_or(match data.data_set.as_str() {
        "cambridge" => Cells::Medians,
        "aachen" => Cells::Recalls,
        _ => Cells::MediansAndRecall,
    })
}

fn thresholds_of(data: &TableData, options: &TableOptions) -> Vec<Threshold> {
    if !options.thresholds.is_empty() {
        return options.thresholds.clone();
    }
    let of = |bounds: &[(f64, f64)]| {
        bounds
            .iter()
            .map(|(translation, rotation_deg)| Threshold {
                translation: *translation,
                rotation_deg: *rotation_deg,
            })
            .collect()
    };
    match data.data_set.as_str() {
        "aachen" => of(&[(0.25, 2.0), (0.5, 5.0), (5.0, 10.0)]),
        _ => of(&[(0.05, 5.0)]),
    }
}

/// Errors of the queries of a cell.
fn errors_of(results: &[&QueryResult]) -> Vec<PoseErrors> {
    results.iter().map(|result| result.pose_error()).collect()
}

/// A number with this many decimals; infinite when more than half were not localized.
fn digits(value: f64, digits: usize) -> String {
    if value.is_finite() {
        format!("{value:.digits$}")
    } else if value.is_nan() {
        "-".to_owned()
    } else {
        "∞".to_owned()
    }
}

fn centimetres(errors: &[PoseErrors]) -> f64 {
    100.0 * median(&errors.iter().map(|e| e.translation).collect::<Vec<_>>())
}

fn degrees(errors: &[PoseErrors]) -> f64 {
    median(&errors.iter().map(|e| e.rotation_deg).collect::<Vec<_>>())
}

/// A cell with these contents and decimals.
fn figures(errors: &[PoseErrors], cells: Cells, thresholds: &[Threshold]) -> String {
    if errors.is_empty() {
        return String::new();
    }
    let percent = |threshold: &Threshold| digits(100.0 * recall(errors, threshold), 1);
    let medians = || format!("{}/{}", digits(centimetres(errors), 2), digits(degrees(errors), 3));
    match cells {
        Cells::Medians => medians(),
        Cells::MediansAndRecall => thresholds
            .first()
            .map_or_else(medians, |threshold| format!("{}/{}", medians(), percent(threshold))),
        Cells::Recalls => thresholds.iter().map(percent).collect::<Vec<_>>().join("/"),
    }
}

fn meaning(cells: Cells, thresholds: &[Threshold]) -> String {
    let at: Vec<String> =
        thresholds.iter().map(|t| format!("{} m, {}°", t.translation, t.rotation_deg)).collect();
    match cells {
        Cells::Medians => "Median position error (cm) / median rotation error (°)".to_owned(),
        Cells::MediansAndRecall => format!(
            "Median position error (cm) / median rotation error (°) / recall (%) at {}",
            at.first().map_or("", String::as_str)
        ),
        Cells::Recalls => format!("Recall (%) at {}", at.join(" / ")),
    }
}

/// Errors of every row in every column, below the published figures for the same data.
fn errors(data: &TableData, options: &TableOptions) -> FormattedTable {
    let (cells, thresholds) = (cells_of(data, options), thresholds_of(data, options));
    let columns = data.columns();
    let counts = data.rows().first().map(|row| {
        let count = |column: &String| data.cell(row, column).len().to_string();
        columns.iter().map(count).collect::<Vec<_>>()
    });
    let mut sheet = FormattedTable::new(&format!("{}.", meaning(cells, &thresholds)), "method", &columns);
    sheet.push("queries", counts.unwrap_or_default());
    let scenes = published::scenes(&data.data_set);
    let official = |column: &str| data.is_official(column);
    if options.published && columns.iter().any(|column| official(column) && scenes.contains(&column.as_str()))
    {
        let methods = published::METHODS.iter().filter(|method| method.data_set == data.data_set);
        for method in methods {
            let cell = |column: &String| {
                let at = scenes.iter().position(|scene| scene == column).filter(|_| official(column));
                at.map_or(String::new(), |at| method.cells[at].to_owned())
            };
            sheet.push(method.method, columns.iter().map(cell).collect());
        }
        if let Some(source) = published::source(&data.data_set) {
            sheet.note(&format!("Published figures: {source}."));
        }
    }
    let strange: Vec<&String> = columns.iter().filter(|column| !official(column)).collect();
    if !data.data_set.is_empty() && !strange.is_empty() {
        let names: Vec<&str> = strange.iter().map(|name| name.as_str()).collect();
        sheet.note(&format!(
            "Not the published data, so published figures are not shown: {}.",
            names.join(", ")
        ));
    }
    for row in data.rows() {
        let cell = |column: &String| figures(&errors_of(&data.cell(&row, column)), cells, &thresholds);
        sheet.push(&row, columns.iter().map(cell).collect());
    }
    sheet
}

/// 95 % intervals of the median position error, by a bootstrap over the queries.
fn intervals(data: &TableData, options: &TableOptions) -> FormattedTable {
    let columns = data.columns();
    let mut sheet = FormattedTable::new(
        "95 % interval of the median position error (cm), queries drawn with replacement.",
        "method",
        &columns,
    );
    for row in data.rows() {
        let cell = |column: &String| {
            let errors = errors_of(&data.cell(&row, column));
            let translations: Vec<f64> = errors.iter().map(|e| 100.0 * e.translation).collect();
            interval(&translations, median, options.bootstrap_samples, options.seed)
                .map_or(String::new(), |(low, high)| format!("{} to {}", digits(low, 2), digits(high, 2)))
        };
        sheet.push(&row, columns.iter().map(cell).collect());
    }
    sheet
}

/// Means over the scenes for the schemes of the paper's ablations, and the queries that could not be sealed because
/// all keypoints lie on one side; `None` if only one of the schemes was run.
fn ablation(data: &TableData, options: &TableOptions) -> Option<FormattedTable> {
    let schemes = ["dcl:paper", "dcl:s=2", "dcl:s=3", "dcl:horizontal"];
    let rows: Vec<String> = data
        .rows()
        .into_iter()
        .filter(|row| schemes.iter().any(|scheme| row.split(", ").next() == Some(scheme)))
        .collect();
    if rows.len() < 2 {
        return None;
    }
    let columns = data.columns();
    let all_official = columns.iter().all(|column| data.is_official(column));
    let show_paper =
        options.published && all_official && published::scenes(&data.data_set).len() == columns.len();
    let mut heads = vec!["mean of medians, cm/°".to_owned(), "one-sided queries".to_owned(), "of".to_owned()];
    heads.extend(show_paper.then(|| "the paper".to_owned()));
    let mut sheet = FormattedTable::new(
        "Distance between the anchors (H, 2H, 3H) and direction of the partition: mean over the scenes.",
        "scheme",
        &heads,
    );
    for row in rows {
        let by_column: Vec<Vec<&QueryResult>> =
            columns.iter().map(|column| data.cell(&row, column)).collect();
        let mean = |of: fn(&[PoseErrors]) -> f64| {
            let each: Vec<f64> =
                by_column.iter().filter(|c| !c.is_empty()).map(|c| of(&errors_of(c))).collect();
            each.iter().sum::<f64>() / each.len() as f64
        };
        let all: Vec<&QueryResult> = by_column.concat();
        let unsealed = all.iter().filter(|result| result.sealed_bytes == Some(0)).count();
        let mut cells = vec![
            format!("{}/{}", digits(mean(centimetres), 2), digits(mean(degrees), 3)),
            unsealed.to_string(),
            all.len().to_string(),
        ];
        let paper = published::ANCHORS
            .iter()
            .find(|(scheme, set, _)| *set == data.data_set && row.split(", ").next() == Some(scheme));
        cells.extend(show_paper.then(|| paper.map_or(String::new(), |(_, _, cell)| (*cell).to_owned())));
        sheet.push(&row, cells);
    }
    Some(sheet)
}

/// Median milliseconds of every stage, over all scenes.
fn times(data: &TableData) -> FormattedTable {
    let heads: Vec<String> = STAGES.iter().map(|stage| format!("{stage} ms")).collect();
    let mut sheet = FormattedTable::new("Median time of each stage of a query.", "scheme", &heads);
    for (row, stages) in data.stage_times() {
        let cell = |stage: &&str| {
            let time = stages.iter().find(|own| own.0 == *stage);
            time.map_or(String::new(), |own| digits(own.1, 1))
        };
        sheet.push(&row, STAGES.iter().map(cell).collect());
    }
    sheet
}

#[cfg(test)]
mod tests;
