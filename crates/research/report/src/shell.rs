//! The frame of every page: head, contents, footer, and a policy by which a browser fetches nothing and runs only what is here.

use std::fmt::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use sha2::{Digest as _, Sha256};

use crate::format::escape;

/// How pages look.
const STYLE: &str = include_str!("style.css");
/// How the place is turned.
const SCRIPT: &str = include_str!("space/space.js");

/// A section of a page.
pub(crate) struct Section {
    /// Its name in addresses.
    pub(crate) id: &'static str,
    /// Its heading.
    pub(crate) title: String,
    /// What stands below the heading, HTML.
    pub(crate) body: String,
}

/// A page: one HTML document. `top` stands between the lead and the contents. Sections without a body are left out.
pub(crate) fn page(title: &str, lead: &str, top: &str, sections: &[Section]) -> String {
    let shown: Vec<&Section> = sections.iter().filter(|section| !section.body.is_empty()).collect();
    let style = format!("\n{STYLE}");
    let script = format!("\n{SCRIPT}");
    let title = escape(title);
    let mut out = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta http-equiv=\"Content-Security-Policy\" \
         content=\"default-src 'none'; img-src data:; style-src {}; script-src {}; base-uri 'none'; form-action 'none'\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"><meta name=\"referrer\" \
         content=\"no-referrer\"><title>{title}</title><style>{style}</style></head><body><main><h1>{title}</h1>\
         <p class=\"lead\">{}</p>{top}",
        hash(&style),
        hash(&script),
        escape(lead),
    );
    if shown.len() > 1 {
        out.push_str("<nav aria-label=\"Contents\"><ol>");
        for section in &shown {
            let _ = write!(out, "<li><a href=\"#{}\">{}</a></li>", section.id, escape(&section.title));
        }
        out.push_str("</ol></nav>");
    }
    for section in shown {
        let (id, title) = (section.id, escape(&section.title));
        let _ = write!(out, "<section id=\"{id}\"><h2>{title}</h2>{}</section>", section.body);
    }
    let _ = writeln!(
        out,
        "<footer>Written by veiloc. This file is complete: it needs no network.</footer></main><script>{script}</script></body></html>"
    );
    out
}

/// What whoever repeats a run must know: names and values.
pub(crate) fn details(details: &[(String, String)]) -> Section {
    let mut body = String::new();
    if !details.is_empty() {
        body.push_str("<dl>");
        for (name, value) in details {
            let _ = write!(body, "<dt>{}</dt><dd>{}</dd>", escape(name), escape(value));
        }
        body.push_str("</dl>");
    }
    Section { id: "repeat", title: "To repeat this".to_owned(), body }
}

/// A few large numbers.
pub(crate) fn cards(cards: &[crate::card::Card]) -> String {
    if cards.is_empty() {
        return String::new();
    }
    let mut out = String::from("<div class=\"cards\">");
    for card in cards {
        let _ = write!(
            out,
            "<div class=\"card\"><b>{}</b><span>{}</span><small>{}</small></div>",
            escape(&card.value),
            escape(&card.label),
            escape(&card.note)
        );
    }
    out + "</div>"
}

/// How a policy names a style or a script.
fn hash(text: &str) -> String {
    format!("'sha256-{}'", STANDARD.encode(Sha256::digest(text)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_policy_names_a_text_as_browsers_do() {
        // The example of the recommendation, Content Security Policy Level 2, section 4.2.5.
        assert_eq!(hash("alert('Hello, world.');"), "'sha256-qznLcsROx4GACP2dm0UCKCzCG+HiZ1guq6ZZDob/Tng='");
    }

    #[test]
    fn empty_sections_are_left_out() {
        let section = |id, body: &str| Section { id, title: format!("<{id}>"), body: body.to_owned() };
        let text = page("t", "l", "", &[section("a", "x"), section("b", ""), section("c", "y")]);
        assert!(text.contains("<h2>&lt;a&gt;</h2>") && text.contains("href=\"#c\""));
        assert!(!text.contains("id=\"b\"") && !text.contains("href=\"#b\""));
    }
}
