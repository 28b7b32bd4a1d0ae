//! The report of localized queries: tables over all queries, the scenes in 3D, queries worst first. The demo's report
//! uses its parts too.

mod cards;
mod data;
mod queries;
mod tables;
mod worst;

use maud::{Markup, html};

use data::method_name;
pub use data::{LocalizationReport, Method, MethodFigures, QueryDrawing};
pub use queries::{figure, section as queries_section};
pub use worst::worst_first;

use crate::heat;
use crate::page::{Page, Section, fold};
use crate::scene::SpaceRow;
use crate::space::{self, Budget};

/// Maximum number of map points and queries drawn in 3D, over all scenes of a page.
const BUDGET: Budget = Budget { points: 24_000, queries: 1500 };

/// The report as one HTML document.
pub fn localization_page(report: &LocalizationReport) -> String {
    let page = Page {
        title: &report.title,
        lead: &report.lead,
        notices: report.notices.iter().map(|notice| html! { (notice) }).collect(),
        cards: &report.cards,
        sections: vec![
            Section::new("overview", "Overview", overview(report)),
            Section::new("scene", scene_title(report), scenes(report)),
            Section::new("coverage", "Where a camera is localized", coverage(report)),
            Section::new("queries", "Queries, worst first", queries_section(report)),
        ],
        facts: &report.facts,
    };
    page.html()
}

/// Heading of the drawings of the scenes.
pub fn scene_title(report: &LocalizationReport) -> &'static str {
    if report.scenes.len() > 1 { "The scenes in 3D" } else { "The scene in 3D" }
}

fn coverage(report: &LocalizationReport) -> Markup {
    report
        .scenes
        .first()
        .map_or_else(Markup::default, |scene| heat::section(&report.heat, scene, report.unit))
}

/// Tables over all queries.
pub fn overview(report: &LocalizationReport) -> Markup {
    let groups = tables::groups(report);
    if groups.is_empty() {
        return html! {};
    }
    let each = |table: &dyn Fn(&[&Method]) -> Markup| {
        html! {
            @for (heading, methods) in &groups {
                @let table = table(methods);
                @if groups.len() > 1 && !table.0.is_empty() { h4 { (heading) } }
                (table)
            }
        }
    };
    let trust = each(&|methods| tables::trust(methods));
    html! {
        p {
            "Each query was sent under every scheme, and the server answered with the pose of its camera. Errors are measured \
             against the true pose; a query that was not localized counts as an infinite error."
        }
        (each(&|methods| tables::errors(methods, report.unit)))
        @if !trust.0.is_empty() {
            h3 { "Trust" }
            p { "A pose is trusted, doubtful or not found. A trusted pose outside every bound of the table above is wrong." }
            (trust)
        }
        (fold("Time of a query, median of each stage", false, &each(&|methods| tables::stage_times(methods, &report.stages))))
    }
}

/// Each scene in 3D.
pub fn scenes(report: &LocalizationReport) -> Markup {
    let count = report.scenes.len().max(1);
    let budget =
        Budget { points: (BUDGET.points / count).max(3000), queries: (BUDGET.queries / count).max(100) };
    let mut drawn = Vec::new();
    for (index, scene) in report.scenes.iter().enumerate() {
        let mut rows: Vec<SpaceRow<'_>> = Vec::new();
        for (at, method) in report.methods.iter().enumerate().filter(|(_, method)| method.scene == index) {
            let own = report.outcomes.iter().filter(|outcome| outcome.method == at);
            let name = method_name(method);
            // Conditions of one scheme share a drawing.
            match rows.iter_mut().find(|known| known.name == name) {
                Some(known) => known.outcomes.extend(own),
                None => rows.push(SpaceRow { name, outcomes: own.collect() }),
            }
        }
        // The program's main scheme comes first.
        rows.sort_by_key(|row| !row.name.starts_with("Dual convergent lines"));
        let anchor = |name: &str| {
            report.drawings.iter().position(|d| d.scene == index && d.name == name).map(queries::anchor)
        };
        let figure = space::figure(scene, &rows, index, budget, report.unit, &anchor);
        if !figure.0.is_empty() {
            drawn.push((&scene.name, figure));
        }
    }
    if drawn.is_empty() {
        return html! {};
    }
    let judged = report.outcomes.iter().any(|outcome| outcome.truth.is_some());
    html! {
        p {
            @if judged { "Hollow cameras are the poses given for comparison, filled ones the estimates; a red line joins the two. " }
            @else { "Filled cameras are the estimated poses. " }
            "Green: trusted; yellow: doubtful; red cross: no pose. The disc around an estimate is its ±, enlarged by \
             the factor in the control below the drawing."
        }
        @for (name, figure) in &drawn {
            @if count > 1 { h3 { (name) } }
            (figure)
        }
    }
}
