//! Figures of one attacked image: what was sent, the recovered positions, their errors.

use std::fmt::Write as _;

use maud::{Markup, html};
use veiloc_attacks::ErrorSummary;
use veiloc_geometry::Pixel;
use veiloc_report::drawing::{Margin, dots, picture, sent, shared_image, strokes};
use veiloc_report::images::data_address;
use veiloc_report::numbers::{percent, pixels};
use veiloc_report::page::{figure, legend};

use crate::attack_evaluation::{ShownAttack, ShownImage, ShownScheme};

/// Maximum number of keypoints in a figure; more only increase the file.
const MAX_DOTS: usize = 1600;
/// Maximum number of lines from truth to answer.
const MAX_ERRORS: usize = 300;
/// Share of answers outside the drawing above which the view is zoomed out by two, as in the paper's Fig. 5 (d).
const ZOOM_OUT: f64 = 0.1;
/// Upper ends of the error classes, pixels; the last class is open.
const CLASSES: [f64; 4] = [5.0, 10.0, 30.0, 100.0];

/// Legend of the colours of recovered keypoints.
pub(super) fn error_legend() -> Markup {
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
pub(super) struct AttackFigures<'a> {
    shown: &'a ShownImage,
    /// Distinguishes the layers from those of other images.
    id: &'a str,
    photograph: Option<String>,
}

impl<'a> AttackFigures<'a> {
    pub(super) fn new(shown: &'a ShownImage, id: &'a str) -> Self {
        Self { shown, id, photograph: shown.photograph.as_ref().and_then(data_address) }
    }

    /// The shared layers, which must precede the figures.
    pub(super) fn shared(&self) -> Markup {
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

    fn figure(&self, label: &str, margin: Margin, layers: &Markup, caption: &str, remark: &str) -> Markup {
        let label = format!("{label}, {}", self.shown.name);
        figure(&picture(&label, self.shown.size, margin, layers), &html! { b { (caption) } " " (remark) })
    }

    /// The true keypoints, over the photograph if there is one.
    pub(super) fn original(&self) -> Markup {
        let layers = html! { (self.backdrop("photograph")) (self.truth("ring")) (self.truth("keypoint")) };
        let remark = format!("{} keypoints; a scheme must hide their positions.", self.shown.truth.len());
        self.figure("True keypoints", Margin::Narrow, &layers, "True keypoints.", &remark)
    }

    /// The rows sent under a scheme.
    pub(super) fn sent(&self, scheme: &ShownScheme, caption: &str) -> Markup {
        let (layers, remark) = sent(&scheme.sent, self.shown.size);
        self.figure("What is sent", Margin::Narrow, &layers, caption, &remark)
    }

    /// Positions recovered by an attack, some of them joined to the truth.
    pub(super) fn recovered(&self, attack: &ShownAttack, caption: &str) -> Markup {
        let (w, h) = (f64::from(self.shown.size.0), f64::from(self.shown.size.1));
        let outside = |margin: Margin| {
            let margin = margin.of(self.shown.size);
            let inside = |p: &&Pixel| p.u > -margin && p.v > -margin && p.u < w + margin && p.v < h + margin;
            attack.answers.len() - attack.answers.iter().filter(inside).count()
        };
        let is_zoomed = outside(Margin::Narrow) as f64 > ZOOM_OUT * attack.answers.len() as f64;
        let margin = if is_zoomed { Margin::Wide } else { Margin::Narrow };
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
        let gone = outside(margin);
        if is_zoomed {
            remark.push_str(" Zoomed out by two.");
        }
        if gone > 0 {
            let _ = write!(remark, " {gone} lie outside the drawing.");
        }
        self.figure("Recovered keypoints", margin, &layers, caption, &remark)
    }

    /// The error of each keypoint, drawn at the true position: the paper's Fig. 4 (c).
    pub(super) fn error_map(&self, attack: &ShownAttack, caption: &str) -> Markup {
        let rows: Vec<usize> = (0..attack.errors.len().min(self.shown.truth.len())).collect();
        let layers = by_class(
            every(&rows, MAX_DOTS).map(|&row| (self.shown.truth[row], class_of(attack.errors[row]))),
        );
        let under = attack.errors.iter().filter(|error| **error < 30.0).count();
        let remark = format!("{under} of {} keypoints are recovered to within 30 px.", rows.len());
        self.figure("Error of each keypoint", Margin::Narrow, &layers, caption, &remark)
    }

    /// The standard deviation of the positions at which a line intersects its neighbours' lines: the paper's Fig. 4
    /// (d).
    pub(super) fn crossings(&self, scheme: &ShownScheme, caption: &str) -> Markup {
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
        self.figure("Spread of crossings", Margin::Narrow, &layers, caption, &remark)
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
