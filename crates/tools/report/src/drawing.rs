//! Keypoints and lines over an image: sent rows and their matches.

use std::fmt::Write as _;

use maud::{Markup, html};
use veiloc_geometry::{Pixel, PixelLine};
use veiloc_protocol::Observations;

use crate::scene::{MatchState, SentDrawing};

/// Maximum number of lines; more are unreadable.
const MAX_LINES: usize = 400;

/// The margin around an image.
#[derive(Clone, Copy)]
pub enum Margin {
    /// A margin for anchors and answers just outside the image.
    Narrow,
    /// Twice the width and height of the image.
    Wide,
}

impl Margin {
    /// Width of the margin, pixels of the image.
    pub fn of(self, (width, height): (u32, u32)) -> f64 {
        f64::from(width.max(height)) * if matches!(self, Self::Wide) { 0.5 } else { 0.05 }
    }
}

/// A drawing in pixel coordinates of an image.
pub fn picture(label: &str, size: (u32, u32), margin: Margin, layers: &Markup) -> Markup {
    let ((w, h), margin) = (size, margin.of(size));
    let view = format!(
        "{:.0} {:.0} {:.0} {:.0}",
        -margin,
        -margin,
        f64::from(w) + 2.0 * margin,
        f64::from(h) + 2.0 * margin
    );
    html! {
        svg.picture viewBox=(view) role="img" aria-label=(label) { rect.frame width=(w) height=(h) {} (layers) }
    }
}

/// An image that drawings reference by its id.
pub fn shared_image(id: &str, (width, height): (u32, u32), address: &str) -> Markup {
    html! {
        svg.shared width="0" height="0" aria-hidden="true" {
            defs { image #(id) width=(width) height=(height) preserveAspectRatio="none" href=(address) {} }
        }
    }
}

/// The sent rows, and a remark for the caption.
pub fn sent(sent: &Observations, size: (u32, u32)) -> (Markup, String) {
    let every = sent.len().div_ceil(MAX_LINES).max(1);
    let shown = sent.len().div_ceil(every);
    let remark = |kind: &str| match sent.len() {
        n if shown < n => format!("{shown} of {n} {kind} are drawn."),
        n => format!("{n} {kind}."),
    };
    let strokes_of =
        |rows: &mut dyn Iterator<Item = usize>| strokes(rows.flat_map(|row| stretches(sent, row, size)));
    match sent {
        Observations::Points(points) => {
            let drawn = html! { path class="dot e0" d=(dots(points.iter().copied())) {} };
            (drawn, format!("{} positions.", points.len()))
        }
        Observations::Lines(_) => {
            (html! { path.first d=(strokes_of(&mut (0..sent.len()).step_by(every))) {} }, remark("lines"))
        }
        Observations::EitherLine(pairs) => {
            let drawn = html! { path.first d=(strokes_of(&mut (0..pairs.len()))) {} };
            let note = "mixed positions (crosses): the keypoint is above, below, left or right of its cross.";
            (drawn, format!("{} {note}", pairs.len()))
        }
        Observations::Anchored { pencils, lines } => {
            let drawn = html! {
                @for anchor in pencils.anchors() {
                    @let mut own = (0..lines.len()).filter(|row| lines[*row].anchor == anchor).step_by(every);
                    path class=(color_of(anchor.index())) d=(strokes_of(&mut own)) {}
                }
                (anchors(sent))
            };
            (drawn, format!("{} The discs are the anchors.", remark("half-lines")))
        }
    }
}

/// Two alternating colours distinguish neighbouring anchors.
const fn color_of(anchor: usize) -> &'static str {
    if anchor.is_multiple_of(2) { "first" } else { "second" }
}

/// Sent rows coloured by their match: inliers on top, with a dot at the projection of the inlier's map point.
pub fn matched(drawing: &SentDrawing) -> Markup {
    let SentDrawing { sent, size, rows, projected, .. } = drawing;
    let has_lines = matches!(sent, Observations::Lines(_) | Observations::Anchored { .. });
    let of_state = |state: MatchState, most: usize| {
        let own: Vec<usize> =
            (0..sent.len()).filter(|row| rows.get(*row).copied().unwrap_or_default() == state).collect();
        // Dots and crosses stay readable at a density at which lines do not.
        let every = if has_lines { own.len().div_ceil(most).max(1) } else { 1 };
        let own = own.into_iter().step_by(every);
        match sent {
            Observations::Points(points) => ("dot", dots(own.map(|row| points[row]))),
            _ => ("line", strokes(own.flat_map(|row| stretches(sent, row, *size)))),
        }
    };
    let layers = [
        (MatchState::Unmatched, "unmatched", 120),
        (MatchState::Outlier, "outlier", 120),
        (MatchState::Inlier, "inlier", 200),
    ];
    html! {
        @for (state, class, most) in layers {
            @let (kind, d) = of_state(state, most);
            path class={ (kind) " " (class) } d=(d) {}
        }
        (anchors(sent))
        @if !matches!(sent, Observations::Points(_)) {
            @let d = dots(projected.iter().copied());
            path class="dot ring" d=(d) {}
            path class="dot seen" d=(d) {}
        }
    }
}

/// Strokes of one row: the part of its line that can hold the keypoint, or a cross.
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

/// The anchors inside the drawing.
fn anchors(sent: &Observations) -> Markup {
    let Observations::Anchored { pencils, .. } = sent else { return html! {} };
    let [w, h] = pencils.size();
    let in_sight = |p: &Pixel| (p.u - w / 2.0).abs() <= w && (p.v - h / 2.0).abs() <= h;
    let number = |x: f64| format!("{x:.1}");
    html! {
        @for anchor in pencils.anchors() {
            @if let Some(from) = pencils.position(anchor).filter(in_sight) {
                circle class={ "anchor " (color_of(anchor.index())) } cx=(number(from.u)) cy=(number(from.v)) r=(number(0.012 * w.max(h))) {}
            }
        }
    }
}

/// Dots as one path: zero-length strokes with round caps. Positions far outside or not finite are left out.
pub fn dots(points: impl Iterator<Item = Pixel>) -> String {
    points.filter(|p| p.u.abs() < 1e5 && p.v.abs() < 1e5).fold(String::new(), |mut d, p| {
        let _ = write!(d, "M{:.1} {:.1}h0", p.u, p.v);
        d
    })
}

/// Line segments as one path. Ends far outside or not finite are left out.
pub fn strokes(segments: impl Iterator<Item = [Pixel; 2]>) -> String {
    let drawn = segments.filter(|ends| ends.iter().all(|p| p.u.abs() < 1e5 && p.v.abs() < 1e5));
    drawn.fold(String::new(), |mut d, [a, b]| {
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
