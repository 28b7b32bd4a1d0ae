//! The report of `veiloc audit`: what attackers recover from sealed queries, for operators, developers and reviewers.

use crate::attack_evaluation::{
    Attack, Audit, AuditOptions, AuditPart, PROTECTION, ShownAttack, ShownImage, ShownImages, ShownScheme,
    WithPack,
};
use maud::{Markup, html};
use veiloc_protocol::Scheme;

use super::attack_figures::{AttackFigures, error_legend};
use super::attacks::{gallery, needs, schemes, summary, table};
use veiloc_report::numbers::{capital, count, scheme_name};
use veiloc_report::page::{Page, Section, fold};

/// Keypoints of the paper's synthetic scene, and how many of them its attack recovered to under 30 px.
const PAPER_KEYPOINTS: usize = 1500;
const PAPER_UNDER_30: usize = 8;

/// The report as one HTML document. `options`: the options of the audit.
pub fn audit_page(audit: &Audit, options: &AuditOptions) -> String {
    let inputs = audit.document.inputs.as_ref().zip(audit.inputs.as_ref());
    let synthetic = audit.document.synthetic.as_ref().zip(audit.synthetic.as_ref());
    let Some((main, _)) = inputs.or(synthetic) else { return Page::default().html() };
    let scene_is_main = inputs.is_none();
    let attacks = &main.attacks;
    let images = attacks.attacks.iter().map(|row| row.images).max().unwrap_or(0);
    let with_pack = attacks.with_pack.as_ref().map(|with| {
        let WithPack { send, keypoints, sent, .. } = with;
        format!(" Of {keypoints} keypoints a device with this pack sends {sent} ({send}), and only these are attacked.")
    });
    let lead = format!(
        "{PROTECTION} Here: {} with {}{} obfuscated as on a device under {}, attacked, and compared with the truth.{}",
        count(images, "image"),
        count(main.keypoints, "keypoint"),
        if !scene_is_main && synthetic.is_some() { ", and the paper's synthetic scene," } else { "" },
        count(schemes(attacks).len(), "scheme"),
        with_pack.unwrap_or_default(),
    );
    let page = Page {
        title: "Attacks on sealed queries",
        lead: &lead,
        notices: inputs.and_then(|(_, gallery)| notice(gallery)).into_iter().collect(),
        sections: vec![
            Section::new("images", "True and recovered keypoints", images_of(inputs)),
            Section::new("strongest", "The strongest attack on each scheme", summary(attacks)),
            Section::new("errors", "Errors of all keypoints", every_attack(main)),
            Section::new("scene", "The paper's synthetic scene", synthetic_scene(synthetic, scene_is_main)),
        ],
        facts: &run_facts(main, options, audit.seconds),
        ..Page::default()
    };
    page.html()
}

/// A warning about the file's content, for readers who share the file.
fn notice(gallery: &ShownImages) -> Option<Markup> {
    let has_photographs = gallery.shown.iter().any(|shown| shown.photograph.is_some());
    let holds = match (gallery.shown.is_empty(), has_photographs) {
        // Figures alone contain no single keypoint.
        (true, _) => return None,
        (_, true) => "the photographs and the true positions of their keypoints",
        (_, false) => "true positions of keypoints, which the schemes hide",
    };
    Some(html! {
        b { "This file contains " (holds) "." } " Nothing was sent over a network to make it. Anyone who gets the file gets them too."
        @if has_photographs { " " code { "--no-images" } " leaves the photographs out." }
    })
}

fn every_attack(part: &AuditPart) -> Markup {
    html! {
        (table(&part.attacks, &part.relative_offset_error))
        (fold("The attacks, and what each requires beside the query", false, &needs(&part.attacks)))
    }
}

fn images_of(part: Option<(&AuditPart, &ShownImages)>) -> Markup {
    let Some((part, found)) = part else { return html! {} };
    html! {
        @for (index, shown) in found.shown.iter().enumerate() {
            (fold(&shown.name, index == 0, &html! { (gallery(shown, &part.attacks, &format!("image-{index}"))) }))
        }
    }
}

