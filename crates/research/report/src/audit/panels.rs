//! Images of true and recovered keypoints, and maps of the error.

use std::fmt::Write as _;

use veiloc_attacks::ErrorSummary;
use veiloc_geometry::Pixel;

use crate::attacked::CLASSES;
use crate::sent::{dots, sent as sent_layers};
use veiloc_evaluation::audit::{Shown, ShownAttack, ShownScheme};
use veiloc_evaluation::audit::{percent, px};

/// Dots drawn at most in a figure: more only make the file larger.
const MOST_DOTS: usize = 1600;
/// Lines from truth to answer drawn at most.
const MOST_LINES: usize = 300;
/// Share of answers outside the drawing from which on the view is zoomed out by two, as in the paper's Fig. 5 (d).
const ZOOM_OUT: f64 = 0.1;

/// One image's drawings: what they share is drawn once and referred to.
pub(super) struct Panels<'a> {
    shown: &'a Shown,
    /// Name of the shared layers on the page.
    id: String,
    /// A photograph stands behind the drawings.
    has_photograph: bool,
}

impl<'a> Panels<'a> {
    /// Drawings of an image; `id` tells it from others on the page.
    pub(super) fn new(shown: &'a Shown, id: impl Into<String>, has_photograph: bool) -> Self {
        Self { shown, id: id.into(), has_photograph }
    }

    /// The layers that the figures refer to, to be put on the page once, before them. `address`: the photograph.
    pub(super) fn shared(&self, address: Option<&str>) -> String {
        let (w, h) = self.shown.size;
        let id = &self.id;
        let photograph = address.map_or_else(String::new, |a| {
            format!("<image id=\"{id}photo\" width=\"{w}\" height=\"{h}\" preserveAspectRatio=\"none\" href=\"{a}\"/>")
        });
        let truth = dots(every(&self.shown.truth, MOST_DOTS).copied());
        format!(
            "<svg width=\"0\" height=\"0\" class=\"shared\" aria-hidden=\"true\"><defs>{photograph}<path id=\"{id}truth\" \
             fill=\"none\" stroke-linecap=\"round\" d=\"{truth}\"/></defs></svg>"
        )
    }

    /// A pixel of an image 640 wide.
    fn unit(&self) -> f64 {
        f64::from(self.shown.size.0.max(self.shown.size.1)).max(1.0) / 640.0
    }

    /// `extra`: the rim around the image, in shares of its longer side.
    fn open(&self, label: &str, rim: f64) -> String {
        let (w, h) = (f64::from(self.shown.size.0), f64::from(self.shown.size.1));
        let rim = w.max(h) * rim;
        format!(
            "<figure><svg viewBox=\"{:.0} {:.0} {:.0} {:.0}\" role=\"img\" aria-label=\"{label}\"><rect class=\"frame\" \
             width=\"{w}\" height=\"{h}\"/>",
            -rim,
            -rim,
            w + 2.0 * rim,
            h + 2.0 * rim
        )
    }

    fn backdrop(&self, class: &str) -> String {
        if self.has_photograph {
            format!("<use href=\"#{}photo\" class=\"{class}\"/>", self.id)
        } else {
            String::new()
        }
    }

    /// The true keypoints, over the photograph where there is one.
    pub(super) fn original(&self) -> String {
        format!(
            "{}{}{}{}</svg><figcaption><b>The \
             truth.</b> {} keypoints. This is what a scheme must hide.</figcaption></figure>",
            self.open("True keypoints", 0.02),
            self.backdrop("photo"),
            self.truth("keyring", 4.6),
            self.truth("key", 2.8),
            self.shown.truth.len(),
        )
    }

    /// The true keypoints as dots of a width in pixels of an image 640 wide.
    fn truth(&self, class: &str, width: f64) -> String {
        format!(
            "<use href=\"#{}truth\" class=\"{class}\" style=\"stroke-width:{:.1}\"/>",
            self.id,
            width * self.unit()
        )
    }

    /// What is sent under a scheme.
    pub(super) fn sent(&self, scheme: &ShownScheme, caption: &str) -> String {
        let (layers, remark) = sent_layers(&scheme.sent, self.shown.size);
        format!(
            "{}{layers}</svg><figcaption><b>{caption}</b> {remark}</figcaption></figure>",
            self.open("What is sent", 0.05)
        )
    }

