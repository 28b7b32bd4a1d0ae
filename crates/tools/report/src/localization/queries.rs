//! Single queries, worst first: their figures, and the sent rows over the image (which is not sent).

use maud::{Markup, html};
use veiloc_pose::State;

use super::data::{LocalizationReport, QueryDrawing, method_name};
use super::worst::worst_first;
use crate::drawing::{self, Margin};
use crate::images::data_address;
use crate::numbers::{LengthUnit, degrees, kilobytes, milliseconds, percent, scheme_name};
use crate::page::{self, legend};
use crate::scene::{MatchState, QueryOutcome, SentDrawing};
use crate::table::{Table, cell, number, words};

/// Maximum number of listed queries that are not drawn.
const MAX_LISTED: usize = 300;

/// Anchor of a drawing on the page.
pub(super) fn anchor(drawing: usize) -> String {
    format!("query-{drawing}")
}

/// The queries: drawings of some, and a line for each other one.
pub fn section(report: &LocalizationReport) -> Markup {
    let order = worst_first(&report.methods, &report.outcomes);
    let at = |(scene, name): &(usize, String)| {
        report.drawings.iter().position(|drawing| drawing.scene == *scene && drawing.name == *name)
    };
    let drawn: Vec<usize> = order.iter().filter_map(at).collect();
    let others: Vec<&(usize, String)> = order.iter().filter(|query| at(query).is_none()).collect();
    html! {
        @if !drawn.is_empty() {
            p {
                (drawn.len()) " of " (order.len()) " queries are drawn: first those that most methods did not localize, then by \
                 their largest error. The tables count matches; the pictures count rows, and a row can have several matches."
            }
            (match_legend())
            @for (index, drawing) in drawn.iter().enumerate() { (query(report, *drawing, index == 0)) }
        }
        (list(report, &others))
    }
}

/// Legend of the colours of rows.
fn match_legend() -> Markup {
    legend(&[
        ("line inlier", "inlier of the pose"),
        ("line outlier", "matched, but no inlier"),
        ("line unmatched", "not matched"),
        ("dot seen", "map point of an inlier, as the pose projects it"),
    ])
}

/// One query with all its data.
fn query(report: &LocalizationReport, index: usize, open: bool) -> Markup {
    let drawing = &report.drawings[index];
    let own = outcomes_of(report, drawing.scene, &drawing.name);
    let id = anchor(index);
    let size = drawing.sent.first().map_or((1, 1), |sent| sent.size);
    let address = drawing.image.as_ref().and_then(data_address).filter(|_| !drawing.sent.is_empty());
    let backdrop = html! { @if address.is_some() { use.faint href={ "#" (id) "-image" } {} } };
    html! {
        details.fold #(id) open[open] {
            summary { h3 { (name_of(report, drawing.scene, &drawing.name)) } span { (in_words(report, &own)) } }
            (table(report, &own, &drawing.name))
            @if let Some(address) = &address { (drawing::shared_image(&format!("{id}-image"), size, address)) }
            div.gallery {
                @if address.is_some() { (image(drawing, &id, size)) }
                @for sent in &drawing.sent { (figure(sent, &backdrop)) }
            }
        }
    }
}

fn image(drawing: &QueryDrawing, id: &str, size: (u32, u32)) -> Markup {
    let layers = html! { use href={ "#" (id) "-image" } {} };
    let caption = html! {
        b { "The image" } @if drawing.is_undistorted { ", without the distortion of its lens" } ". It was never sent."
    };
    page::figure(
        &drawing::picture(&format!("The image of {}", drawing.name), size, Margin::Narrow, &layers),
        &caption,
    )
}

/// The rows sent under a scheme, coloured by their matches.
pub fn figure(drawing: &SentDrawing, backdrop: &Markup) -> Markup {
    let name = scheme_name(&drawing.scheme);
    let count = |state| drawing.rows.iter().filter(|row| **row == state).count();
    let (inliers, outliers) = (count(MatchState::Inlier), count(MatchState::Outlier));
    let label = format!("Rows under {name}: {inliers} with an inlier, {outliers} matched without");
    let layers = html! { (backdrop) (drawing::matched(drawing)) };
    let caption = html! {
        b { (name) "." } " " (drawing.sent.len()) " rows: " (inliers) " with an inlier, " (outliers) " matched without one."
    };
    page::figure(&drawing::picture(&label, drawing.size, Margin::Narrow, &layers), &caption)
}

