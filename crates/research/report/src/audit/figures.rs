//! The sections of images: spreads of errors, the inputs, the paper's scene, and patches in place of its Fig. 6.

use std::fmt::Write as _;

use image::RgbImage;
use image::imageops::{FilterType, resize};
use veiloc_geometry::Pixel;
use veiloc_protocol::Scheme;

use super::cdf::{self, Curve};
use super::collage::collage;
use super::curve;
use super::palette::{color, schemes};
use super::panels::Panels;
use super::sentences::{note, said};
use super::table::table;
use crate::embed::data_address;
use crate::format::escape;
use veiloc_evaluation::audit::{Attack, Part, base_share};
use veiloc_evaluation::audit::{Shown, ShownAttack, ShownScheme};
use veiloc_evaluation::audit::{px, scheme_words};

/// Longest side of a collage, pixels.
const COLLAGE: f64 = 480.0;
/// Keypoints of the paper's synthetic scene, and how many of them its attack had under 30 px.
const PAPER_KEYPOINTS: usize = 1500;
const PAPER_UNDER_30: usize = 8;

/// CDFs of all attacks, and how they stand false neighbours.
pub(super) fn spreads(part: &Part) -> String {
    let mut out = String::from(
        "<section><h2>How far off, over all keypoints</h2><p>Every curve is one attack. Where a curve runs along the dashed \
         one, that attack knows nothing that the single line does not tell.</p><div class=\"two\">",
    );
    let base = base_share(&part.document.attacks);
    let schemes = schemes(part);
    for scheme in &schemes {
        let curves: Vec<Curve<'_>> = part
            .gallery
            .spreads
            .iter()
            .filter(|s| {
                let asks = s.attack.needs.neighbours;
                s.scheme == *scheme && (!asks || s.corrupt <= base)
            })
            .map(|s| Curve {
                attack: s.attack,
                color: color(part, s.attack),
                guess: s.attack == Attack::PRIOR,
                errors: &s.errors,
            })
            .collect();
        out.push_str(&cdf::figure(&scheme_words(scheme), &curves));
    }
    out.push_str("</div>");
    let replaced: String = schemes
        .iter()
        .filter_map(|scheme| {
            curve::figure(&part.document.attacks, scheme, &scheme_words(scheme), |a| color(part, a))
        })
        .collect();
    if !replaced.is_empty() {
        let _ = write!(
            out,
            "<h3>False neighbours</h3><p>A share of each keypoint's neighbours replaced by keypoints drawn at random. The mistakes \
             of a real predictor are not drawn at random, and harder to filter.</p><div class=\"two\">{replaced}</div>"
        );
    }
    out + "</section>"
}

fn legend() -> String {
    let words = ["under 5 px", "under 10 px", "under 30 px", "under 100 px", "100 px or more"];
    let mut out = String::from("<ul class=\"legend\"><li>Error:</li>");
    for (k, text) in words.iter().enumerate() {
        let _ = write!(
            out,
            "<li><svg viewBox=\"0 0 12 12\" aria-hidden=\"true\"><circle class=\"f{k}\" cx=\"6\" cy=\"6\" r=\"5\"/></svg>{text}</li>"
        );
    }
    out + "<li>Gray: where the keypoints are. Thin lines join some of them to the answers.</li></ul>"
}

