//! Layouts as an image: what the strongest realistic adversary gains, and the guess, over the error of poses.

use plotters::coord::Shift;
use plotters::prelude::*;

use super::{COLORS, Fault, PlotError, fault};
use veiloc_evaluation::privacy::layouts::{LayoutRow, LayoutsDocument};

/// Width and height of a panel, pixels.
const PANEL: (u32, u32) = (470, 400);

/// One panel: what stands above it, and what is drawn upwards.
type Panel = (&'static str, fn(&LayoutRow) -> Option<f64>);

const PANELS: [Panel; 3] = [
    ("gain of the strongest realistic adversary, bits", LayoutRow::worst_realistic),
    ("gain of learned neighbours, bits", |row| row.bits.get("outsider-statistic").copied()),
    ("error of the guess, px", |row| row.prior_mean_px),
];

/// The document as SVG: each layout a numbered dot, the error of its poses over that of points to the right. Numbers are
/// those of the table; layouts that lose poses have no error and are left out.
///
/// # Errors
/// [`PlotError::Nothing`] when there is nothing to draw.
pub fn plot(document: &LayoutsDocument) -> Result<String, PlotError> {
    let panels: Vec<Panel> = PANELS.into_iter().filter(|panel| !dots(document, panel).is_empty()).collect();
    if panels.is_empty() {
        return Err(PlotError::Nothing("no layout with an error to draw"));
    }
    let mut text = String::new();
    {
        let size = (PANEL.0 * panels.len() as u32, PANEL.1);
        let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
        draw(document, &root, &panels).map_err(|e| PlotError::Failed(e.to_string()))?;
    }
    Ok(text)
}

/// Number of the layout, its error, and what is drawn upwards.
fn dots(document: &LayoutsDocument, panel: &Panel) -> Vec<(usize, f64, f64)> {
    let dot = |(i, row): (usize, &LayoutRow)| Some((i + 1, row.error_over_points?, panel.1(row)?));
    document.rows.iter().enumerate().filter_map(dot).collect()
}

fn draw(
    document: &LayoutsDocument,
    root: &DrawingArea<SVGBackend<'_>, Shift>,
    panels: &[Panel],
) -> Result<(), Fault> {
    root.fill(&WHITE).map_err(fault)?;
    for (panel, area) in panels.iter().zip(root.split_evenly((1, panels.len()))) {
        let dots = dots(document, panel);
        let ends = |of: fn(&(usize, f64, f64)) -> f64| {
            let (least, most) = dots
                .iter()
                .map(of)
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)));
            let margin = 0.1 * (most - least).max(0.1);
            least - margin..most + margin
        };
        let mut chart = ChartBuilder::on(&area)
            .caption(panel.0, ("sans-serif", 16))
            .margin(8)
            .x_label_area_size(36)
            .y_label_area_size(48)
            .build_cartesian_2d(ends(|d| d.1), ends(|d| d.2))
            .map_err(fault)?;
        chart
            .configure_mesh()
            .x_desc("error of poses over that of points")
            .light_line_style(TRANSPARENT)
            .draw()
            .map_err(fault)?;
        for (number, x, y) in dots {
            let color = if number == 1 { BLACK } else { COLORS[number % COLORS.len()] };
            let dot = EmptyElement::at((x, y))
                + Circle::new((0, 0), 4, color.filled())
                + Text::new(number.to_string(), (6, -12), ("sans-serif", 13).into_font().color(&color));
            chart.draw_series(std::iter::once(dot)).map_err(fault)?;
        }
    }
    root.present().map_err(fault)
}
