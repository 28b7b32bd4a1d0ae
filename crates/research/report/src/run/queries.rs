//! Queries by themselves, worst first: figures, and what was sent over the image that was not.

use std::fmt::Write as _;

use veiloc_pose::State;

use super::data::{QueryDrawing, QueryOutcome, RowState, RunReport, SentDrawing};
use super::{name_of, worst_first};
use crate::embed::data_address;
use crate::format::{degrees, escape, length, milliseconds, percent, scheme_words};
use crate::sent;

/// Queries in the list of those that are not drawn, at most.
const MOST_LISTED: usize = 300;

/// Where on the page a drawing is.
pub(super) fn id(drawing: usize) -> String {
    format!("query-{drawing}")
}

pub(crate) fn section(run: &RunReport) -> String {
    let order = worst_first(&run.rows, &run.outcomes);
    if order.is_empty() {
        return String::new();
    }
    let mut out = String::new();
    let mut drawn = 0;
    for (place, name) in &order {
        let at = run.drawings.iter().position(|drawing| drawing.place == *place && drawing.name == *name);
        if let Some(at) = at {
            out.push_str(&drill_down(run, at, drawn == 0));
            drawn += 1;
        }
    }
    if drawn > 0 {
        out = format!(
            "<p>{drawn} of {} queries are drawn: those that most schemes did not localize first, then by their largest error. Rows \
             of a query that were matched to a map point and agree with the pose are green, matched ones that do not agree \
             are orange, the others grey.</p>{}{out}",
            order.len(),
            legend()
        );
    }
    out + &others(run, &order)
}

fn legend() -> String {
    let line = |class: &str, words: &str| {
        format!(
            "<li><svg viewBox=\"0 0 12 12\" aria-hidden=\"true\"><path class=\"line {class}\" d=\"M1 11L11 1\"/></svg>{words}</li>"
        )
    };
    format!(
        "<ul class=\"legend\">{}{}{}<li><svg viewBox=\"0 0 12 12\" aria-hidden=\"true\"><path class=\"dot ring\" d=\"M6 6h0\"/>\
         <path class=\"dot seen\" d=\"M6 6h0\"/></svg>where the pose puts an agreeing row's map point</li></ul>",
        line("agrees", "agrees with the pose"),
        line("disagrees", "matched, does not agree"),
        line("unmatched", "not matched"),
    )
}

/// One query with all that is known of it.
fn drill_down(run: &RunReport, at: usize, open: bool) -> String {
    let drawing = &run.drawings[at];
    let own = outcomes_of(run, drawing.place, &drawing.name);
    let id = id(at);
    let place = run.places.get(drawing.place).filter(|_| run.places.len() > 1);
    let place = place.map_or_else(String::new, |place| format!("{} / ", escape(&place.name)));
    let mut out = format!(
        "<details class=\"query\" id=\"{id}\"{}><summary><h3>{place}{}</h3><span>{}</span></summary>{}",
        if open { " open" } else { "" },
        escape(&drawing.name),
        in_words(run, &own),
        table(run, &own, &drawing.name),
    );
    let address = drawing.image.as_ref().and_then(data_address);
    if let (Some(address), Some(size)) = (&address, drawing.sent.first().map(|sent| sent.size)) {
        let (w, h) = size;
        let _ = write!(
            out,
            "<svg width=\"0\" height=\"0\" class=\"shared\" aria-hidden=\"true\"><defs><image id=\"{id}-image\" width=\"{w}\" \
             height=\"{h}\" preserveAspectRatio=\"none\" href=\"{address}\"/></defs></svg>"
        );
    }
    out.push_str("<div class=\"four\">");
    if address.is_some() && !drawing.sent.is_empty() {
        out.push_str(&image(drawing, &id));
    }
    let backdrop = if address.is_some() {
        format!("<use href=\"#{id}-image\" class=\"faint\"/>")
    } else {
        String::new()
    };
    for sent in &drawing.sent {
        out.push_str(&figure(sent, &backdrop));
    }
    out + "</div></details>"
}

fn image(drawing: &QueryDrawing, id: &str) -> String {
    let (w, h) = drawing.sent.first().map_or((1, 1), |sent| sent.size);
    format!(
        "<figure><svg viewBox=\"{}\" role=\"img\" aria-label=\"The image of {}\"><use href=\"#{id}-image\"/><rect class=\"rim\" \
         width=\"{w}\" height=\"{h}\"/></svg><figcaption><b>The image</b>, its lens undone. It was never sent.</figcaption></figure>",
        sent::view_box((w, h)),
        escape(&drawing.name),
    )
}

/// What was sent under a scheme, by what became of it.
pub(crate) fn figure(drawing: &SentDrawing, backdrop: &str) -> String {
    let (w, h) = drawing.size;
    let (name, _) = scheme_words(&drawing.scheme);
    let count = |state| drawing.rows.iter().filter(|row| **row == state).count();
    let (agree, disagree) = (count(RowState::Agrees), count(RowState::Disagrees));
    format!(
        "<figure><svg viewBox=\"{}\" role=\"img\" aria-label=\"Rows under {name}: {agree} agree, {disagree} do not\"><rect \
         class=\"frame\" width=\"{w}\" height=\"{h}\"/>{backdrop}{}</svg><figcaption><b>{name}.</b> {} rows, {} matched, {agree} \
         agree.</figcaption></figure>",
        sent::view_box(drawing.size),
        sent::matched(drawing),
        drawing.sent.len(),
        agree + disagree,
    )
}

