//! Charts as SVG: curves and dots, in the page's colours.

use std::fmt::Write as _;

use maud::{Markup, html};

use crate::numbers::significant;

/// Width of a chart in SVG units (about pixels).
const WIDTH: f64 = 400.0;
const LEFT: f64 = 50.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 30.0;
/// Height of the plotting area.
const TALL: f64 = 210.0;
/// Height of a line of the legend.
const LINE: f64 = 18.0;
/// Number of colours; further series reuse them.
const COLORS: usize = 8;
/// Maximum number of ticks of an axis.
const MAX_TICKS: usize = 12;
/// Maximum number of corners of a curve.
const MAX_CORNERS: usize = 400;

/// A chart with two axes.
pub(crate) struct Chart {
    /// Its title, shown above it and used as accessible name.
    pub(crate) title: String,
    pub(crate) x: Axis,
    pub(crate) y: Axis,
    pub(crate) series: Vec<Series>,
}

/// An axis.
pub(crate) struct Axis {
    pub(crate) label: String,
    pub(crate) ends: (f64, f64),
    pub(crate) is_logarithmic: bool,
}

/// How a series of points is drawn.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Mark {
    Line,
    /// A dashed grey line, for the reference of the others.
    Baseline,
    /// Dots joined by a line.
    DottedLine,
}

/// Points with a name; a series without a name is not in the legend.
pub(crate) struct Series {
    pub(crate) name: String,
    pub(crate) mark: Mark,
    pub(crate) points: Vec<(f64, f64)>,
}

impl Axis {
    pub(crate) fn linear(label: impl Into<String>, low: f64, high: f64) -> Self {
        Self { label: label.into(), ends: (low, high.max(low + 1e-9)), is_logarithmic: false }
    }

    pub(crate) fn logarithmic(label: impl Into<String>, low: f64, high: f64) -> Self {
        let low = low.max(1e-12);
        Self { label: label.into(), ends: (low, high.max(1.01 * low)), is_logarithmic: true }
    }

    /// Relative position of a value between the ends, 0 to 1.
    fn share(&self, value: f64) -> f64 {
        let ((low, high), value) = (self.ends, if value.is_nan() { self.ends.1 } else { value });
        let share = if self.is_logarithmic {
            (value.max(low) / low).ln() / (high / low).ln()
        } else {
            (value - low) / (high - low)
        };
        share.clamp(0.0, 1.0)
    }

    /// Round values between the ends.
    fn ticks(&self) -> Vec<f64> {
        let (low, high) = self.ends;
        if self.is_logarithmic {
            let decades = (low.log10().floor() as i32)..=(high.log10().ceil() as i32);
            let steps: &[f64] = if (high / low).log10() < 3.5 { &[1.0, 3.0] } else { &[1.0] };
            let all = decades.flat_map(|d| steps.iter().map(move |step| step * 10f64.powi(d)));
            return all.filter(|tick| *tick >= 0.999 * low && *tick <= 1.001 * high).collect();
        }
        let step = round_step((high - low) / 5.0);
        let (first, last) = ((low / step - 1e-9).ceil() as i64, (high / step + 1e-9).floor() as i64);
        (first..=last).take(MAX_TICKS).map(|k| k as f64 * step).collect()
    }
}

/// The smallest of 1, 2 and 5 times a power of ten that is not below `least`.
fn round_step(least: f64) -> f64 {
    let power = 10f64.powf(least.log10().floor());
    [1.0, 2.0, 5.0].into_iter().map(|m| m * power).find(|step| *step >= 0.999 * least).unwrap_or(10.0 * power)
}

