//! What is sent of a query, drawn: whole, or coloured by what the server made of each row.

use std::fmt::Write as _;

use veiloc_geometry::{Pixel, PixelLine};
use veiloc_protocol::Observations;

use crate::run::{RowState, SentDrawing};

/// Lines drawn at most: more are only a smear.
const MOST_LINES: usize = 400;

/// What is sent, and a remark for the caption.
pub(crate) fn sent(sent: &Observations, size: (u32, u32)) -> (String, String) {
    let every = sent.len().div_ceil(MOST_LINES).max(1);
    let shown = sent.len().div_ceil(every);
    let remark = |kind: &str| match sent.len() {
        n if shown < n => format!("{shown} of {n} {kind} are drawn."),
        n => format!("{n} {kind}."),
    };
    match sent {
        Observations::Points(points) => {
            let d = dots(points.iter().copied());
            (format!("<path class=\"dot e0\" d=\"{d}\"/>"), format!("{} positions.", points.len()))
        }
        Observations::Lines(_) => {
            let d = strokes((0..sent.len()).step_by(every).flat_map(|row| stretches(sent, row, size)));
            (format!("<path class=\"lines1\" d=\"{d}\"/>"), remark("lines"))
        }
        Observations::EitherLine(pairs) => {
            let d = strokes((0..pairs.len()).flat_map(|row| stretches(sent, row, size)));
            let note = format!(
                "{} mixed positions (crosses): the keypoint is somewhere above, below, left or right of its cross.",
                pairs.len()
            );
            (format!("<path class=\"lines1\" d=\"{d}\"/>"), note)
        }
        Observations::Anchored { pencils, lines } => {
            let mut drawn = String::new();
            for anchor in pencils.anchors() {
                let own = (0..lines.len()).filter(|row| lines[*row].anchor == anchor).step_by(every);
                // Two colours tell neighbouring pencils apart.
                let class = if anchor.index().is_multiple_of(2) { "lines1" } else { "lines2" };
                let d = strokes(own.flat_map(|row| stretches(sent, row, size)));
                let _ = write!(drawn, "<path class=\"{class}\" d=\"{d}\"/>");
            }
            drawn.push_str(&anchors(sent));
            (drawn, format!("{} The discs are the anchors.", remark("half-lines")))
        }
    }
}

/// The same by what became of each row: not matched below, agreeing on top, and a dot where the pose puts an agreeing row's map
/// point.
pub(crate) fn matched(drawing: &SentDrawing) -> String {
    let SentDrawing { sent, size, rows, projected, .. } = drawing;
    let has_lines = matches!(sent, Observations::Lines(_) | Observations::Anchored { .. });
    let mut out = String::new();
    for (state, class, most) in [
        (RowState::Unmatched, "unmatched", 120),
        (RowState::Disagrees, "disagrees", 120),
        (RowState::Agrees, "agrees", 200),
    ] {
        let own: Vec<usize> =
            (0..sent.len()).filter(|row| rows.get(*row).copied().unwrap_or_default() == state).collect();
        // Dots and crosses stay readable where lines do not.
        let every = if has_lines { own.len().div_ceil(most).max(1) } else { 1 };
        let own = own.iter().copied().step_by(every);
        let path = if let Observations::Points(points) = sent {
            format!("<path class=\"dot {class}\" d=\"{}\"/>", dots(own.map(|row| points[row])))
        } else {
            let d = strokes(own.flat_map(|row| stretches(sent, row, *size)));
            format!("<path class=\"line {class}\" d=\"{d}\"/>")
        };
        out.push_str(&path);
    }
    out.push_str(&anchors(sent));
    if !matches!(sent, Observations::Points(_)) {
        let d = dots(projected.iter().copied());
        let _ = write!(out, "<path class=\"dot ring\" d=\"{d}\"/><path class=\"dot seen\" d=\"{d}\"/>");
    }
    out
}

/// Strokes of one row: the part of its line where the keypoint may be, or a cross.
fn stretches(sent: &Observations, row: usize, size: (u32, u32)) -> Vec<[Pixel; 2]> {
    match sent {
        Observations::Points(_) => Vec::new(),
        Observations::Lines(lines) => chord(&lines[row], size).into_iter().collect(),
        Observations::EitherLine(pairs) => {
            let [a, b] = &pairs[row];
            let arm = 0.012 * f64::from(size.0.max(size.1));
            let cross = |p: Pixel| {
                let at = |du: f64, dv: f64| Pixel::new(p.u + du, p.v + dv);
                [[at(-arm, 0.0), at(arm, 0.0)], [at(0.0, -arm), at(0.0, arm)]]
            };
            a.intersection(b).map(cross).into_iter().flatten().collect()
        }
        Observations::Anchored { pencils, lines } => {
            let line = lines[row];
            let Some(along) = pencils.along(line.anchor, line.angle) else { return Vec::new() };
            let spans = pencils.spans(line.anchor, line.angle);
            spans.into_iter().map(|span| [along.at(span.near), along.at(span.far)]).collect()
        }
    }
}

/// Where rows can come from, where that is in sight.
fn anchors(sent: &Observations) -> String {
    let Observations::Anchored { pencils, .. } = sent else { return String::new() };
    let [w, h] = pencils.size();
    let mut out = String::new();
    for anchor in pencils.anchors() {
        let in_sight = |p: &Pixel| (p.u - w / 2.0).abs() <= w && (p.v - h / 2.0).abs() <= h;
        if let Some(from) = pencils.position(anchor).filter(in_sight) {
            let colour = if anchor.index().is_multiple_of(2) { "first" } else { "second" };
            let _ = write!(
                out,
                "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{:.1}\" class=\"anchor-{colour}\"/>",
                from.u,
                from.v,
                0.012 * w.max(h),
            );
        }
    }
    out
}

/// The image with a rim, so that anchors and points just outside are seen.
pub(crate) fn view_box((w, h): (u32, u32)) -> String {
    let rim = f64::from(w.max(h)) * 0.05;
    format!("{:.0} {:.0} {:.0} {:.0}", -rim, -rim, f64::from(w) + 2.0 * rim, f64::from(h) + 2.0 * rim)
}

/// Dots as one path: zero-length strokes with round caps. Positions far outside or not finite are left out.
pub(crate) fn dots(points: impl Iterator<Item = Pixel>) -> String {
    points.filter(|p| p.u.abs() < 1e5 && p.v.abs() < 1e5).fold(String::new(), |mut d, p| {
        let _ = write!(d, "M{:.1} {:.1}h0", p.u, p.v);
        d
    })
}

fn strokes(segments: impl Iterator<Item = [Pixel; 2]>) -> String {
    segments.filter(|s| s.iter().all(Pixel::is_finite)).fold(String::new(), |mut d, [a, b]| {
        let _ = write!(d, "M{:.1} {:.1}L{:.1} {:.1}", a.u, a.v, b.u, b.v);
        d
    })
}

/// The part of a line in the image.
fn chord(line: &PixelLine, (w, h): (u32, u32)) -> Option<[Pixel; 2]> {
    let (o, v) = (line.closest_point(Pixel::new(f64::from(w) / 2.0, f64::from(h) / 2.0)), line.direction());
    let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
    for (at, step, size) in [(o.u, v.x, f64::from(w)), (o.v, v.y, f64::from(h))] {
        if step.abs() > 1e-12 {
            let (a, b) = (-at / step, (size - at) / step);
            (near, far) = (near.max(a.min(b)), far.min(a.max(b)));
        }
    }
    (near < far).then(|| [near, far].map(|t| Pixel::new(o.u + t * v.x, o.v + t * v.y)))
}
