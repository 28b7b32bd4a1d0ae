//! Errors of poses as curves: the share of queries within a bound, a panel a place, a curve a scheme.

use plotters::coord::Shift;
use plotters::prelude::*;
use veiloc_evaluation::results::tables::{ErrorCurve, TableData};

use super::{COLORS, Fault, PlotError, fault};

/// Width and height of a panel, pixels.
const PANEL: (u32, u32) = (380, 320);
/// Panels beside one another.
const ACROSS: usize = 3;

/// Which error is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ErrorAxis {
    /// Of the position, centimetres where map units are metres.
    Position,
    /// Of the orientation, degrees.
    Orientation,
}

/// The share of queries within a bound over the bound, on a logarithmic axis; queries without a pose are within none.
///
/// # Errors
/// [`PlotError::Nothing`] when no query is judged.
pub fn plot(data: &TableData, axis: ErrorAxis) -> Result<String, PlotError> {
    let panels = panels(data);
    if panels.is_empty() {
        return Err(PlotError::Nothing("no query with a known pose to draw"));
    }
    let rows = panels.len().div_ceil(ACROSS);
    let across = panels.len().min(ACROSS);
    let mut text = String::new();
    {
        let size = (PANEL.0 * across as u32, PANEL.1 * rows as u32);
        let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
        draw(&panels, axis, &root, (rows, across)).map_err(|e| PlotError::Failed(e.to_string()))?;
    }
    Ok(text)
}

/// The curves of each place.
fn panels(data: &TableData) -> Vec<(String, Vec<ErrorCurve>)> {
    let mut panels: Vec<(String, Vec<ErrorCurve>)> = Vec::new();
    for curve in data.error_curves() {
        match panels.iter_mut().find(|(place, _)| *place == curve.place) {
            Some((_, curves)) => curves.push(curve),
            None => panels.push((curve.place.clone(), vec![curve])),
        }
    }
    panels
}

fn draw(
    panels: &[(String, Vec<ErrorCurve>)],
    axis: ErrorAxis,
    root: &DrawingArea<SVGBackend<'_>, Shift>,
    (rows, across): (usize, usize),
) -> Result<(), Fault> {
    root.fill(&WHITE).map_err(fault)?;
    let errors = |curve: &ErrorCurve| -> Vec<f64> {
        let scaled = |e: &(f64, f64)| match axis {
            ErrorAxis::Position => 100.0 * e.0,
            ErrorAxis::Orientation => e.1,
        };
        let mut errors: Vec<f64> = curve.errors.iter().map(scaled).filter(|e| e.is_finite()).collect();
        errors.sort_by(f64::total_cmp);
        errors
    };
    let all: Vec<f64> = panels.iter().flat_map(|(_, curves)| curves.iter().flat_map(errors)).collect();
    let least = all.iter().copied().filter(|e| *e > 0.0).fold(f64::INFINITY, f64::min);
    let most = all.iter().copied().fold(0.0, f64::max);
    // Nobody localized at all: empty axes say so.
    let (least, most) = if most > 0.0 { (0.8 * least.min(most), 1.25 * most) } else { (0.1, 10.0) };
    let unit = match axis {
        ErrorAxis::Position => "error of the position, hundredths of the map unit (cm)",
        ErrorAxis::Orientation => "error of the orientation, degrees",
    };
    for ((place, curves), area) in panels.iter().zip(root.split_evenly((rows, across))) {
        let mut chart = ChartBuilder::on(&area)
            .caption(place, ("sans-serif", 15))
            .margin(8)
            .x_label_area_size(34)
            .y_label_area_size(44)
            .build_cartesian_2d((least..most).log_scale(), 0.0..102.0_f64)
            .map_err(fault)?;
        chart
            .configure_mesh()
            .x_desc(unit)
            .y_desc("queries within, %")
            .y_label_formatter(&|share| format!("{share:.0}"))
            .x_label_formatter(&|error| format!("{error}"))
            .light_line_style(TRANSPARENT)
            .draw()
            .map_err(fault)?;
        for (index, curve) in curves.iter().enumerate() {
            let color = COLORS[index % COLORS.len()];
            let of_all = curve.errors.len() as f64;
            let mut steps = vec![(least, 0.0)];
            for (found, error) in errors(curve).into_iter().enumerate() {
                let error = error.max(least);
                steps.push((error, 100.0 * found as f64 / of_all));
                steps.push((error, 100.0 * (found + 1) as f64 / of_all));
            }
            let top = steps.last().map_or(0.0, |step| step.1);
            steps.push((most, top));
            // The fifth curve and further ones are thinner than the first four, whose colours they have.
            let width = if index < COLORS.len() { 2 } else { 1 };
            chart
                .draw_series(LineSeries::new(steps, color.stroke_width(width)))
                .map_err(fault)?
                .label(&curve.row)
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], color.stroke_width(width)));
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperLeft)
            .background_style(WHITE.mix(0.8))
            .label_font(("sans-serif", 11))
            .draw()
            .map_err(fault)?;
    }
    root.present().map_err(fault)
}
