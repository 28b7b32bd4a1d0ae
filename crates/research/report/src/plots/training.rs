//! A training's curve as an image: the loss above, what is said about the validation images below.

use plotters::prelude::*;

use veiloc_evaluation::audit::training::{PositionDocument, TrainingDocument};

use super::PlotError;

/// Width and height of the image, pixels.
const SIZE: (u32, u32) = (560, 480);
/// Distinct in print and for the colour-blind (Okabe and Ito).
const BLUE: RGBColor = RGBColor(0, 114, 178);
const ORANGE: RGBColor = RGBColor(230, 159, 0);

/// Loss and precision by step as an SVG document; the precision of the statistic and of a lot as lines beside it.
///
/// # Errors
/// [`PlotError::Nothing`] when there is nothing to draw.
pub fn plot(document: &TrainingDocument) -> Result<String, PlotError> {
    let beside = document.precision.iter().find(|r| r.part == "validate" && r.predictor == "statistic");
    let levels: Vec<(&str, f64)> = beside
        .map(|r| vec![("statistic", 100.0 * r.at_20), ("at random", 100.0 * r.chance)])
        .unwrap_or_default();
    let curve = &document.curve;
    let losses = curve.iter().map(|p| (p.step as f64, p.loss)).collect();
    let judged = curve.iter().map(|p| (p.step as f64, 100.0 * p.precision_at_20)).collect();
    both(losses, judged, "precision at 20 on validation images, %", &levels)
}

/// Loss and bits told by step as an SVG document, the guess as a line beside them.
///
/// # Errors
/// [`PlotError::Nothing`] when there is nothing to draw.
pub fn positions(document: &PositionDocument) -> Result<String, PlotError> {
    let curve = &document.curve;
    let losses = curve.iter().map(|p| (p.step as f64, p.loss)).collect();
    let judged = curve.iter().map(|p| (p.step as f64, p.information_bits)).collect();
    both(losses, judged, "bits told on validation images", &[("guess", 0.0)])
}

/// Loss and what is judged by step as an SVG document; `points` are step, loss, and what is judged.
///
/// # Errors
/// [`PlotError::Nothing`] when there is nothing to draw.
pub fn course(points: &[[f64; 3]], caption: &str) -> Result<String, PlotError> {
    let losses = points.iter().map(|[step, loss, _]| (*step, *loss)).collect();
    let judged = points.iter().map(|[step, _, judged]| (*step, *judged)).collect();
    both(losses, judged, caption, &[])
}

fn both(
    losses: Vec<(f64, f64)>,
    judged: Vec<(f64, f64)>,
    caption: &str,
    levels: &[(&str, f64)],
) -> Result<String, PlotError> {
    if losses.is_empty() {
        return Err(PlotError::Nothing("no step to draw"));
    }
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
        root.fill(&WHITE).map_err(|e| PlotError::Failed(e.to_string()))?;
        let halves = root.split_evenly((2, 1));
        panel(&halves[0], "loss", &losses, &[]).map_err(PlotError::Failed)?;
        panel(&halves[1], caption, &judged, levels).map_err(PlotError::Failed)?;
    }
    Ok(text)
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

fn panel(area: &Area<'_>, caption: &str, curve: &[(f64, f64)], levels: &[(&str, f64)]) -> Result<(), String> {
    let fault = |e: &dyn std::fmt::Display| e.to_string();
    let values = || curve.iter().map(|p| p.1).chain(levels.iter().map(|l| l.1));
    let (low, high) = (values().fold(f64::MAX, f64::min), values().fold(f64::MIN, f64::max));
    let room = 0.08 * (high - low).max(1e-3 * high.abs()).max(1e-9);
    let last = curve.last().map_or(1.0, |p| p.0);
    let mut chart = ChartBuilder::on(area)
        .caption(caption, ("sans-serif", 15))
        .margin(8)
        .x_label_area_size(34)
        .y_label_area_size(44)
        .build_cartesian_2d(0.0..1.02 * last, low - room..high + room)
        .map_err(|e| fault(&e))?;
    chart.configure_mesh().x_desc("step").light_line_style(TRANSPARENT).draw().map_err(|e| fault(&e))?;
    for (name, level) in levels {
        let ends = [(0.0, *level), (1.02 * last, *level)];
        chart.draw_series(LineSeries::new(ends, ORANGE.stroke_width(2))).map_err(|e| fault(&e))?;
        let label = Text::new((*name).to_owned(), (0.01 * last, *level + room), ("sans-serif", 13));
        chart.draw_series([label]).map_err(|e| fault(&e))?;
    }
    chart.draw_series(LineSeries::new(curve.iter().copied(), BLUE.stroke_width(2))).map_err(|e| fault(&e))?;
    Ok(())
}
