//! What became of one query: the image, what was sent, what the attack made of it.

use std::fmt::Write as _;

use veiloc_geometry::{Pixel, PixelLine};
use veiloc_query::Observations;

use super::data::{QueryPanel, SchemePanel};
use super::embed::data_address;
use super::format::{escape, percent, pixels, scheme_words};
use super::histogram;

/// Lines drawn at most: more are only a smear.
const MOST_LINES: usize = 400;

/// Upper ends of the error classes, pixels; the last class is open.
pub(super) const CLASSES: [f64; 4] = [5.0, 10.0, 30.0, 100.0];

pub(super) fn section(panels: &[QueryPanel]) -> String {
    if panels.is_empty() {
        return String::new();
    }
    let mut out = String::from(
        "<section><h2>One query, seen by the device, the server and an attacker</h2>\
         <p>A keypoint is a place in an image that can be found again in other images. Where keypoints are known, an \
         image can be drawn from them; so their positions are what a scheme must hide.</p>",
    );
    for panel in panels {
        out.push_str(&image(panel));
        out.push_str(&legend());
        for scheme in &panel.schemes {
            out.push_str(&scheme_row(scheme));
        }
    }
    out.push_str("</section>");
    out
}

fn image(panel: &QueryPanel) -> String {
    let (w, h) = panel.image.dimensions();
    let Some(address) = data_address(&panel.image) else { return String::new() };
    let points = dots(panel.keypoints.iter().copied());
    format!(
        "<h3>Query: {name}</h3><div class=\"see\"><figure><svg viewBox=\"0 0 {w} {h}\" role=\"img\" \
         aria-label=\"Image with keypoints\"><image width=\"{w}\" height=\"{h}\" href=\"{address}\"/>\
         <path class=\"dot keypoint\" d=\"{points}\"/><path class=\"dot keypoint2\" d=\"{points}\"/></svg><figcaption>\
         <b>What the camera saw.</b> {count} keypoints. Neither this image nor the positions of the dots leave the \
         device, except under the scheme “Points”.</figcaption></figure><ol><li><b>As sent</b>, left below: all that the \
         server gets about positions. Each line comes with a descriptor, a fingerprint of what the place looks \
         like.</li><li><b>As recovered</b>, in the middle: where our strongest attack puts the keypoints, told by an \
         oracle which of them are neighbours. Red means given away, blue means missed. What attackers get \
         without that oracle is in docs/audit.md.</li><li><b>How far off</b>, on the right: the errors \
         counted, beside a guess that looks at nothing but each single line.</li></ol></div>",
        name = escape(&panel.name),
        count = panel.keypoints.len(),
    )
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
        "<li><svg viewBox=\"0 0 12 12\" aria-hidden=\"true\"><path class=\"dot truth\" style=\"stroke-width:6\" d=\"M6 6h0\"/>\
         </svg>where the keypoint is</li></ul>",
    );
    out
}

fn scheme_row(panel: &SchemePanel) -> String {
    let (name, what) = scheme_words(&panel.scheme);
    let (drawn, drawn_note) = sent(panel);
    let (w, h) = panel.size;
    let mut out = format!(
        "<h3>{name}</h3><div class=\"row\"><figure><svg viewBox=\"{view}\" role=\"img\" aria-label=\"What is sent\">\
         <rect class=\"frame\" width=\"{w}\" height=\"{h}\"/>{drawn}</svg><figcaption><b>As sent.</b> {what} {drawn_note}\
         </figcaption></figure>",
        view = view_box(panel.size),
    );
    if panel.recovered.is_empty() {
        out.push_str(
            "<figure><figcaption>Nothing to recover: no attack was run on this scheme.</figcaption></figure>",
        );
    } else {
        out.push_str(&recovered(panel));
        out.push_str(&histogram::figure(
            &errors(&panel.recovered, &panel.truth),
            &errors(&panel.guessed, &panel.truth),
        ));
    }
    out.push_str("</div>");
    out
}

fn errors(answers: &[Pixel], truth: &[Pixel]) -> Vec<f64> {
    answers.iter().zip(truth).map(|(a, t)| a.distance(t)).collect()
}

/// The image with a rim, so that anchors and points just outside are seen.
fn view_box((w, h): (u32, u32)) -> String {
    let rim = f64::from(w.max(h)) * 0.05;
    format!("{:.0} {:.0} {:.0} {:.0}", -rim, -rim, f64::from(w) + 2.0 * rim, f64::from(h) + 2.0 * rim)
}

/// Dots as one path: zero-length strokes with round caps. Positions far outside or not finite are left out.
pub(super) fn dots(points: impl Iterator<Item = Pixel>) -> String {
    points.filter(|p| p.u.abs() < 1e5 && p.v.abs() < 1e5).fold(String::new(), |mut d, p| {
        let _ = write!(d, "M{:.1} {:.1}h0", p.u, p.v);
        d
    })
}

