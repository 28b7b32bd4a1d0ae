//! Tables over all queries: errors, trust, times.

use std::collections::BTreeSet;

use maud::{Markup, html};

use super::data::{LocalizationReport, Method, method_name};
use crate::numbers::{
    LengthUnit, degrees, kilobytes, milliseconds, percent, scheme_explanation, significant,
};
use crate::table::{Cell, Table, bar, cell, number, words};

/// Methods with figures, grouped by scene and condition.
pub(super) fn groups(report: &LocalizationReport) -> Vec<(String, Vec<&Method>)> {
    let mut groups: Vec<(String, Vec<&Method>)> = Vec::new();
    for method in report.methods.iter().filter(|method| method.figures.is_some()) {
        let scene = report.scenes.get(method.scene).map_or("", |scene| scene.name.as_str());
        let shared = [scene, method.condition.as_deref().unwrap_or_default()];
        let heading = shared.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(", ");
        match groups.iter_mut().find(|(known, _)| *known == heading) {
            Some((_, methods)) => methods.push(method),
            None => groups.push((heading, vec![method])),
        }
    }
    groups
}

/// Errors and recall.
pub(super) fn errors(methods: &[&Method], unit: LengthUnit) -> Markup {
    let keys = methods.iter().filter_map(|m| m.figures.as_ref()).flat_map(|figures| figures.recall.keys());
    let mut bounds: Vec<&String> = keys.collect::<BTreeSet<_>>().into_iter().collect();
    let length = |bound: &str| bound.split_once('/').and_then(|(t, _)| t.parse::<f64>().ok());
    bounds.sort_by(|a, b| length(a).unwrap_or(f64::INFINITY).total_cmp(&length(b).unwrap_or(f64::INFINITY)));
    let mut columns = vec![
        words("Scheme"),
        number("Localized"),
        number(unit.head("Median position\nerror")),
        number("Median rotation\nerror"),
    ];
    columns.extend(bounds.iter().map(|bound| number(format!("Recall at\n{}", bound_words(bound, unit)))));
    columns.extend([number("Inliers of\nmatches"), number("Query\nsize")]);
    let mut table = Table::new("Errors and recall", columns);
    for method in methods {
        let Some(figures) = &method.figures else { continue };
        let lost = || Some(html! { span.none { "not localized" } });
        let error = |text: Option<String>| cell(text).or_else(lost);
        let finite = |value: Option<f64>| value.filter(|v| v.is_finite());
        let mut cells = vec![
            cell(format!("{} of {}", figures.localized, figures.queries)),
            error(finite(figures.median_translation).map(|e| unit.length(e))),
            error(finite(figures.median_rotation_deg).map(degrees)),
        ];
        cells.extend(bounds.iter().map(|bound| {
            let share = *figures.recall.get(*bound)?;
            Some(html! { (percent(share)) (bar(share)) })
        }));
        cells.push(cell(figures.mean_inlier_ratio.map(percent)));
        cells.push(cell(figures.sealed_bytes.map(|bytes| kilobytes(bytes as f64))));
        let head = html! { (method_name(method)) small { (scheme_explanation(&method.scheme)) } };
        table.push("", head, cells);
    }
    table.html()
}

/// `"0.05/5"` as `5 cm, 5°`.
fn bound_words(bound: &str, unit: LengthUnit) -> String {
    let parsed = bound.split_once('/').and_then(|(t, d)| Some((t.parse().ok()?, d.parse::<f64>().ok()?)));
    parsed.map_or_else(|| bound.to_owned(), |(t, d)| format!("{}, {d}°", unit.length(t)))
}

/// States of poses according to the estimator, and whether they are right; empty if states were not evaluated.
pub(super) fn trust(methods: &[&Method]) -> Markup {
    let columns = vec![
        words("Scheme"),
        number("Trusted"),
        number("Trusted,\nyet wrong"),
        number("Doubtful"),
        number("Not found"),
        number("Median of\nerror over ±"),
        number("Truth within the\n90 % region"),
    ];
    let mut table = Table::new("Trust", columns);
    for method in methods {
        let Some(figures) = method.figures.as_ref().filter(|figures| figures.trusted.is_some()) else {
            continue;
        };
        let count = |n: Option<usize>| cell(n.map(|n| n.to_string()));
        let wrong = figures.trusted_wrong.map(|n| html! { span.leak[n > 0] { (n) } });
        let cells: Vec<Cell> = vec![
            count(figures.trusted),
            wrong,
            count(figures.doubtful),
            count(figures.not_found),
            cell(figures.error_over_sd.map(significant)),
            cell(figures.within_90.map(percent)),
        ];
        table.push("", html! { (method_name(method)) }, cells);
    }
    table.html()
}

/// Median time of each stage, in the order of the pipeline.
pub(super) fn stage_times(methods: &[&Method], stages: &[String]) -> Markup {
    let known: BTreeSet<&String> =
        methods.iter().filter_map(|m| m.figures.as_ref()).flat_map(|s| s.median_ms.keys()).collect();
    let order = |stage: &str| stages.iter().position(|known| known == stage).unwrap_or(stages.len());
    let mut columns: Vec<&String> = known.into_iter().collect();
    columns.sort_by_key(|stage| order(stage));
    if columns.is_empty() {
        return html! {};
    }
    let heads = std::iter::once(words("Scheme")).chain(columns.iter().map(|stage| number(stage.as_str())));
    let mut table = Table::new("Times", heads.collect());
    for method in methods {
        let Some(figures) = &method.figures else { continue };
        let cells =
            columns.iter().map(|stage| cell(figures.median_ms.get(*stage).copied().map(milliseconds)));
        table.push("", html! { (method_name(method)) }, cells.collect());
    }
    table.html()
}
