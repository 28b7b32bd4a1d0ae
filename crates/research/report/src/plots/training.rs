//! A training's curves: the loss, and what is judged on validation images.

use veiloc_evaluation::audit::training::{PositionDocument, TrainingDocument};

use super::PlotError;
use crate::chart::{Axis, Chart, Mark, Series, standalone};

/// Loss and precision of a training by step; the precision of the statistic and of chance as lines beside it.
///
/// # Errors
/// [`PlotError`] when there is no step.
pub fn training(document: &TrainingDocument) -> Result<String, PlotError> {
    let beside = document.precision.iter().find(|r| r.part == "validate" && r.predictor == "statistic");
    let levels: Vec<(&str, f64)> = beside
        .map(|r| vec![("statistic", 100.0 * r.at_20), ("at random", 100.0 * r.chance)])
        .unwrap_or_default();
    let points: Vec<[f64; 3]> =
        document.curve.iter().map(|p| [p.step as f64, p.loss, 100.0 * p.precision_at_20]).collect();
    steps(&points, "precision at 20 on validation images, %", &levels)
}

/// Loss and bits of a training by step, the baseline as a line beside them.
///
/// # Errors
/// [`PlotError`] when there is no step.
pub fn positions(document: &PositionDocument) -> Result<String, PlotError> {
    let points: Vec<[f64; 3]> =
        document.curve.iter().map(|p| [p.step as f64, p.loss, p.information_bits]).collect();
    steps(&points, "bits on validation images", &[("baseline", 0.0)])
}

/// Step, loss, and what is judged, by step.
///
/// # Errors
/// [`PlotError`] when there is no step.
pub fn course(points: &[[f64; 3]], caption: &str) -> Result<String, PlotError> {
    steps(points, caption, &[])
}

fn steps(points: &[[f64; 3]], caption: &str, levels: &[(&str, f64)]) -> Result<String, PlotError> {
    let last = points.last().ok_or(PlotError("no step"))?[0];
    let panel = |title: &str, column: usize, levels: &[(&str, f64)]| {
        let curve: Vec<(f64, f64)> = points.iter().map(|p| (p[0], p[column])).collect();
        let values = curve.iter().map(|p| p.1).chain(levels.iter().map(|l| l.1));
        let (low, high) = values.fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
        let room = 0.08 * (high - low).max(1e-3 * high.abs()).max(1e-9);
        let level = |(name, at): &(&str, f64)| Series {
            name: (*name).to_owned(),
            mark: Mark::Baseline,
            points: vec![(0.0, *at), (last, *at)],
        };
        let own = Series { name: String::new(), mark: Mark::Line, points: curve };
        Chart {
            title: title.to_owned(),
            x: Axis::linear("step", 0.0, last),
            y: Axis::linear("", low - room, high + room),
            series: std::iter::once(own).chain(levels.iter().map(level)).collect(),
        }
        .svg()
    };
    Ok(standalone(&[panel("loss", 1, &[]), panel(caption, 2, levels)]))
}
