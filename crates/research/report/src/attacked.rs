//! What attacks make of one query, the one that succeeds beside those that do not.

use std::fmt::Write as _;

use veiloc_evaluation::audit::capital;
use veiloc_evaluation::results::metrics::median;
use veiloc_geometry::Pixel;

use crate::data::{AttackedBy, AttackedScheme};
use crate::format::{escape, percent, pixels, scheme_words};
use crate::histogram;
use crate::sent::{dots, view_box};

/// Upper ends of the error classes, pixels; the last class is open.
pub(crate) const CLASSES: [f64; 4] = [5.0, 10.0, 30.0, 100.0];

/// An attack that puts half of the keypoints to within so many pixels has succeeded.
const SUCCESS: f64 = 10.0;
/// One whose median error is under so much of the guess's tells something.
const GAIN: f64 = 0.75;

/// A block a scheme, in each the best attack first.
pub(crate) fn figures(schemes: &[AttackedScheme]) -> String {
    if schemes.is_empty() {
        return String::new();
    }
    let mut out = legend();
    for scheme in schemes {
        let (name, _) = scheme_words(&scheme.scheme);
        let _ = write!(out, "<h3>{name}</h3>");
        if scheme.attacks.is_empty() {
            out.push_str("<p>Nothing to recover: no attack was run on this scheme.</p>");
            continue;
        }
        let errors_of = |answers: &[Pixel]| errors(answers, &scheme.truth);
        let mut ranked: Vec<_> = scheme.attacks.iter().map(|a| (a, errors_of(&a.answers))).collect();
        ranked.sort_by(|a, b| median(&a.1).total_cmp(&median(&b.1)));
        out.push_str("<div class=\"row\">");
        let guess = median(&errors_of(&scheme.guessed));
        for (attack, errors) in &ranked {
            out.push_str(&recovered(scheme, attack, errors, guess));
        }
        if let Some((_, best)) = ranked.first() {
            out.push_str(&histogram::figure(best, &errors_of(&scheme.guessed)));
        }
        out.push_str("</div>");
    }
    out
}

fn legend() -> String {
    let words = ["under 5 px", "under 10 px", "under 30 px", "under 100 px", "100 px or more"];
    let mut out = String::from("<ul class=\"legend\"><li>Recovered points by their error:</li>");
    for (k, text) in words.iter().enumerate() {
        let _ = write!(
            out,
            "<li><svg viewBox=\"0 0 12 12\" aria-hidden=\"true\"><circle class=\"f{k}\" cx=\"6\" cy=\"6\" r=\"5\"/></svg>{text}</li>"
        );
    }
    out.push_str(
        "<li><svg viewBox=\"0 0 12 12\" aria-hidden=\"true\"><path class=\"dot truth\" d=\"M6 6h0\"/></svg>where the keypoint \
         is</li></ul>",
    );
    out
}

fn errors(answers: &[Pixel], truth: &[Pixel]) -> Vec<f64> {
    answers.iter().zip(truth).map(|(a, t)| a.distance(t)).collect()
}

/// Where an attack puts the keypoints. `errors`: of each, pixels; `guess`: the median error of the guess, not a number without one.
fn recovered(scheme: &AttackedScheme, attack: &AttackedBy, errors: &[f64], guess: f64) -> String {
    let AttackedBy { attack, told, answers } = attack;
    let (w, h) = scheme.size;
    let rim = f64::from(w.max(h)) * 0.05;
    let on_page =
        |p: &Pixel| p.u > -rim && p.v > -rim && p.u < f64::from(w) + rim && p.v < f64::from(h) + rim;
    let mut by_class: [Vec<Pixel>; 5] = Default::default();
    let mut outside = 0;
    for (r, error) in answers.iter().zip(errors) {
        by_class[CLASSES.iter().position(|c| error < c).unwrap_or(4)].push(*r);
        outside += usize::from(!on_page(r));
    }
    let mut layers = format!("<path class=\"dot truth\" d=\"{}\"/>", dots(scheme.truth.iter().copied()));
    // The worst below, so that what is given away stays visible.
    for (k, points) in by_class.iter().enumerate().rev() {
        if !points.is_empty() {
            let d = dots(points.iter().copied().filter(on_page));
            let _ = write!(layers, "<path class=\"dot e{k}\" d=\"{d}\"/>");
        }
    }
    let under = errors.iter().filter(|e| **e < 30.0).count() as f64 / errors.len().max(1) as f64;
    let gone =
        if outside > 0 { format!(" {outside} points fall outside the drawing.") } else { String::new() };
    let middle = median(errors);
    let verdict = if middle < SUCCESS {
        "<span class=\"verdict succeeds\">succeeds</span>"
    } else if middle < GAIN * guess {
        "<span class=\"verdict tells\">tells something</span>"
    } else {
        "<span class=\"verdict fails\">fails</span>"
    };
    let told = if *told { " An oracle told it which keypoints are neighbours." } else { "" };
    let words = escape(&capital(attack.words));
    format!(
        "<figure><svg viewBox=\"{view}\" role=\"img\" aria-label=\"Recovered keypoints: {words}\"><rect class=\"frame\" \
         width=\"{w}\" height=\"{h}\"/>{layers}</svg><figcaption><b>{words}</b> {verdict} {} of the keypoints come out \
         within 30 px, half of them within {}.{told}{gone}</figcaption></figure>",
        percent(Some(under)),
        pixels(middle),
        view = view_box(scheme.size),
    )
}