impl Chart {
    /// The cumulative distribution of values on a logarithmic axis of bounds; non-finite values are within no bound.
    /// The second item of each series is true for the baseline.
    pub(crate) fn cumulative(title: &str, bound: &str, series: &[(&str, bool, &[f64])]) -> Self {
        let values = series.iter().flat_map(|(_, _, values)| *values).copied();
        let (mut least, mut most) = (f64::INFINITY, 0.0);
        for value in values.filter(|value| value.is_finite() && *value > 0.0) {
            (least, most) = (least.min(value), value.max(most));
        }
        // Without values the axes are empty.
        let ends = if most > 0.0 { (least.max(most * 1e-5), 1.1 * most) } else { (0.1, 10.0) };
        let curve = |(name, is_baseline, values): &(&str, bool, &[f64])| Series {
            name: (*name).to_owned(),
            mark: if *is_baseline { Mark::Baseline } else { Mark::Line },
            points: shares_within(values, ends),
        };
        Self {
            title: title.to_owned(),
            x: Axis::logarithmic(bound, ends.0, ends.1),
            y: Axis::linear("share within, %", 0.0, 100.0),
            series: series.iter().map(curve).collect(),
        }
    }

    /// The drawing for a page.
    pub(crate) fn svg(&self) -> Markup {
        let (height, legend) = self.legend();
        let at = |(x, y): (f64, f64)| self.position(x, y);
        let mut color = 0;
        let styles: Vec<String> = self.series.iter().map(|series| class(series, &mut color)).collect();
        html! {
            svg.chart viewBox=(format!("0 0 {WIDTH} {height:.0}")) role="img" aria-label=(self.title) {
                text.title x=(LEFT) y="18" { (self.title) }
                @for tick in self.x.ticks() {
                    @let x = LEFT + self.x.share(tick) * (WIDTH - LEFT - RIGHT);
                    path.grid d=(format!("M{x:.1} {TOP}v{TALL}")) {}
                    text x=(format!("{x:.1}")) y=(TOP + TALL + 16.0) text-anchor="middle" { (significant(tick)) }
                }
                @for tick in self.y.ticks() {
                    @let y = TOP + (1.0 - self.y.share(tick)) * TALL;
                    path.grid d=(format!("M{LEFT} {y:.1}H{}", WIDTH - RIGHT)) {}
                    text x=(LEFT - 6.0) y=(format!("{:.1}", y + 4.0)) text-anchor="end" { (significant(tick)) }
                }
                path.axis d=(format!("M{LEFT} {TOP}v{TALL}H{}", WIDTH - RIGHT)) {}
                text x=(f64::midpoint(LEFT, WIDTH - RIGHT)) y=(TOP + TALL + 34.0) text-anchor="middle" { (self.x.label) }
                text transform=(format!("translate(13 {}) rotate(-90)", TOP + TALL / 2.0)) text-anchor="middle" { (self.y.label) }
                @for (series, style) in self.series.iter().zip(&styles) {
                    path class={ "line " (style) } d=(path(series.points.iter().copied().map(at))) {}
                    @if series.mark == Mark::DottedLine {
                        @for point in series.points.iter().filter(|point| !point.0.is_nan()) {
                            @let (x, y) = at(*point);
                            // Values beyond the axis are drawn as hollow dots on its edge.
                            @let solid = if point.1 > self.y.ends.1 { "dot" } else { "dot solid" };
                            circle class={ (solid) " " (style) } cx=(format!("{x:.1}")) cy=(format!("{y:.1}")) r="3.5" {
                                title { (significant(point.0)) ", " (significant(point.1)) }
                            }
                        }
                    }
                }
                @for ((x, y), (series, style)) in legend.iter().zip(self.series.iter().zip(&styles).filter(|(s, _)| !s.name.is_empty())) {
                    path class={ "line " (style) } d=(format!("M{x:.0} {:.0}h18", y - 4.0)) {}
                    text x=(format!("{:.0}", x + 24.0)) y=(format!("{y:.0}")) { (series.name) }
                }
            }
        }
    }

    fn position(&self, x: f64, y: f64) -> (f64, f64) {
        (LEFT + self.x.share(x) * (WIDTH - LEFT - RIGHT), TOP + (1.0 - self.y.share(y)) * TALL)
    }