/// Every shown image under every scheme and attack.
pub(super) fn images(part: &Part) -> String {
    if part.gallery.shown.is_empty() {
        return String::new();
    }
    let mut out = format!(
        "<section><h2>True and recovered keypoints</h2><p>Left of each pair: where the attack puts the keypoints. Right: the \
         error of each keypoint, drawn where the keypoint is. Red is given away, blue is missed.</p>{}",
        legend()
    );
    for (number, shown) in part.gallery.shown.iter().enumerate() {
        let photograph = part.photographs.get(number).and_then(Option::as_ref);
        let address = photograph.and_then(data_address);
        let panels = Panels::new(shown, format!("p{number}"), address.is_some());
        let open = if number == 0 { " open" } else { "" };
        let _ = write!(
            out,
            "{}<details{open}><summary>{}</summary><div class=\"pair\">{}</div>",
            panels.shared(address.as_deref()),
            escape(&shown.name),
            panels.original()
        );
        for scheme in &shown.schemes {
            let name = scheme_words(&scheme.scheme.to_string());
            let _ = write!(out, "<h3>{}</h3>", escape(&name));
            let guess = scheme.attacks.iter().find(|a| a.attack == Attack::PRIOR);
            let guess = guess.map_or_else(String::new, |g| panels.recovered(g, "The guess."));
            let _ = write!(out, "<div class=\"pair\">{}{guess}</div>", panels.sent(scheme, "As sent."));
            for attack in scheme.attacks.iter().filter(|a| a.attack != Attack::PRIOR) {
                let words = escape(attack.attack.words);
                let _ = write!(
                    out,
                    "<div class=\"pair\">{}{}</div>",
                    panels.recovered(attack, &format!("Recovered: {words}.")),
                    panels.error_map(attack, &format!("Error map: {words}."))
                );
            }
        }
        out.push_str("</details>");
    }
    out + "</section>"
}

/// The paper's Fig. 4 and Fig. 5 on evenly spread keypoints, and what the other attacks make of them.
pub(super) fn paper_scene(part: &Part, has_inputs: bool) -> String {
    let Some(shown) = part.gallery.shown.first() else { return String::new() };
    let panels = Panels::new(shown, "scene", false);
    let n = shown.truth.len();
    let (w, h) = shown.size;
    let mut out = format!(
        "<section><h2>The paper's synthetic scene</h2><p>{n} keypoints spread evenly over {w} × {h} pixels{}. {}</p>{}",
        if n == PAPER_KEYPOINTS { "" } else { " (the paper: 1500)" },
        if base_share(&part.document.attacks) > 0.0 { "" } else { "Neighbours are the true ones." },
        panels.shared(None)
    );
    let heading = if has_inputs { "<h3>Conclusion on this scene</h3>" } else { "<h3>Conclusion</h3>" };
    let _ = write!(out, "{heading}{}{}{}", said(part, !has_inputs), table(&part.document), note());
    let is_dcl = |s: &&ShownScheme| matches!(s.scheme, Scheme::Dcl(_));
    if let Some(dcl) = shown.schemes.iter().find(is_dcl) {
        out.push_str(&fig_4(&panels, dcl));
    }
    out.push_str(&fig_5(&panels, shown));
    // The figures of spread are of the inputs, where there are any.
    if !has_inputs {
        out.push_str(&spreads(part));
    }
    out + "</section>"
}

fn fig_4(panels: &Panels<'_>, dcl: &ShownScheme) -> String {
    let paper = dcl.attacks.iter().find(|a| a.attack == Attack::CLOSED_FORM);
    let mut out = format!(
        "<h3>Fig. 4: {} under the paper's attack</h3>{}<div class=\"four\">{}",
        escape(&dcl.scheme.to_string()),
        legend(),
        panels.sent(dcl, "(a) As sent.")
    );
    let mut remark = String::new();
    if let Some(paper) = paper {
        out.push_str(&panels.recovered(paper, "(b) Recovered."));
        out.push_str(&panels.error_map(paper, "(c) Error map."));
        let under = |a: &ShownAttack| a.errors.iter().filter(|e| **e < 30.0).count();
        let others: Vec<String> = dcl
            .attacks
            .iter()
            .filter(|a| a.attack != Attack::CLOSED_FORM)
            .map(|a| format!("{} {}", a.attack.words, under(a)))
            .collect();
        remark = format!(
            "<p class=\"note\">The paper counts {PAPER_UNDER_30} of its {PAPER_KEYPOINTS} keypoints under 30 px in its error map (c). \
             Here its attack has {} of {}. The same count for the other answers: {}.</p>",
            under(paper),
            paper.errors.len(),
            escape(&others.join(", "))
        );
    }
    let crossings =
        panels.crossings(dcl, "(d) Standard deviation of where a line crosses those of its neighbours.");
    out + &crossings + "</div>" + &remark
}

