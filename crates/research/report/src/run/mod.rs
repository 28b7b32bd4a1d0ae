//! A page on a run: overview, the places in 3D, each scheme, queries worst first. Its parts serve the demo's page too.

mod collected;
mod data;
mod documents;
mod queries;
mod recolor;
mod schemes;
mod worst;

use std::fmt::Write as _;

pub use data::{PlaceView, QueryDrawing, QueryOutcome, RowState, RunFigure, RunReport, RunRow, SentDrawing};
pub(crate) use queries::{figure, section as queries_section};
pub use worst::worst_first;

use crate::format::{escape, scheme_words};
use crate::shell::{self, Section, cards, details};
use crate::space::{self, Budget, SpaceRow};
use crate::tables::{self, TableRow};

/// Map points and queries drawn in 3D, over all places of a page.
const BUDGET: Budget = Budget { points: 24_000, queries: 1500 };

/// The page: one HTML document. Lists that are empty are left out, numbers that are missing are said to be.
pub fn run_page(run: &RunReport) -> String {
    let top = cards(&run.cards) + &remarks(run);
    let sections = [
        Section { id: "overview", title: "Overview".to_owned(), body: overview(run) },
        Section { id: "place", title: place_title(run).to_owned(), body: places(run) },
        Section { id: "schemes", title: "Each scheme".to_owned(), body: schemes::section(run) },
        Section { id: "queries", title: "Queries, worst first".to_owned(), body: queries_section(run) },
        details(&run.details),
    ];
    shell::page(&run.title, &run.lead, &top, &sections)
}

pub(crate) fn place_title(run: &RunReport) -> &'static str {
    if run.places.len() > 1 { "The places in 3D" } else { "The place in 3D" }
}

fn remarks(run: &RunReport) -> String {
    let mut out = String::new();
    for remark in &run.remarks {
        let _ = write!(out, "<p class=\"private\">{}</p>", escape(remark));
    }
    out
}

/// What a row is called, HTML.
pub(crate) fn name_of(row: &RunRow) -> String {
    let (name, _) = scheme_words(&row.scheme);
    if row.beside.is_empty() { name } else { format!("{name} · {}", escape(&row.beside)) }
}

/// Tables and figures over all queries.
pub(crate) fn overview(run: &RunReport) -> String {
    let mut out = String::new();
    let groups = groups(run);
    let several = groups.len() > 1;
    for (heading, rows) in &groups {
        if several {
            let _ = write!(out, "<h3>{heading}</h3>");
        }
        out.push_str(&tables::localization(rows));
    }
    if out.is_empty() {
        return out;
    }
    let mut text = String::from(
        "<p>Each query was sent under every scheme, and the server answered where the camera stood. Errors are measured against \
         the true pose; a query that was not localized counts as infinitely wrong.</p>",
    ) + &out;
    for (title, words, table) in [
        (
            "What the answers say of themselves",
            "A pose is trusted, doubted or not found. Trusted poses outside every bound of the table above are wrong ones.",
            tables::trust as fn(&[TableRow<'_>]) -> String,
        ),
        ("Time per query, median", "", tables::stage_times),
    ] {
        let mut found = String::new();
        for (heading, rows) in &groups {
            let table = table(rows);
            if several && !table.is_empty() {
                let _ = write!(found, "<h4>{heading}</h4>");
            }
            found.push_str(&table);
        }
        if !found.is_empty() {
            let words = if words.is_empty() { String::new() } else { format!("<p>{words}</p>") };
            let _ = write!(text, "<h3>{title}</h3>{words}{found}");
        }
    }
    text + &figures(run)
}

/// Rows of each place and condition, with what they have in common.
fn groups(run: &RunReport) -> Vec<(String, Vec<TableRow<'_>>)> {
    type Group<'a> = ((usize, Option<&'a str>), Vec<TableRow<'a>>);
    let mut groups: Vec<Group<'_>> = Vec::new();
    for row in &run.rows {
        let Some(summary) = &row.summary else { continue };
        let key = (row.place, row.condition.as_deref());
        let entry = TableRow { name: name_of(row), what: scheme_words(&row.scheme).1, summary };
        match groups.iter_mut().find(|(k, _)| *k == key) {
            Some((_, rows)) => rows.push(entry),
            None => groups.push((key, vec![entry])),
        }
    }
    let heading = |(place, condition): (usize, Option<&str>)| {
        let place = run.places.get(place).map_or("", |place| place.name.as_str());
        let parts: Vec<String> = [place, condition.unwrap_or_default()]
            .iter()
            .filter(|p| !p.is_empty())
            .map(|p| escape(p))
            .collect();
        parts.join(", ")
    };
    groups.into_iter().map(|(key, rows)| (heading(key), rows)).collect()
}

fn figures(run: &RunReport) -> String {
    if run.figures.is_empty() {
        return String::new();
    }
    let mut out = String::from("<h3>Curves</h3><div class=\"two\">");
    for figure in &run.figures {
        let caption = escape(&figure.caption);
        let _ = write!(
            out,
            "<figure class=\"plot{}\" tabindex=\"0\">{}<figcaption>{caption}</figcaption></figure>",
            if recolor::is_long(&figure.svg) { " long" } else { "" },
            recolor::of_page(&figure.svg, &caption)
        );
    }
    out + "</div>"
}

/// Each place in 3D.
pub(crate) fn places(run: &RunReport) -> String {
    let count = run.places.len().max(1);
    let budget =
        Budget { points: (BUDGET.points / count).max(3000), queries: (BUDGET.queries / count).max(100) };
    let mut out = String::new();
    for (index, place) in run.places.iter().enumerate() {
        let mut rows: Vec<SpaceRow<'_>> = Vec::new();
        for (at, row) in run.rows.iter().enumerate().filter(|(_, row)| row.place == index) {
            let own = run.outcomes.iter().filter(|outcome| outcome.row == at);
            let name = plain_name(row);
            // Conditions of one scheme share a drawing.
            match rows.iter_mut().find(|known| known.name == name) {
                Some(known) => known.outcomes.extend(own),
                None => rows.push(SpaceRow { name, outcomes: own.collect() }),
            }
        }
        // What the program is for stands first.
        rows.sort_by_key(|row| !row.name.starts_with("Dual convergent lines"));
        let id_of = |name: &str| {
            let at = run.drawings.iter().position(|drawing| drawing.place == index && drawing.name == name);
            at.map(queries::id)
        };
        let figure = space::figure(place, &rows, index, budget, &id_of);
        if !figure.is_empty() && count > 1 {
            let _ = write!(out, "<h3>{}</h3>", escape(&place.name));
        }
        out.push_str(&figure);
    }
    if out.is_empty() {
        return out;
    }
    let judged = run.outcomes.iter().any(|outcome| outcome.truth.is_some());
    let words = if judged {
        "Hollow cameras stand where queries were taken, filled ones where the server put them: green is trusted, yellow \
         doubted, a red cross has no pose, and a red line joins an estimate to the truth. The disc around an estimate is its ±."
    } else {
        "Filled cameras stand where the server put the queries: green is trusted, yellow doubted. The disc around an estimate \
         is its ±."
    };
    format!("<p>{words}</p>{out}")
}

/// The name of a row as plain text.
fn plain_name(row: &RunRow) -> String {
    let name = veiloc_evaluation::audit::scheme_words(&row.scheme);
    if row.beside.is_empty() { name } else { format!("{name} · {}", row.beside) }
}
