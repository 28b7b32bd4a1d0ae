//! The trade-off as an image: recall over keypoints found, a panel an attack, a numbered dot a variant.

use plotters::coord::Shift;
use plotters::prelude::*;

use super::{COLORS, Fault, PlotError, fault};
use veiloc_evaluation::privacy::variants::{TradeoffDocument, VariantFigures};

/// Width and height of a panel, pixels.
const PANEL: (u32, u32) = (470, 400);

/// Attacks that get a panel, as far as they ran.
const ATTACKS: [&str; 3] = ["graph", "graph-30", "transfer"];

/// The document as SVG: for each attack the keypoints of an image it finds to within 10 px, on a logarithmic axis, and
/// the recall at the first threshold. Left and up is better; numbers are those of the table.
///
/// # Errors
/// [`PlotError::Nothing`] when there is nothing to draw.
pub fn plot(document: &TradeoffDocument) -> Result<String, PlotError> {
    let ran = |attack: &&str| document.variants.iter().any(|v| v.attack(attack).is_some());
    let attacks: Vec<&str> = ATTACKS.into_iter().filter(ran).collect();
    let (Some(threshold), false) = (document.thresholds.first(), attacks.is_empty()) else {
        return Err(PlotError::Nothing("no attack or no threshold to draw"));
    };
    let mut text = String::new();
    {
        let size = (PANEL.0 * attacks.len() as u32, PANEL.1);
        let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
        draw(document, &root, &attacks, threshold).map_err(|e| PlotError::Failed(e.to_string()))?;
    }
    Ok(text)
}

fn draw(
    document: &TradeoffDocument,
    root: &DrawingArea<SVGBackend<'_>, Shift>,
    attacks: &[&str],
    threshold: &str,
) -> Result<(), Fault> {
    root.fill(&WHITE).map_err(fault)?;
    let recall = |v: &VariantFigures| 100.0 * v.localization.recall[threshold];
    let lowest = document.variants.iter().map(recall).fold(100.0, f64::min);
    for (attack, area) in attacks.iter().zip(root.split_evenly((1, attacks.len()))) {
        let found = |v: &VariantFigures| v.attack(attack).map_or(0.0, |a| a.found_10px).max(0.5);
        let most = document.variants.iter().map(found).fold(10.0, f64::max);
        let least = document.variants.iter().map(found).fold(most, f64::min);
        let mut chart = ChartBuilder::on(&area)
            .caption(*attack, ("sans-serif", 16))
            .margin(8)
            .x_label_area_size(36)
            .y_label_area_size(48)
            .build_cartesian_2d((0.7 * least..1.5 * most).log_scale(), (lowest - 4.0).max(-4.0)..104.0_f64)
            .map_err(fault)?;
        chart
            .configure_mesh()
            .x_desc("keypoints of an image found to within 10 px")
            .y_desc(format!("poses within {threshold}, %"))
            .light_line_style(TRANSPARENT)
            .x_label_formatter(&|x| if is_round(*x) { format!("{x:.0}") } else { String::new() })
            .draw()
            .map_err(fault)?;
        for (index, v) in document.variants.iter().enumerate() {
            let at = (found(v), recall(v));
            let color = if index == 0 { BLACK } else { COLORS[index % COLORS.len()] };
            let dot = EmptyElement::at(at)
                + Circle::new((0, 0), 4, color.filled())
                + Text::new((index + 1).to_string(), (6, -12), ("sans-serif", 13).into_font().color(&color));
            chart.draw_series(std::iter::once(dot)).map_err(fault)?;
        }
    }
    root.present().map_err(fault)
}

/// Whether a number begins with 1, 2 or 5: the labels that a logarithmic axis has room for.
fn is_round(x: f64) -> bool {
    let leading = x / 10.0_f64.powf(x.log10().floor());
    [1.0, 2.0, 5.0, 10.0].iter().any(|digit| (leading - digit).abs() < 0.05)
}