fn fig_5(panels: &Panels<'_>, shown: &Shown) -> String {
    let mut out = String::new();
    let mut kinds: Vec<Attack> = Vec::new();
    for attack in shown.schemes.iter().flat_map(|s| &s.attacks) {
        if attack.attack != Attack::PRIOR && !kinds.contains(&attack.attack) {
            kinds.push(attack.attack);
        }
    }
    for kind in kinds {
        let words = kind.words;
        let fig = if kind == Attack::CLOSED_FORM { "As the paper's Fig. 5: keypoints" } else { "Keypoints" };
        let _ = write!(
            out,
            "<h3>{fig} recovered by the {}</h3><div class=\"four\">{}",
            escape(words.trim_start_matches("the ")),
            panels.original()
        );
        for scheme in &shown.schemes {
            if let Some(attack) = scheme.attacks.iter().find(|a| a.attack == kind) {
                let name = format!("{}.", escape(&scheme_words(&scheme.scheme.to_string())));
                out.push_str(&panels.recovered(attack, &name));
            }
        }
        out.push_str("</div>");
    }
    out
}

/// Patches of the first photograph set where the attacks put them.
pub(super) fn collages(part: &Part) -> String {
    let first = part.gallery.shown.iter().zip(&part.photographs).find_map(|(s, p)| Some((s, p.as_ref()?)));
    let Some((shown, photograph)) = first else { return String::new() };
    let (w, h) = photograph.dimensions();
    let scale = (COLLAGE / f64::from(w.max(h).max(1))).min(1.0);
    let small = |n: u32| ((f64::from(n) * scale).round() as u32).max(1);
    let small: RgbImage = resize(photograph, small(w), small(h), FilterType::Triangle);
    let scaled = |p: &Pixel| Pixel::new(p.u * scale, p.v * scale);
    let truth: Vec<Pixel> = shown.truth.iter().map(scaled).collect();
    let figure = |image: &RgbImage, caption: &str| {
        data_address(image).map_or_else(String::new, |address| {
            format!(
                "<figure><img src=\"{address}\" alt=\"{caption}\"><figcaption>{caption}</figcaption></figure>"
            )
        })
    };
    let mut out = format!(
        "<section><h2>What the positions are worth: in place of the paper's Fig. 6</h2><p>The paper draws images from recovered \
         keypoints with trained inversion networks. Those networks and their scores (PSNR, SSIM, LPIPS) are not reproduced \
         here. In their place each keypoint's patch is cut from the photograph and set where the attack puts the keypoint. No \
         attacker holds the patches: he has descriptors, from which a network makes blurred ones and fills the gaps between \
         them. So these images show what recovered positions are worth, not what a network would draw, and neither bounds \
         the other.</p><div class=\"four\">{}{}</div>",
        figure(&small, "The photograph"),
        figure(&collage(&small, &truth, &truth), "Patches at the true positions: nothing hidden (points)")
    );
    for scheme in &shown.schemes {
        let _ =
            write!(out, "<h3>{}</h3><div class=\"four\">", escape(&scheme_words(&scheme.scheme.to_string())));
        for attack in &scheme.attacks {
            let answers: Vec<Pixel> = attack.answers.iter().map(scaled).collect();
            let median = veiloc_attacks::ErrorSummary::of(&attack.errors).median_px;
            let caption = format!("{}: median error {}", escape(attack.attack.words), px(median));
            out.push_str(&figure(&collage(&small, &truth, &answers), &caption));
        }
        out.push_str("</div>");
    }
    out + "</section>"
}