    /// Height of the drawing, and the position of each legend entry.
    fn legend(&self) -> (f64, Vec<(f64, f64)>) {
        let names: Vec<&str> =
            self.series.iter().map(|s| s.name.as_str()).filter(|n| !n.is_empty()).collect();
        legend(TOP + TALL + 54.0, &names)
    }
}

/// Names from left to right as they fit; widths are estimated from the number of characters.
fn legend(top: f64, names: &[&str]) -> (f64, Vec<(f64, f64)>) {
    let (mut x, mut y) = (LEFT - 30.0, top);
    let mut positions = Vec::new();
    for name in names {
        let wide = 38.0 + 6.6 * name.chars().count() as f64;
        if x + wide > WIDTH && x > LEFT - 30.0 {
            (x, y) = (LEFT - 30.0, y + LINE);
        }
        positions.push((x, y));
        x += wide;
    }
    (if names.is_empty() { top - 8.0 } else { y + 10.0 }, positions)
}

fn class(series: &Series, color: &mut usize) -> String {
    if series.mark == Mark::Baseline {
        return "baseline".to_owned();
    }
    *color += 1;
    format!("c{}", (*color - 1) % COLORS)
}

fn path(points: impl Iterator<Item = (f64, f64)>) -> String {
    points.fold(String::new(), |mut d, (x, y)| {
        let _ = write!(d, "{}{x:.1} {y:.1}", if d.is_empty() { 'M' } else { 'L' });
        d
    })
}

/// Corners of the cumulative curve: percent over the bound.
fn shares_within(values: &[f64], (low, high): (f64, f64)) -> Vec<(f64, f64)> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let share = |n: usize| 100.0 * n as f64 / values.len().max(1) as f64;
    if sorted.len() > MAX_CORNERS {
        let bounds = (0..=MAX_CORNERS).map(|k| low * (high / low).powf(k as f64 / MAX_CORNERS as f64));
        return bounds.map(|bound| (bound, share(sorted.partition_point(|value| *value <= bound)))).collect();
    }
    let mut corners = vec![(low, 0.0)];
    for (n, value) in sorted.iter().enumerate() {
        corners.extend([(*value, share(n)), (*value, share(n + 1))]);
    }
    corners.push((high, share(sorted.len())));
    corners
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_numbers() {
        let texts = |axis: Axis| axis.ticks().into_iter().map(significant).collect::<Vec<_>>();
        assert_eq!(texts(Axis::linear("", 0.0, 1.1)), ["0", "0.5", "1"]);
        assert_eq!(texts(Axis::linear("", 0.1, 0.7)), ["0.2", "0.4", "0.6"]);
        assert_eq!(texts(Axis::logarithmic("", 0.5, 120.0)), ["1", "3", "10", "30", "100"]);
        assert_eq!(texts(Axis::linear("", 0.0, 0.0)).len(), 6, "an axis without length");
    }

    #[test]
    fn cumulative_curve_equals_counting() {
        let values = [2.0, f64::NAN, 0.5, f64::INFINITY, 8.0];
        let corners = shares_within(&values, (0.5, 8.8));
        assert_eq!(corners.last(), Some(&(8.8, 60.0)), "two values of five are within no bound");
        assert!(corners.windows(2).all(|pair| pair[0].0 <= pair[1].0 && pair[0].1 <= pair[1].1));
        let many: Vec<f64> = (1..=1000).map(f64::from).collect();
        let corners = shares_within(&many, (1.0, 1000.0));
        let (bound, share) = corners[200];
        assert!((share - bound.floor() / 10.0).abs() < 1e-9, "{bound} {share}");
    }

    #[test]
    fn names_are_escaped() {
        let chart =
            Chart::cumulative("a <b>", "error, px", &[("<script>", false, &[1.0, 3.0]), ("x", true, &[])]);
        let svg = chart.svg();
        assert!(svg.0.contains("a &lt;b&gt;") && !svg.0.contains("<script") && svg.0.contains("baseline"));
    }
}