fn recovered(panel: &SchemePanel) -> String {
    let (w, h) = panel.size;
    let rim = f64::from(w.max(h)) * 0.05;
    let on_page =
        |p: &Pixel| p.u > -rim && p.v > -rim && p.u < f64::from(w) + rim && p.v < f64::from(h) + rim;
    let mut by_class: [Vec<Pixel>; 5] = Default::default();
    let mut outside = 0;
    for (r, t) in panel.recovered.iter().zip(&panel.truth) {
        let error = r.distance(t);
        by_class[CLASSES.iter().position(|c| error < *c).unwrap_or(4)].push(*r);
        outside += usize::from(!on_page(r));
    }
    let mut layers = format!("<path class=\"dot truth\" d=\"{}\"/>", dots(panel.truth.iter().copied()));
    // The worst below, so that what is given away stays visible.
    for (k, points) in by_class.iter().enumerate().rev() {
        if !points.is_empty() {
            let _ = write!(
                layers,
                "<path class=\"dot e{k}\" d=\"{}\"/>",
                dots(points.iter().copied().filter(on_page))
            );
        }
    }
    let all = errors(&panel.recovered, &panel.truth);
    let under = all.iter().filter(|e| **e < 30.0).count() as f64 / all.len().max(1) as f64;
    let mut sorted = all;
    sorted.sort_by(f64::total_cmp);
    let median = sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN);
    let gone =
        if outside > 0 { format!(" {outside} points fall outside the drawing.") } else { String::new() };
    format!(
        "<figure><svg viewBox=\"{view}\" role=\"img\" aria-label=\"Recovered keypoints\"><rect class=\"frame\" \
         width=\"{w}\" height=\"{h}\"/>{layers}</svg><figcaption><b>As recovered.</b> {} of the keypoints come out within \
         30 px, half of them within {}.{gone}</figcaption></figure>",
        percent(Some(under)),
        pixels(median),
        view = view_box(panel.size),
    )
}

/// What is sent, drawn, and a remark for the caption.
pub(super) fn sent(panel: &SchemePanel) -> (String, String) {
    let (w, h) = panel.size;
    let some = |n: usize| n.div_ceil(MOST_LINES).max(1);
    let remark = |n: usize, kind: &str| {
        let shown = n.div_ceil(some(n));
        if shown < n { format!("{shown} of {n} {kind} are drawn.") } else { format!("{n} {kind}.") }
    };
    match &panel.sent {
        Observations::Points(points) => {
            let d = dots(points.iter().copied());
            (format!("<path class=\"dot e0\" d=\"{d}\"/>"), format!("{} positions.", points.len()))
        }
        Observations::Lines(lines) => {
            let chords = lines.iter().step_by(some(lines.len())).filter_map(|l| chord(l, panel.size));
            (format!("<path class=\"lines1\" d=\"{}\"/>", strokes(chords)), remark(lines.len(), "lines"))
        }
        Observations::EitherLine(pairs) => {
            let crossings: Vec<Pixel> = pairs.iter().filter_map(|[a, b]| a.intersection(b)).collect();
            let arm = 0.012 * f64::from(w.max(h));
            let crosses = crossings.iter().flat_map(|p| {
                let at = |du: f64, dv: f64| Pixel::new(p.u + du, p.v + dv);
                [[at(-arm, 0.0), at(arm, 0.0)], [at(0.0, -arm), at(0.0, arm)]]
            });
            let note = format!(
                "{} mixed positions (crosses): the keypoint is somewhere above, below, left or right of its cross.",
                crossings.len()
            );
            (format!("<path class=\"lines1\" d=\"{}\"/>", strokes(crosses)), note)
        }
        Observations::Anchored { pencils, lines } => {
            let [w, h] = pencils.size();
            let mut drawn = String::new();
            for anchor in pencils.anchors() {
                // Where a row can come from.
                let of_anchor = lines.iter().step_by(some(lines.len())).filter(|l| l.anchor == anchor);
                let stretches = of_anchor
                    .filter_map(|l| Some((pencils.along(anchor, l.angle)?, l)))
                    .flat_map(|(line, l)| {
                        pencils
                            .spans(anchor, l.angle)
                            .into_iter()
                            .map(move |s| [line.at(s.near), line.at(s.far)])
                    });
                // Two colours tell neighbouring pencils apart.
                let (class, colour) =
                    if anchor.index().is_multiple_of(2) { ("lines1", "first") } else { ("lines2", "second") };
                let _ = write!(drawn, "<path class=\"{class}\" d=\"{}\"/>", strokes(stretches));
                let in_sight = |p: &Pixel| (p.u - w / 2.0).abs() <= w && (p.v - h / 2.0).abs() <= h;
                if let Some(from) = pencils.position(anchor).filter(in_sight) {
                    let _ = write!(
                        drawn,
                        "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{:.1}\" style=\"fill:var(--{colour})\"/>",
                        from.u,
                        from.v,
                        0.012 * w.max(h),
                    );
                }
            }
            (drawn, format!("{} The discs are the anchors.", remark(lines.len(), "half-lines")))
        }
    }
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
