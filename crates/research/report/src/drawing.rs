//! Keypoints and lines over an image: sent rows, their matches, and positions recovered by attacks.

use std::fmt::Write as _;

use maud::{Markup, html};
use veiloc_attacks::ErrorSummary;
use veiloc_evaluation::attack_evaluation::{ShownAttack, ShownImage, ShownScheme};
use veiloc_geometry::{Pixel, PixelLine};
use veiloc_protocol::Observations;

use crate::images::data_address;
use crate::numbers::{percent, pixels};
use crate::page::{figure, legend};
use crate::scene::{MatchState, SentDrawing};

/// Maximum number of lines; more are unreadable.
const MAX_LINES: usize = 400;
/// Maximum number of keypoints in a figure; more only increase the file.
const MAX_DOTS: usize = 1600;
/// Maximum number of lines from truth to answer.
const MAX_ERRORS: usize = 300;
/// Share of answers outside the drawing above which the view is zoomed out by two, as in the paper's Fig. 5 (d).
const ZOOM_OUT: f64 = 0.1;
/// Upper ends of the error classes, pixels; the last class is open.
const CLASSES: [f64; 4] = [5.0, 10.0, 30.0, 100.0];

/// The margin around an image.
#[derive(Clone, Copy)]
pub(crate) enum Rim {
    /// A margin for anchors and answers just outside the image.
    Narrow,
    /// Twice the width and height of the image.
    Wide,
}

impl Rim {
    /// Width of the margin, pixels of the image.
    fn of(self, (width, height): (u32, u32)) -> f64 {
        f64::from(width.max(height)) * if matches!(self, Self::Wide) { 0.5 } else { 0.05 }
    }
}

/// A drawing in pixel coordinates of an image.
pub(crate) fn picture(label: &str, size: (u32, u32), rim: Rim, layers: &Markup) -> Markup {
    let ((w, h), rim) = (size, rim.of(size));
    let view =
        format!("{:.0} {:.0} {:.0} {:.0}", -rim, -rim, f64::from(w) + 2.0 * rim, f64::from(h) + 2.0 * rim);
    html! {
        svg.picture viewBox=(view) role="img" aria-label=(label) { rect.frame width=(w) height=(h) {} (layers) }
    }
}

