//! Where the time of a query goes: median milliseconds of each stage, one above the other, a bar a scheme.

use plotters::prelude::*;
use veiloc_evaluation::results::tables::TableData;

use super::{COLORS, Fault, PlotError, fault};

/// Height of a bar with its margin, pixels.
const BAR: u32 = 34;

/// The document's median times.
///
/// # Errors
/// [`PlotError::Nothing`] when the document has none.
pub fn plot(data: &TableData) -> Result<String, PlotError> {
    // The axis counts upward, and the first row stands at the top.
    let mut rows = data.stage_times();
    rows.reverse();
    let longest = rows.iter().map(|(_, stages)| stages.iter().map(|s| s.1).sum::<f64>()).fold(0.0, f64::max);
    if longest <= 0.0 {
        return Err(PlotError::Nothing("no times to draw"));
    }
    let mut text = String::new();
    draw(&rows, longest, &mut text).map_err(|e| PlotError::Failed(e.to_string()))?;
    Ok(text)
}

fn draw(rows: &[(String, Vec<(&'static str, f64)>)], longest: f64, text: &mut String) -> Result<(), Fault> {
    let size = (760, BAR * rows.len() as u32 + 84);
    let root = SVGBackend::with_string(text, size).into_drawing_area();
    root.fill(&WHITE).map_err(fault)?;
    let count = rows.len();
    let mut chart = ChartBuilder::on(&root)
        .margin(8)
        .x_label_area_size(36)
        .y_label_area_size(150)
        .build_cartesian_2d(0.0..1.25 * longest, (0..count.saturating_sub(1)).into_segmented())
        .map_err(fault)?;
    let name = |at: &SegmentValue<usize>| match at {
        SegmentValue::CenterOf(at) => rows.get(*at).map(|row| row.0.clone()).unwrap_or_default(),
        SegmentValue::Exact(_) | SegmentValue::Last => String::new(),
    };
    chart
        .configure_mesh()
        .x_label_formatter(&|ms| format!("{ms}"))
        .disable_y_mesh()
        .light_line_style(TRANSPARENT)
        .x_desc("ms of a query, median of each stage")
        .y_labels(count)
        .y_label_formatter(&name)
        .draw()
        .map_err(fault)?;
    let mut stages: Vec<&'static str> = Vec::new();
    for stage in rows.iter().flat_map(|row| row.1.iter().map(|s| s.0)) {
        if !stages.contains(&stage) {
            stages.push(stage);
        }
    }
    for (index, stage) in stages.iter().enumerate() {
        let color = COLORS[index % COLORS.len()].mix(if index < COLORS.len() { 1.0 } else { 0.5 });
        let bars = rows.iter().enumerate().filter_map(|(at, (_, of_row))| {
            let before: f64 = of_row.iter().take_while(|s| s.0 != *stage).map(|s| s.1).sum();
            let own = of_row.iter().find(|s| s.0 == *stage)?.1;
            let corners = [(before, SegmentValue::Exact(at)), (before + own, SegmentValue::Exact(at + 1))];
            let mut bar = Rectangle::new(corners, color.filled());
            bar.set_margin(6, 6, 0, 0);
            Some(bar)
        });
        chart
            .draw_series(bars)
            .map_err(fault)?
            .label(*stage)
            .legend(move |(x, y)| Rectangle::new([(x, y - 5), (x + 12, y + 5)], color.filled()));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.8))
        .label_font(("sans-serif", 11))
        .draw()
        .map_err(fault)?;
    root.present().map_err(fault)
}
