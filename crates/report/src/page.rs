//! The page: conclusions first, then what they rest on.

use std::fmt::Write as _;

use crate::data::Report;
use crate::format::escape;
use crate::{query_figures, tables, top_view};

/// The page: one HTML document. Lists that are empty are left out, numbers that are missing are said to be.
pub fn html(report: &Report) -> String {
    let mut out = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" \
         content=\"width=device-width, initial-scale=1\"><title>{title}</title><style>\n{style}</style></head><body><main>\
         <h1>{title}</h1><p class=\"lead\">{lead}</p>",
        title = escape(&report.title),
        style = include_str!("style.css"),
        lead = escape(&report.lead),
    );
    if !report.cards.is_empty() {
        out.push_str("<div class=\"cards\">");
        for card in &report.cards {
            let _ = write!(
                out,
                "<div class=\"card\"><b>{}</b><span>{}</span><small>{}</small></div>",
                escape(&card.value),
                escape(&card.label),
                escape(&card.note)
            );
        }
        out.push_str("</div>");
    }
    out.push_str(&query_figures::section(&report.queries));
    out.push_str(&tables::localization(&report.localization));
    if let Some(view) = &report.top_view {
        out.push_str(&top_view::section(view));
    }
    out.push_str(&tables::attacks(&report.attacks));
    if !report.details.is_empty() {
        out.push_str("<section><h2>To repeat this</h2><dl>");
        for (name, value) in &report.details {
            let _ = write!(out, "<dt>{}</dt><dd>{}</dd>", escape(name), escape(value));
        }
        out.push_str("</dl></section>");
    }
    out.push_str("<footer>Written by veiloc. This file is complete: it needs no network.</footer></main></body></html>\n");
    out
}