fn outcomes_of<'a>(run: &'a RunReport, place: usize, name: &str) -> Vec<&'a QueryOutcome> {
    let of_place = |o: &&QueryOutcome| run.rows.get(o.row).is_some_and(|row| row.place == place);
    run.outcomes.iter().filter(|o| o.name == name).filter(of_place).collect()
}

/// The outcome in every row, a few words each.
fn in_words(run: &RunReport, own: &[&QueryOutcome]) -> String {
    let words = own.iter().map(|outcome| {
        let name = run.rows.get(outcome.row).map(name_of).unwrap_or_default();
        match (outcome.estimate, outcome.position_error, outcome.position_sd) {
            (None, ..) => format!("{name}: <span class=\"none\">no pose</span>"),
            (_, Some(error), _) => format!("{name}: {}", length(Some(error))),
            (_, None, Some(sd)) => format!("{name}: ± {}", length(Some(sd))),
            _ => format!("{name}: localized"),
        }
    });
    words.collect::<Vec<_>>().join(" · ")
}

const fn state_words(state: Option<State>) -> (&'static str, &'static str) {
    match state {
        Some(State::Trusted) => ("state trusted", "trusted"),
        Some(State::Doubtful) => ("state doubtful", "doubtful"),
        Some(State::NotFound) => ("state lost", "not found"),
        None => ("", "–"),
    }
}

fn table(run: &RunReport, own: &[&QueryOutcome], name: &str) -> String {
    let judged = own.iter().any(|o| o.truth.is_some());
    let mut out = format!(
        "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Figures of {}\"><table><thead><tr><th scope=\"col\">Scheme</th>\
         <th scope=\"col\" class=\"of-state\">State</th>",
        escape(name)
    );
    if judged {
        out.push_str("<th scope=\"col\">Position error</th><th scope=\"col\">Rotation error</th>");
    }
    out.push_str(
        "<th scope=\"col\">± position</th><th scope=\"col\">± rotation</th><th scope=\"col\">Agreeing<br>of matches</th>\
         <th scope=\"col\">Sent</th><th scope=\"col\">Time</th></tr></thead><tbody>",
    );
    for outcome in own {
        let (class, words) = state_words(outcome.state);
        let dash = |text: String| if outcome.estimate.is_none() { "–".to_owned() } else { text };
        let _ = write!(
            out,
            "<tr><th scope=\"row\">{}</th><td><span class=\"{class}\">{words}</span></td>",
            run.rows.get(outcome.row).map(name_of).unwrap_or_default()
        );
        if judged {
            let _ = write!(
                out,
                "<td>{}</td><td>{}</td>",
                length(outcome.position_error),
                dash(degrees(outcome.rotation_error_deg))
            );
        }
        let sd = |text: Option<String>| text.map_or_else(|| "–".to_owned(), |text| format!("± {text}"));
        let share = (outcome.matches > 0).then(|| outcome.inliers as f64 / outcome.matches as f64);
        let _ = write!(
            out,
            "<td>{}</td><td>{}</td><td>{} of {} ({})</td><td>{}</td><td>{}</td></tr>",
            sd(outcome.position_sd.map(|sd| length(Some(sd)))),
            sd(outcome.rotation_sd_deg.map(|sd| degrees(Some(sd)))),
            outcome.inliers,
            outcome.matches,
            percent(share),
            outcome.bytes.map_or_else(|| "–".to_owned(), |b| format!("{:.1} kB", b as f64 / 1e3)),
            milliseconds(outcome.ms),
        );
    }
    out.push_str("</tbody></table></div>");
    for outcome in own {
        if let Some(remark) = &outcome.remark {
            let name = run.rows.get(outcome.row).map(name_of).unwrap_or_default();
            let _ = write!(out, "<p class=\"note\">{name}: {}.</p>", escape(remark.trim_end_matches('.')));
        }
    }
    out
}

/// A line for each query that is not drawn.
fn others(run: &RunReport, order: &[(usize, String)]) -> String {
    let drawn = |place: usize, name: &str| run.drawings.iter().any(|d| d.place == place && d.name == name);
    let left: Vec<&(usize, String)> = order.iter().filter(|(place, name)| !drawn(*place, name)).collect();
    if left.is_empty() {
        return String::new();
    }
    let shown = left.len().min(MOST_LISTED);
    let more =
        if shown < left.len() { format!(", the worst {shown} of {}", left.len()) } else { String::new() };
    let mut out = format!(
        "<details class=\"query\"><summary><h3>Queries that are not drawn{more}</h3></summary><div class=\"scroll\" tabindex=\"0\" \
         role=\"region\" aria-label=\"Queries that are not drawn\"><table><thead><tr><th scope=\"col\">Query</th><th scope=\"col\" \
         class=\"left\">Position error or ±</th></tr></thead><tbody>"
    );
    for (place, name) in left.into_iter().take(MOST_LISTED) {
        let of = run.places.get(*place).filter(|_| run.places.len() > 1);
        let of = of.map_or_else(String::new, |place| format!("{} / ", escape(&place.name)));
        let own = outcomes_of(run, *place, name);
        let _ = write!(
            out,
            "<tr><th scope=\"row\">{of}{}</th><td class=\"left\">{}</td></tr>",
            escape(name),
            in_words(run, &own)
        );
    }
    out + "</tbody></table></div></details>"
}
