//! Charts of evaluation documents, each an SVG file.

use veiloc_evaluation::pose::crb::{BoundCell, BoundEvaluation};
use veiloc_evaluation::privacy::layouts::{LayoutRow, LayoutsDocument};

use crate::chart::{Axis, Chart, Mark, Series, standalone};

/// The document has nothing to draw.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is nothing to draw: the document has {0}")]
pub struct PlotError(&'static str);

/// Median translation error relative to the Cramér–Rao bound against noise: one panel per scene and share of
/// outliers, one curve per scheme.
///
/// # Errors
/// [`PlotError`] when there is no cell.
pub fn bound(document: &BoundEvaluation) -> Result<String, PlotError> {
    /// Larger ratios are drawn on the upper edge.
    const HIGHEST: f64 = 2.0;
    /// The project's target ratio.
    const AIM: f64 = 1.15;
    let noise = 1.08 * document.cells.iter().map(|cell| cell.noise_px).fold(0.1, f64::max);
    let panel = |cell: &BoundCell| format!("{}, {:.0} % outliers", cell.scene, 100.0 * cell.outlier_ratio);
    let of_panel = |title: &String| {
        let cells: Vec<&BoundCell> = document.cells.iter().filter(|cell| panel(cell) == *title).collect();
        let of_scheme = |scheme: &String| {
            let own = cells.iter().filter(|cell| cell.scheme == *scheme);
            let mut points: Vec<(f64, f64)> =
                own.filter_map(|cell| Some((cell.noise_px, cell.translation_ratio?))).collect();
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            Series { name: scheme.clone(), mark: Mark::DottedLine, points }
        };
        let level = |at: f64| Series {
            name: String::new(),
            mark: Mark::Baseline,
            points: vec![(0.0, at), (noise, at)],
        };
        let schemes = distinct(cells.iter().map(|cell| cell.scheme.clone()));
        Chart {
            title: title.clone(),
            x: Axis::linear("noise of a keypoint, px", 0.0, noise),
            y: Axis::linear("error / bound", 0.8, HIGHEST),
            series: [level(1.0), level(AIM)].into_iter().chain(schemes.iter().map(of_scheme)).collect(),
        }
        .svg()
    };
    let panels = distinct(document.cells.iter().map(panel));
    if panels.is_empty() {
        return Err(PlotError("no cell"));
    }
    Ok(standalone(&panels.iter().map(of_panel).collect::<Vec<_>>()))
}

/// A panel of the layouts' chart: title and value.
type LayoutPanel = (&'static str, fn(&LayoutRow) -> Option<f64>);

/// Layouts: gain of the strongest realistic adversary, and error of the baseline, against pose error. Each layout is
/// a dot, numbered as in the table; layouts that lose poses have no error and are left out.
///
/// # Errors
/// [`PlotError`] when no layout has an error.
pub fn layouts(document: &LayoutsDocument) -> Result<String, PlotError> {
    const PANELS: [LayoutPanel; 3] = [
        ("strongest realistic adversary, bits", LayoutRow::worst_realistic),
        ("learned neighbours, bits", |row| row.bits.get("outsider-statistic").copied()),
        ("error of the baseline, px", |row| row.prior_mean_px),
    ];
    let panel = |(title, of): &LayoutPanel| {
        let dot = |row: &LayoutRow| Some((row.error_over_points?, of(row)?));
        let dots: Vec<Option<(f64, f64)>> = document.rows.iter().map(dot).collect();
        let ends = |of: fn(&(f64, f64)) -> f64| {
            let values = dots.iter().flatten().map(of);
            let (low, high) =
                values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
            let margin = 0.1 * (high - low).max(0.1);
            (low - margin, high + margin)
        };
        let ((left, right), (low, high)) = (ends(|d| d.0), ends(|d| d.1));
        // A layout without an error keeps its number and is not drawn.
        let points = dots.iter().map(|dot| dot.unwrap_or((f64::NAN, f64::NAN))).collect();
        dots.iter().any(Option::is_some).then(|| {
            Chart {
                title: (*title).to_owned(),
                x: Axis::linear("pose error relative to points", left, right),
                y: Axis::linear("", low, high),
                series: vec![Series { name: String::new(), mark: Mark::NumberedDots, points }],
            }
            .svg()
        })
    };
    let drawn: Vec<_> = PANELS.iter().filter_map(panel).collect();
    if drawn.is_empty() { Err(PlotError("no layout with an error")) } else { Ok(standalone(&drawn)) }
}

/// Values in the order in which they first appear.
fn distinct(values: impl Iterator<Item = String>) -> Vec<String> {
    let mut found: Vec<String> = Vec::new();
    for value in values {
        if !found.contains(&value) {
            found.push(value);
        }
    }
    found
}
