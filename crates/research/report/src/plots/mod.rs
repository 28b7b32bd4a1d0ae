//! Charts of evaluation documents, each an SVG file.

use veiloc_evaluation::privacy::layouts::{LayoutRow, LayoutsDocument};

use crate::chart::{Axis, Chart, Mark, Series, standalone};

/// The document has nothing to draw.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is nothing to draw: the document has {0}")]
pub struct PlotError(&'static str);

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