/// An image that drawings reference by its id.
pub(crate) fn shared_image(id: &str, (width, height): (u32, u32), address: &str) -> Markup {
    html! {
        svg.shared width="0" height="0" aria-hidden="true" {
            defs { image #(id) width=(width) height=(height) preserveAspectRatio="none" href=(address) {} }
        }
    }
}

/// The sent rows, and a remark for the caption.
pub(crate) fn sent(sent: &Observations, size: (u32, u32)) -> (Markup, String) {
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
pub(crate) fn matched(drawing: &SentDrawing) -> Markup {
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
pub(crate) fn dots(points: impl Iterator<Item = Pixel>) -> String {
    points.filter(|p| p.u.abs() < 1e5 && p.v.abs() < 1e5).fold(String::new(), |mut d, p| {
        let _ = write!(d, "M{:.1} {:.1}h0", p.u, p.v);
        d
    })
}

fn strokes(segments: impl Iterator<Item = [Pixel; 2]>) -> String {
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

/// Legend of the colours of recovered keypoints.
pub(crate) fn error_legend() -> Markup {
    legend(&[
        ("dot e0", "error under 5 px"),
        ("dot e1", "under 10 px"),
        ("dot e2", "under 30 px"),
        ("dot e3", "under 100 px"),
        ("dot e4", "100 px or more"),
        ("dot truth", "true keypoint"),
    ])
}

/// The figures of one attacked image. Its layers are on the page once, and figures reference them.
pub(crate) struct AttackFigures<'a> {
    shown: &'a ShownImage,
    /// Distinguishes the layers from those of other images.
    id: &'a str,
    photograph: Option<String>,
}

impl<'a> AttackFigures<'a> {
    pub(crate) fn new(shown: &'a ShownImage, id: &'a str) -> Self {
        Self { shown, id, photograph: shown.photograph.as_ref().and_then(data_address) }
    }

    /// The shared layers, which must precede the figures.
    pub(crate) fn shared(&self) -> Markup {
        html! {
            @if let Some(address) = &self.photograph {
                (shared_image(&format!("{}-photograph", self.id), self.shown.size, address))
            }
            svg.shared width="0" height="0" aria-hidden="true" {
                defs { path id={ (self.id) "-truth" } d=(dots(every(&self.shown.truth, MAX_DOTS).copied())) {} }
            }
        }
    }

    fn backdrop(&self, class: &str) -> Markup {
        html! { @if self.photograph.is_some() { use class=(class) href={ "#" (self.id) "-photograph" } {} } }
    }

    fn truth(&self, class: &str) -> Markup {
        html! { use class={ "dot " (class) } href={ "#" (self.id) "-truth" } {} }
    }

    fn figure(&self, label: &str, rim: Rim, layers: &Markup, caption: &str, remark: &str) -> Markup {
        let label = format!("{label}, {}", self.shown.name);
        figure(&picture(&label, self.shown.size, rim, layers), &html! { b { (caption) } " " (remark) })
    }

    /// The true keypoints, over the photograph if there is one.
    pub(crate) fn original(&self) -> Markup {
        let layers = html! { (self.backdrop("photograph")) (self.truth("ring")) (self.truth("keypoint")) };
        let remark = format!("{} keypoints; a scheme must hide their positions.", self.shown.truth.len());
        self.figure("True keypoints", Rim::Narrow, &layers, "True keypoints.", &remark)
    }

    /// The rows sent under a scheme.
    pub(crate) fn sent(&self, scheme: &ShownScheme, caption: &str) -> Markup {
        let (layers, remark) = sent(&scheme.sent, self.shown.size);
        self.figure("What is sent", Rim::Narrow, &layers, caption, &remark)
    }

    /// Positions recovered by an attack, some of them joined to the truth.
    pub(crate) fn recovered(&self, attack: &ShownAttack, caption: &str) -> Markup {
        let (w, h) = (f64::from(self.shown.size.0), f64::from(self.shown.size.1));
        let outside = |rim: Rim| {
            let rim = rim.of(self.shown.size);
            let inside = |p: &&Pixel| p.u > -rim && p.v > -rim && p.u < w + rim && p.v < h + rim;
            attack.answers.len() - attack.answers.iter().filter(inside).count()
        };
        let is_zoomed = outside(Rim::Narrow) as f64 > ZOOM_OUT * attack.answers.len() as f64;
        let rim = if is_zoomed { Rim::Wide } else { Rim::Narrow };
        let rows: Vec<usize> = (0..attack.answers.len().min(self.shown.truth.len())).collect();
        let errors = every(&rows, MAX_ERRORS).map(|&row| [self.shown.truth[row], attack.answers[row]]);
        let layers = html! {
            (self.backdrop("faint"))
            (self.truth("truth"))
            path.error d=(strokes(errors)) {}
            (by_class(every(&rows, MAX_DOTS).map(|&row| (attack.answers[row], class_of(attack.errors[row])))))
        };
        let summary = ErrorSummary::of(&attack.errors);
        let mut remark = format!(
            "Median error {}, {} within 10 px.",
            pixels(summary.median_px),
            percent(summary.under_10px)
        );
        let gone = outside(rim);
        if is_zoomed {
            remark.push_str(" Zoomed out by two.");
        }
        if gone > 0 {
            let _ = write!(remark, " {gone} lie outside the drawing.");
        }
        self.figure("Recovered keypoints", rim, &layers, caption, &remark)
    }

    /// The error of each keypoint, drawn at the true position: the paper's Fig. 4 (c).
    pub(crate) fn error_map(&self, attack: &ShownAttack, caption: &str) -> Markup {
        let rows: Vec<usize> = (0..attack.errors.len().min(self.shown.truth.len())).collect();
        let layers = by_class(
            every(&rows, MAX_DOTS).map(|&row| (self.shown.truth[row], class_of(attack.errors[row]))),
        );
        let under = attack.errors.iter().filter(|error| **error < 30.0).count();
        let remark = format!("{under} of {} keypoints are recovered to within 30 px.", rows.len());
        self.figure("Error of each keypoint", Rim::Narrow, &layers, caption, &remark)
    }

    /// The standard deviation of the positions at which a line intersects its neighbours' lines: the paper's Fig. 4
    /// (d).
    pub(crate) fn crossings(&self, scheme: &ShownScheme, caption: &str) -> Markup {
        /// Lower ends of the classes, pixels; the last class is open below.
        const SPREADS: [f64; 4] = [1000.0, 100.0, 10.0, 1.0];
        let rows: Vec<usize> = (0..scheme.crossings.len().min(self.shown.truth.len())).collect();
        let class =
            |row: usize| SPREADS.iter().position(|limit| scheme.crossings[row] >= *limit).unwrap_or(4);
        let layers = by_class(every(&rows, MAX_DOTS).map(|&row| (self.shown.truth[row], class(row))));
        let flat = scheme.crossings.iter().filter(|spread| **spread < 1.0).count();
        let remark = format!(
            "Blue: under 1 px, the neighbours cross at the anchor ({flat} keypoints); green, yellow: under 10, under 100 px; \
             orange, red: 100, 1000 px or more."
        );
        self.figure("Spread of crossings", Rim::Narrow, &layers, caption, &remark)
    }
}

fn class_of(error: f64) -> usize {
    CLASSES.iter().position(|limit| error < *limit).unwrap_or(4)
}

/// Dots in the colours of their classes. The last class is drawn first, so that recovered keypoints stay visible.
fn by_class(points: impl Iterator<Item = (Pixel, usize)>) -> Markup {
    let mut classes: [Vec<Pixel>; 5] = Default::default();
    points.for_each(|(point, class)| classes[class].push(point));
    html! {
        @for (class, points) in classes.iter().enumerate().rev() {
            @if !points.is_empty() { path class={ "dot e" (class) } d=(dots(points.iter().copied())) {} }
        }
    }
}

/// At most `most` elements, evenly spaced.
fn every<T>(all: &[T], most: usize) -> impl Iterator<Item = &T> {
    all.iter().step_by(all.len().div_ceil(most).max(1))
}