/// The paper's Fig. 4 and Fig. 5 on uniform keypoints. `is_main`: its tables are the main tables of the page.
fn synthetic_scene(part: Option<(&AuditPart, &ShownImages)>, is_main: bool) -> Markup {
    let Some((part, found)) = part else { return html! {} };
    let Some(shown) = found.shown.first() else { return html! {} };
    let figures = AttackFigures::new(shown, "scene");
    let (n, (w, h)) = (shown.truth.len(), shown.size);
    let dcl = shown.schemes.iter().find(|scheme| matches!(scheme.scheme, Scheme::Dcl(_)));
    html! {
        p {
            (n) " uniformly distributed keypoints over " (w) " × " (h) " pixels"
            @if n != PAPER_KEYPOINTS { " (the paper: " (PAPER_KEYPOINTS) ")" }
            "; with true neighbours."
        }
        (figures.shared())
        @if let Some(dcl) = dcl { (fold(&format!("Fig. 4: {} under the paper's attack", dcl.scheme), is_main, &fig_4(&figures, dcl))) }
        (fold("Fig. 5: recovered keypoints", false, &fig_5(&figures, shown)))
        @if !is_main {
            (fold("Table: the strongest attack on each scheme", false, &summary(&part.attacks)))
            (fold("Table: every attack on every scheme of the scene", false, &table(&part.attacks, &part.relative_offset_error)))
        }
    }
}

fn fig_4(figures: &AttackFigures<'_>, dcl: &ShownScheme) -> Markup {
    let attack = dcl.attacks.iter().find(|attack| attack.attack == Attack::CLOSED_FORM);
    let under = |attack: &ShownAttack| attack.errors.iter().filter(|error| **error < 30.0).count();
    html! {
        (error_legend())
        div.gallery {
            (figures.sent(dcl, "(a) As sent."))
            @if let Some(attack) = attack {
                (figures.recovered(attack, "(b) Recovered."))
                (figures.error_map(attack, "(c) Error map."))
            }
            (figures.crossings(dcl, "(d) Standard deviation of the positions where a line intersects those of its neighbours."))
        }
        @if let Some(attack) = attack {
            p.note {
                "The paper counts " (PAPER_UNDER_30) " of its " (PAPER_KEYPOINTS) " keypoints under 30 px in its error map (c). Here \
                 its attack has " (under(attack)) " of " (attack.errors.len()) "."
            }
        }
    }
}

fn fig_5(figures: &AttackFigures<'_>, shown: &ShownImage) -> Markup {
    let mut kinds: Vec<Attack> = Vec::new();
    for attack in shown.schemes.iter().flat_map(|scheme| &scheme.attacks) {
        if attack.attack != Attack::PRIOR && !kinds.contains(&attack.attack) {
            kinds.push(attack.attack);
        }
    }
    html! {
        (error_legend())
        div.gallery { (figures.original()) }
        @for kind in kinds {
            h4 { (capital(kind.words)) }
            div.gallery {
                @for scheme in &shown.schemes {
                    @if let Some(attack) = scheme.attacks.iter().find(|attack| attack.attack == kind) {
                        (figures.recovered(attack, &format!("{}.", scheme_name(&scheme.scheme.to_string()))))
                    }
                }
            }
        }
    }
}

fn run_facts(part: &AuditPart, options: &AuditOptions, seconds: f64) -> Vec<(String, String)> {
    let attacks = &part.attacks;
    let facts = [
        ("Command", options.command.clone()),
        ("Version", format!("veiloc {}", env!("CARGO_PKG_VERSION"))),
        ("Seed", options.evaluation.seed.to_string()),
        ("Data", attacks.data.join(", ")),
        ("Neighbours", format!("{}, {} a keypoint", attacks.neighbours, attacks.k)),
        ("Angles", format!("{} bits", options.evaluation.angle_bits.get())),
        ("Time", format!("{seconds:.0} s")),
    ];
    facts.map(|(name, value)| (name.to_owned(), value)).into()
}
