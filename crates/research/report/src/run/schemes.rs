//! Each row by itself: how its errors are spread, and its worst queries.

use std::fmt::Write as _;

use veiloc_pose::State;

use super::data::{QueryOutcome, RunReport, RunRow};
use super::{name_of, queries};
use crate::format::{degrees, escape, length, scheme_words};

/// Queries named as the worst of a row.
const WORST: usize = 5;
/// Ticks drawn at most.
const MOST_TICKS: usize = 1500;
const WIDTH: f64 = 720.0;
const LEFT: f64 = 14.0;
/// Where queries without a pose stand.
const LOST: f64 = 690.0;
const RIGHT: f64 = 640.0;

pub(super) fn section(run: &RunReport) -> String {
    let judged: Vec<f64> =
        run.outcomes.iter().filter_map(|o| o.position_error).filter(|e| *e > 0.0).collect();
    if judged.is_empty() || run.rows.is_empty() {
        return String::new();
    }
    // One axis for all, so that rows compare.
    let least = judged.iter().copied().fold(f64::INFINITY, f64::min).max(1e-6);
    let most = judged.iter().copied().filter(|e| e.is_finite()).fold(least, f64::max);
    let (least, most) =
        (10f64.powf(least.log10().floor()), 10f64.powf(most.log10().ceil()).max(least * 10.0));
    let mut out = String::from(
        "<p>A tick a query, by the error of its position; ticks of trusted poses are green, of doubted ones yellow and shorter, and \
         queries without a pose stand in the column on the right.</p>",
    );
    let several = run.places.len() > 1;
    for (at, row) in run.rows.iter().enumerate() {
        let own: Vec<&QueryOutcome> = run.outcomes.iter().filter(|outcome| outcome.row == at).collect();
        if own.is_empty() {
            continue;
        }
        let (name, (_, what)) = (name_of(row), scheme_words(&row.scheme));
        let of = [
            if several { run.places.get(row.place).map_or("", |place| &place.name) } else { "" },
            row.condition.as_deref().unwrap_or_default(),
        ];
        let of: Vec<String> =
            of.iter().filter(|p| !p.is_empty()).map(|p| format!(", {}", escape(p))).collect();
        let of = of.concat();
        let _ = write!(
            out,
            "<h3>{name}{of}</h3><p>{what}</p><figure class=\"strip\"><div class=\"wide\" tabindex=\"0\" role=\"region\" aria-label=\"Errors under {name}\">{}</div><figcaption>{}</figcaption></figure>",
            strip(&own, &name, least, most),
            worst(run, row, &own)
        );
    }
    out
}

/// Where an error stands.
fn place(error: f64, least: f64, most: f64) -> f64 {
    let share = (error.max(least) / least).ln() / (most / least).ln();
    LEFT + (RIGHT - LEFT) * share.clamp(0.0, 1.0)
}

fn strip(own: &[&QueryOutcome], name: &str, least: f64, most: f64) -> String {
    let mut paths = [String::new(), String::new(), String::new()];
    let mut lost = 0;
    let every = own.len().div_ceil(MOST_TICKS).max(1);
    for (at, outcome) in own.iter().enumerate() {
        let Some(error) = outcome.position_error.filter(|e| e.is_finite()) else {
            lost += usize::from(outcome.estimate.is_none());
            continue;
        };
        if at % every != 0 {
            continue;
        }
        let (kind, tall) = match outcome.state {
            Some(State::Doubtful) => (1, 14.0),
            Some(State::NotFound) => (2, 8.0),
            _ => (0, 26.0),
        };
        let _ = write!(paths[kind], "M{:.1} {:.1}v{tall}", place(error, least, most), 40.0 - tall);
    }
    let mut grid = String::new();
    let mut mark = least;
    while mark <= most * 1.0001 {
        let x = place(mark, least, most);
        let _ = write!(
            grid,
            "<path class=\"grid\" d=\"M{x:.1} 8v32\"/><text x=\"{x:.1}\" y=\"56\" text-anchor=\"middle\">{}</text>",
            length(Some(mark)).replace(".00 ", " ").replace(".0 ", " ")
        );
        mark *= 10.0;
    }
    format!(
        "<svg viewBox=\"-14 0 {:.0} 62\" role=\"img\" aria-label=\"Errors of the position under {name}, a tick a query; {lost} of \
         {} without a pose\">{grid}<path class=\"axis\" d=\"M{LEFT} 40H{RIGHT}\"/><path class=\"tick trusted\" d=\"{}\"/>\
         <path class=\"tick doubtful\" d=\"{}\"/><path class=\"tick wrong\" d=\"{}\"/><text class=\"count\" x=\"{LOST}\" y=\"34\" \
         text-anchor=\"middle\">{lost}</text><text x=\"{LOST}\" y=\"56\" text-anchor=\"middle\">no pose</text></svg>",
        WIDTH + 28.0,
        own.len(),
        paths[0],
        paths[1],
        paths[2],
    )
}

/// The worst queries of a row, in words; those that are drawn are links.
fn worst(run: &RunReport, row: &RunRow, own: &[&QueryOutcome]) -> String {
    let mut ranked = own.to_vec();
    let key = |o: &QueryOutcome| o.position_error.filter(|e| !e.is_nan()).unwrap_or(f64::INFINITY);
    ranked.sort_by(|a, b| key(b).total_cmp(&key(a)));
    let words = ranked.iter().take(WORST).map(|outcome| {
        let name = escape(&outcome.name);
        let at =
            run.drawings.iter().position(|d| d.place == row.place && d.name == outcome.name).map(queries::id);
        let name = at.map_or_else(|| name.clone(), |id| format!("<a href=\"#{id}\">{name}</a>"));
        if outcome.estimate.is_none() {
            return format!("{name} (no pose)");
        }
        format!("{name} ({}, {})", length(outcome.position_error), degrees(outcome.rotation_error_deg))
    });
    format!("<b>Worst:</b> {}.", words.collect::<Vec<_>>().join(", "))
}