    /// Where an attack puts the keypoints, each joined to where it is.
    pub(super) fn recovered(&self, attack: &ShownAttack, caption: &str) -> String {
        let (w, h) = (f64::from(self.shown.size.0), f64::from(self.shown.size.1));
        let outside = |rim: f64| {
            let rim = rim * w.max(h);
            let inside = |p: &Pixel| p.u > -rim && p.v > -rim && p.u < w + rim && p.v < h + rim;
            attack.answers.iter().filter(|p| !inside(p)).count()
        };
        let zoomed = outside(0.05) as f64 > ZOOM_OUT * attack.answers.len() as f64;
        let rim = if zoomed { 0.5 } else { 0.05 };
        let rows: Vec<usize> = (0..attack.answers.len().min(self.shown.truth.len())).collect();
        let mut lines = String::new();
        for &i in every(&rows, MOST_LINES) {
            let (t, a) = (self.shown.truth[i], attack.answers[i]);
            // A stub at the keypoint would be hidden by the dots.
            if attack.errors[i] > 4.0 * self.unit() && a.u.abs() < 1e5 && a.v.abs() < 1e5 {
                let _ = write!(lines, "M{:.0} {:.0}L{:.0} {:.0}", t.u, t.v, a.u, a.v);
            }
        }
        let lines =
            format!("<path class=\"off\" style=\"stroke-width:{:.2}\" d=\"{lines}\"/>", 0.8 * self.unit());
        let answers = by_class(&rows, |i| attack.answers[i], &attack.errors);
        let mut remarks = String::new();
        if zoomed {
            remarks.push_str(" Zoomed out by two.");
        }
        let gone = outside(rim);
        if gone > 0 {
            let _ = write!(remarks, " {gone} answers lie outside the drawing.");
        }
        if rows.len() > MOST_DOTS {
            let _ = write!(remarks, " One dot in {} is drawn.", rows.len().div_ceil(MOST_DOTS));
        }
        format!(
            "{}{}{}{lines}{}</svg><figcaption><b>{caption}</b> {}{remarks}</figcaption></figure>",
            self.open("Recovered keypoints", rim),
            self.backdrop("photo faint"),
            self.truth("was", 3.6),
            self.classes(&answers),
            tells(&attack.errors),
        )
    }

    /// The error of each keypoint, drawn where the keypoint is.
    pub(super) fn error_map(&self, attack: &ShownAttack, caption: &str) -> String {
        let rows: Vec<usize> = (0..attack.errors.len().min(self.shown.truth.len())).collect();
        let places = by_class(&rows, |i| self.shown.truth[i], &attack.errors);
        let under = attack.errors.iter().filter(|e| **e < 30.0).count();
        format!(
            "{}{}{}</svg><figcaption><b>{caption}</b> {under} of {} keypoints come out within 30 px.</figcaption></figure>",
            self.open("Error of each keypoint", 0.02),
            self.backdrop("photo faint"),
            self.classes(&places),
            rows.len(),
        )
    }

    /// The paper's Fig. 4 (d).
    pub(super) fn crossings(&self, scheme: &ShownScheme, caption: &str) -> String {
        let rows: Vec<usize> = (0..scheme.crossings.len().min(self.shown.truth.len())).collect();
        // From blue, all neighbours cross in one place, to red.
        let mut classes: [Vec<Pixel>; 5] = Default::default();
        for &i in every(&rows, MOST_DOTS) {
            let class = SPREADS.iter().position(|limit| scheme.crossings[i] >= *limit).unwrap_or(4);
            classes[class].push(self.shown.truth[i]);
        }
        let finite = scheme.crossings.iter().filter(|s| s.is_finite());
        let wild = finite.clone().filter(|s| **s >= 100.0).count();
        let flat = finite.filter(|s| **s < 1.0).count();
        format!(
            "{}{}</svg><figcaption><b>{caption}</b> Blue: under 1 px, all neighbours cross at the anchor ({flat} keypoints); \
             green, yellow: under 10, under 100 px; orange and red: 100 and 1000 px or more ({wild}).</figcaption></figure>",
            self.open("Spread of crossings", 0.02),
            self.classes(&classes),
        )
    }

    fn classes(&self, classes: &[Vec<Pixel>; 5]) -> String {
        let mut out = String::new();
        // The worst below, so that what is given away stays visible.
        for (k, points) in classes.iter().enumerate().rev().filter(|(_, p)| !p.is_empty()) {
            let _ = write!(
                out,
                "<path class=\"dot e{k}\" style=\"stroke-width:{:.1}\" d=\"{}\"/>",
                self.unit() * 5.0,
                dots(points.iter().copied())
            );
        }
        out
    }
}

/// Lower ends of the classes of crossing spreads, pixels; the last is open below.
const SPREADS: [f64; 4] = [1000.0, 100.0, 10.0, 1.0];

/// What the errors of one image say in a caption.
fn tells(errors: &[f64]) -> String {
    let s = ErrorSummary::of(errors);
    format!(
        "Median error {}; {} within 5 px, {} within 30 px.",
        px(s.median_px),
        percent(s.under_5px),
        percent(s.under_30px)
    )
}

/// At most `most` of them, evenly.
fn every<T>(all: &[T], most: usize) -> impl Iterator<Item = &T> {
    all.iter().step_by(all.len().div_ceil(most).max(1))
}

fn by_class(rows: &[usize], at: impl Fn(usize) -> Pixel, errors: &[f64]) -> [Vec<Pixel>; 5] {
    let mut classes: [Vec<Pixel>; 5] = Default::default();
    for &i in every(rows, MOST_DOTS) {
        classes[CLASSES.iter().position(|c| errors[i] < *c).unwrap_or(4)].push(at(i));
    }
    classes
}