fn name_of(report: &LocalizationReport, scene: usize, name: &str) -> String {
    let scene = report.scenes.get(scene).filter(|_| report.scenes.len() > 1);
    scene.map_or_else(|| name.to_owned(), |scene| format!("{} / {name}", scene.name))
}

fn outcomes_of<'a>(report: &'a LocalizationReport, scene: usize, name: &str) -> Vec<&'a QueryOutcome> {
    let of_scene =
        |o: &&QueryOutcome| report.methods.get(o.method).is_some_and(|method| method.scene == scene);
    report.outcomes.iter().filter(|o| o.name == name).filter(of_scene).collect()
}

fn method_of(report: &LocalizationReport, outcome: &QueryOutcome) -> String {
    report.methods.get(outcome.method).map(method_name).unwrap_or_default()
}

/// The outcome of every method, in a few words.
fn in_words(report: &LocalizationReport, own: &[&QueryOutcome]) -> Markup {
    let words = |outcome: &QueryOutcome| match (outcome.estimate, outcome.position_error, outcome.position_sd)
    {
        (None, ..) => html! { span.none { "no pose" } },
        (_, Some(error), _) => html! { (report.unit.with_unit(error)) },
        (_, None, Some(sd)) => html! { "± " (report.unit.with_unit(sd)) },
        _ => html! { "localized" },
    };
    html! {
        @for (index, outcome) in own.iter().enumerate() {
            @if index > 0 { " · " }
            (method_of(report, outcome)) ": " (words(outcome))
        }
    }
}

const fn state_words(state: State) -> (&'static str, &'static str) {
    match state {
        State::Trusted => ("state trusted", "trusted"),
        State::Doubtful => ("state doubtful", "doubtful"),
        State::NotFound => ("state lost", "not found"),
    }
}

fn table(report: &LocalizationReport, own: &[&QueryOutcome], name: &str) -> Markup {
    let unit: LengthUnit = report.unit;
    let columns = vec![
        words("Scheme"),
        words("State"),
        number(unit.head("Position\nerror")),
        number("Rotation\nerror"),
        number(unit.head("± of the\nposition")),
        number("± of the\nrotation"),
        number("Inliers of\nmatches"),
        number("Sent"),
        number("Time"),
    ];
    let mut table = Table::new(format!("Figures of {name}"), columns);
    for outcome in own {
        let of_pose = |text: Option<String>| cell(text.filter(|_| outcome.estimate.is_some()));
        let share = outcome.inliers as f64 / outcome.matches.max(1) as f64;
        let state = outcome.state.map(|state| {
            let (class, words) = state_words(state);
            html! { span class=(class) { (words) } }
        });
        let cells = vec![
            state,
            of_pose(outcome.position_error.map(|error| unit.length(error))),
            of_pose(outcome.rotation_error_deg.map(degrees)),
            of_pose(outcome.position_sd.map(|sd| format!("± {}", unit.length(sd)))),
            of_pose(outcome.rotation_sd_deg.map(|sd| format!("± {}", degrees(sd)))),
            cell(format!("{} of {} ({})", outcome.inliers, outcome.matches, percent(share))),
            cell(outcome.bytes.map(|bytes| kilobytes(bytes as f64))),
            cell(outcome.ms.map(milliseconds)),
        ];
        table.push("", html! { (method_of(report, outcome)) }, cells);
    }
    html! {
        (table.html())
        @for outcome in own {
            @if let Some(remark) = &outcome.remark {
                p.note { (method_of(report, outcome)) ": " (remark.trim_end_matches('.')) "." }
            }
        }
    }
}

/// A line for each query that is not drawn.
fn list(report: &LocalizationReport, queries: &[&(usize, String)]) -> Markup {
    let mut table =
        Table::new("Queries that are not drawn", vec![words("Query"), words("Position error or ±")]);
    for (scene, name) in queries.iter().take(MAX_LISTED) {
        let outcomes = in_words(report, &outcomes_of(report, *scene, name));
        table.push("", html! { (name_of(report, *scene, name)) }, vec![Some(outcomes)]);
    }
    let more = if queries.len() > MAX_LISTED {
        format!(", the worst {MAX_LISTED} of {}", queries.len())
    } else {
        String::new()
    };
    page::fold(&format!("Queries that are not drawn{more}"), false, &table.html())
}
