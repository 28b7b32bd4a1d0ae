//! The bound as an image: median translation error over bound by noise, a panel a scene and share of outliers, a colour a scheme.

use plotters::prelude::*;

use super::{COLORS, Fault, PlotError, fault};
use veiloc_evaluation::pose::crb::{BoundCell, BoundEvaluation};

/// Width and height of a panel, pixels.
const PANEL: (u32, u32) = (330, 240);

/// Ratios above this are drawn on the upper edge, as open circles.
const HIGHEST: f64 = 2.0;

/// The ratio that the project aims to stay below.
const AIM: f64 = 1.15;

/// The translation errors as an SVG document.
///
/// # Errors
/// [`PlotError::Nothing`] when there is nothing to draw.
pub fn plot(document: &BoundEvaluation) -> Result<String, PlotError> {
    let scenes = distinct(document, |c| c.scene.clone());
    let schemes = distinct(document, |c| c.scheme.clone());
    let outliers = distinct(document, |c| format!("{:.0}", 100.0 * c.outlier_share));
    if scenes.is_empty() {
        return Err(PlotError::Nothing("no cell to draw"));
    }
    let size = (PANEL.0 * scenes.len() as u32, PANEL.1 * outliers.len() as u32 + 40);
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
        draw(document, &root, &scenes, &schemes, &outliers).map_err(|e| PlotError::Failed(e.to_string()))?;
    }
    Ok(text)
}

fn draw(
    document: &BoundEvaluation,
    root: &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>,
    scenes: &[String],
    schemes: &[String],
    outliers: &[String],
) -> Result<(), Fault> {
    root.fill(&WHITE).map_err(fault)?;
    let (legend, panels) = root.split_vertically(40);
    for (k, scheme) in schemes.iter().enumerate() {
        let (x, color) = (20 + 170 * k as i32, COLORS[k % COLORS.len()]);
        legend.draw(&Circle::new((x, 18), 5, color.filled())).map_err(fault)?;
        legend.draw(&Text::new(scheme.clone(), (x + 10, 11), ("sans-serif", 15))).map_err(fault)?;
    }
    let highest_noise = document.cells.iter().map(|c| c.noise_px).fold(0.1, f64::max);
    let areas = panels.split_evenly((outliers.len(), scenes.len()));
    for (index, area) in areas.iter().enumerate() {
        let (row, column) = (index / scenes.len(), index % scenes.len());
        let of_panel: Vec<&BoundCell> = document
            .cells
            .iter()
            .filter(|c| {
                c.scene == scenes[column] && format!("{:.0}", 100.0 * c.outlier_share) == outliers[row]
            })
            .collect();
        let caption = format!("{}, {} % outliers", scenes[column], outliers[row]);
        let mut chart = ChartBuilder::on(area)
            .caption(caption, ("sans-serif", 15))
            .margin(8)
            .x_label_area_size(34)
            .y_label_area_size(44)
            .build_cartesian_2d(0.0..1.08 * highest_noise, 0.8..HIGHEST)
            .map_err(fault)?;
        chart
            .configure_mesh()
            .x_desc("noise of a keypoint, px")
            .y_desc("error / bound")
            .x_labels(5)
            .y_labels(7)
            .light_line_style(TRANSPARENT)
            .draw()
            .map_err(fault)?;
        for (level, width) in [(1.0, 2), (AIM, 1)] {
            let ends = [(0.0, level), (1.08 * highest_noise, level)];
            chart.draw_series(LineSeries::new(ends, BLACK.mix(0.6).stroke_width(width))).map_err(fault)?;
        }
        for (k, scheme) in schemes.iter().enumerate() {
            let color = COLORS[k % COLORS.len()];
            let mut points: Vec<(f64, f64)> = of_panel
                .iter()
                .filter(|c| c.scheme == *scheme)
                .filter_map(|c| Some((c.noise_px, c.translation_ratio?)))
                .collect();
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            let shown = points.iter().map(|(x, y)| (*x, y.min(HIGHEST)));
            chart.draw_series(LineSeries::new(shown.clone(), color.stroke_width(2))).map_err(fault)?;
            let dots = points.iter().zip(shown).map(|((_, y), at)| {
                let style = if *y > HIGHEST { color.stroke_width(2) } else { color.filled() };
                Circle::new(at, 4, style)
            });
            chart.draw_series(dots).map_err(fault)?;
        }
    }
    root.present().map_err(fault)
}

/// Values in the order in which they first appear.
fn distinct(document: &BoundEvaluation, of: impl Fn(&BoundCell) -> String) -> Vec<String> {
    let mut values = Vec::new();
    for value in document.cells.iter().map(of) {
        if !values.contains(&value) {
            values.push(value);
        }
    }
    values
}
