//! The page layout of all reports: head, notices, large numbers, contents, sections, footer.
//!
//! Its content security policy keeps a browser from fetching resources and from running other scripts than that of
//! the page.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use maud::{Markup, PreEscaped, html};
use sha2::{Digest as _, Sha256};

/// Styles of pages.
const STYLE: &str = include_str!("style.css");
/// The script of the 3D view.
const SCRIPT: &str = include_str!("space/space.js");

/// A large number with its meaning.
#[derive(Debug, Clone, Default)]
pub struct Card {
    /// The value with its unit, `"1.2 cm"`.
    pub value: String,
    /// Its meaning, in a few words.
    pub label: String,
    /// One sentence for lay readers.
    pub note: String,
}

/// A report as a page.
#[derive(Default)]
pub struct Page<'a> {
    /// Heading and browser title.
    pub title: &'a str,
    /// One or two sentences below it.
    pub lead: &'a str,
    /// Warnings about the file's content.
    pub notices: Vec<Markup>,
    /// A few large numbers.
    pub cards: &'a [Card],
    /// Sections without a body are left out.
    pub sections: Vec<Section>,
    /// Name and value of information for a repetition.
    pub facts: &'a [(String, String)],
}

/// A section of a page.
pub struct Section {
    /// Its anchor.
    id: &'static str,
    title: String,
    body: Markup,
}

impl Section {
    /// A section with this anchor.
    pub fn new(id: &'static str, title: impl Into<String>, body: Markup) -> Self {
        Self { id, title: title.into(), body }
    }
}

impl Page<'_> {
    /// The page as one HTML document.
    pub fn html(mut self) -> String {
        self.sections.push(Section::new("repeat", "To repeat this", facts(self.facts)));
        self.sections.retain(|section| !section.body.0.is_empty());
        let has_script = self.sections.iter().any(|section| section.body.0.contains("<canvas"));
        let policy = format!(
            "default-src 'none'; img-src data:; style-src {}; script-src {}; base-uri 'none'; form-action 'none'",
            hash(STYLE),
            if has_script { hash(SCRIPT) } else { "'none'".to_owned() },
        );
        let page = html! {
            (maud::DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta http-equiv="Content-Security-Policy" content=(policy);
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    meta name="referrer" content="no-referrer";
                    title { (self.title) }
                    style { (PreEscaped(STYLE)) }
                }
                body {
                    main {
                        h1 { (self.title) }
                        p.lead { (self.lead) }
                        @for notice in &self.notices { p.private { (notice) } }
                        (cards(self.cards))
                        @if self.sections.len() > 1 {
                            nav aria-label="Contents" {
                                ol { @for section in &self.sections { li { a href={ "#" (section.id) } { (section.title) } } } }
                            }
                        }
                        @for section in &self.sections {
                            section id=(section.id) { h2 { (section.title) } (section.body) }
                        }
                        footer { "Written by veiloc. This file is complete: it needs no network." }
                    }
                    @if has_script { script { (PreEscaped(SCRIPT)) } }
                }
            }
        };
        page.into_string()
    }
}

fn cards(cards: &[Card]) -> Markup {
    html! {
        @if !cards.is_empty() {
            div.cards {
                @for card in cards {
                    div.card { b { (card.value) } span { (card.label) } small { (card.note) } }
                }
            }
        }
    }
}

/// Names and values.
pub fn facts(facts: &[(String, String)]) -> Markup {
    html! {
        @if !facts.is_empty() {
            dl { @for (name, value) in facts { dt { (name) } dd { (value) } } }
        }
    }
}

/// Collapsible content.
pub fn fold(summary: &str, open: bool, body: &Markup) -> Markup {
    html! {
        @if !body.0.is_empty() { details.fold open[open] { summary { h3 { (summary) } } (body) } }
    }
}

/// A picture with its caption.
pub fn figure(picture: &Markup, caption: &Markup) -> Markup {
    html! { figure { (picture) figcaption { (caption) } } }
}

/// A legend: for each entry a mark of this class and its meaning.
pub fn legend(entries: &[(&str, &str)]) -> Markup {
    html! {
        ul.legend {
            @for (class, meaning) in entries {
                li {
                    svg viewBox="0 0 12 12" aria-hidden="true" {
                        @if class.contains("line") { path class=(class) d="M1 11L11 1" {} }
                        @else if class.contains("camera") { path class=(class) d="M2 11L6 1L10 11Z" {} }
                        @else if class.contains("cross") { path class=(class) d="M2 2L10 10M10 2L2 10" {} }
                        @else { path class=(class) d="M6 6h0" {} }
                    }
                    (meaning)
                }
            }
        }
    }
}

/// Hash of a style or script as content security policies write it.
fn hash(text: &str) -> String {
    format!("'sha256-{}'", STANDARD.encode(Sha256::digest(text)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn policy_hash_equals_recommendation_example() {
        // The example of the recommendation, Content Security Policy Level 2, section 4.2.5.
        assert_eq!(hash("alert('Hello, world.');"), "'sha256-qznLcsROx4GACP2dm0UCKCzCG+HiZ1guq6ZZDob/Tng='");
    }

    #[test]
    fn empty_sections_are_omitted_and_text_is_escaped() {
        let section = |id, body: &str| Section::new(id, format!("<{id}>"), html! { (body) });
        let page = Page {
            title: "<script>alert(1)</script>",
            sections: vec![section("a", "x"), section("b", ""), section("c", "y")],
            ..Page::default()
        };
        let text = page.html();
        assert!(text.contains("<h2>&lt;a&gt;</h2>") && text.contains("href=\"#c\""));
        assert!(!text.contains("id=\"b\"") && !text.contains("href=\"#b\""));
        assert!(!text.contains("<script") && text.contains("script-src 'none'"), "nothing runs");
    }
}
