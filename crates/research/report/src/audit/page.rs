//! The page: conclusion first, then figures, images, how to read them, and how to repeat them.

use std::fmt::Write as _;

use super::figures::{collages, images, paper_scene, spreads};
use super::palette::schemes;
use super::sentences::{note, said};
use super::table::table;
use crate::format::escape;
use veiloc_evaluation::audit::{Attack, Audit, AuditOptions, Part, capital, count, needs};

/// An audit as one HTML document that loads nothing. `options`: what it was run with, for whoever repeats it.
pub fn audit_page(audit: &Audit, options: &AuditOptions) -> String {
    let (inputs, synthetic, seconds) = (audit.inputs.as_ref(), audit.synthetic.as_ref(), audit.seconds);
    let mut out = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" \
         content=\"width=device-width, initial-scale=1\"><title>veiloc audit</title><style>\n{}{}</style></head><body><main>\
         <h1>What an attacker gets out of sealed queries</h1><p class=\"lead\">{}</p>",
        include_str!("../style.css"),
        include_str!("audit.css"),
        escape(&lead(inputs, synthetic)),
    );
    if let Some(part) = inputs {
        out.push_str(private(part));
        let _ = write!(out, "<section><h2>Conclusion</h2>{}</section>", said(part, true));
        let _ = write!(
            out,
            "<section><h2>Every attack on every scheme</h2><p>Measured on {}.</p>{}{}</section>",
            escape(&part.document.attacks.data.join(", ")),
            table(&part.document),
            note()
        );
        out.push_str(&spreads(part));
        out.push_str(&images(part));
        out.push_str(&collages(part));
    }
    if let Some(part) = synthetic {
        out.push_str(&paper_scene(part, inputs.is_some()));
    }
    if inputs.is_none_or(|p| p.photographs.iter().all(Option::is_none)) {
        out.push_str(
            "<section><h2>The paper's Fig. 6</h2><p>It shows images that trained networks draw from recovered keypoints. \
             <code>veiloc eval inversion</code> makes such images and their scores, and a report of its own. Given images, this \
             report shows in their place what the recovered positions are worth.</p></section>",
        );
    }
    out.push_str(&how_to_read(inputs.or(synthetic)));
    out.push_str(&repeat(inputs.or(synthetic), options, seconds));
    out.push_str("<footer>Written by veiloc. This file is complete: it needs no network.</footer></main></body></html>\n");
    out
}

fn lead(inputs: Option<&Part>, synthetic: Option<&Part>) -> String {
    let Some(part) = inputs.or(synthetic) else { return String::new() };
    let images = part.document.attacks.attacks.iter().map(|r| r.images).max().unwrap_or(0);
    let also =
        if inputs.is_some() && synthetic.is_some() { ", and the paper's synthetic scene," } else { "" };
    format!(
        "{} with {}{also} obfuscated as a device does it under {}, attacked, and compared with the truth.",
        count(images, "image"),
        count(part.gallery.keypoints, "keypoint"),
        count(schemes(part).len(), "scheme"),
    )
}

fn private(part: &Part) -> &'static str {
    if part.gallery.shown.is_empty() {
        // Figures alone tell of no single keypoint.
        ""
    } else if part.photographs.iter().any(Option::is_some) {
        "<p class=\"private\"><b>This file contains the photographs</b> and the true positions of their keypoints. It is for \
         whoever owns them. Nothing was sent anywhere to make it; who passes it on passes the photographs on. \
         <code>--no-images</code> leaves the photographs out.</p>"
    } else {
        "<p class=\"private\"><b>This file contains true positions of keypoints</b>, which is what the schemes hide. It is for \
         whoever owns the images. Nothing was sent anywhere to make it.</p>"
    }
}

fn how_to_read(part: Option<&Part>) -> String {
    let mut out = String::from(
        "<section><h2>How to read this</h2><p>A keypoint is a place in an image that can be found again in other images. \
         Where keypoints are known, an image can be drawn from them, so their positions are what a scheme must hide. Each \
         scheme sends a line (or a mixed position) in place of the keypoint. An attack says where on the line the keypoint \
         was. Its error is the distance from the truth.</p><p>A large error shows that <em>this</em> attack fails, not that \
         none can succeed: that is why every attack stands beside the guess. A small error under true neighbours shows what \
         an attacker gets who learns the neighbours somehow, not that every attacker does.</p>",
    );
    let Some(part) = part else { return out + "</section>" };
    out.push_str("<h3>The attacks, and what each needs beside the query</h3><dl>");
    let mut seen: Vec<Attack> = Vec::new();
    for row in &part.document.attacks.attacks {
        if seen.contains(&row.attack) {
            continue;
        }
        seen.push(row.attack);
        let needs = needs(row.attack, &part.document.attacks);
        let _ = write!(
            out,
            "<dt><code>{}</code></dt><dd>{}. Needs: {}.</dd>",
            escape(row.attack.name),
            escape(&capital(row.attack.words)),
            escape(&needs)
        );
    }
    out + "</dl></section>"
}

fn repeat(part: Option<&Part>, options: &AuditOptions, seconds: f64) -> String {
    let mut rows = vec![
        ("Command", options.command.clone()),
        ("Version", format!("veiloc {}", env!("CARGO_PKG_VERSION"))),
        ("Seed", options.evaluation.seed.to_string()),
    ];
    if let Some(part) = part {
        rows.push(("Data", part.document.attacks.data.join(", ")));
        rows.push((
            "Neighbours",
            format!("{}, {} a keypoint", part.document.attacks.neighbours, part.document.attacks.k),
        ));
    }
    rows.push(("Angles", format!("{} bits", options.evaluation.angle_bits.get())));
    rows.push(("Time", format!("{seconds:.0} s")));
    let mut list = String::new();
    for (name, value) in &rows {
        let _ = write!(list, "<dt>{name}</dt><dd>{}</dd>", escape(value));
    }
    format!("<section><h2>To repeat this</h2><dl>{list}</dl></section>")
}
