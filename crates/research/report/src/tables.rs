//! The tables: how well it localizes, whether to trust it, what it takes, and how much it leaks.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use super::format::{degrees, escape, length, milliseconds, percent, pixels, scheme_words};
use veiloc_evaluation::audit::{Attack, AttackSummary, capital};
use veiloc_evaluation::results::{STAGES, SchemeSummary};

/// A row of a table: what it is called (HTML), what the scheme does, and its figures.
pub(super) struct TableRow<'a> {
    pub(super) name: String,
    pub(super) what: &'static str,
    pub(super) summary: &'a SchemeSummary,
}

/// Errors and recall, a row a scheme.
pub(super) fn localization(rows: &[TableRow<'_>]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let keys = rows.iter().flat_map(|r| r.summary.recall.keys());
    let mut thresholds: Vec<&String> = keys.collect::<BTreeSet<_>>().into_iter().collect();
    let key = |t: &str| t.split_once('/').and_then(|(d, _)| d.parse::<f64>().ok()).unwrap_or(f64::INFINITY);
    thresholds.sort_by(|a, b| key(a).total_cmp(&key(b)).then(a.cmp(b)));
    let mut out = String::from(
        "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Errors and recall\"><table><thead><tr>\
         <th scope=\"col\">Scheme</th><th scope=\"col\">Localized</th><th scope=\"col\">Position error<br>(median)</th>\
         <th scope=\"col\">Rotation error<br>(median)</th>",
    );
    for t in &thresholds {
        let _ = write!(out, "<th scope=\"col\">Within<br>{}</th>", threshold_words(t));
    }
    out.push_str(
        "<th scope=\"col\">Agreeing<br>matches</th><th scope=\"col\">Query size</th></tr></thead><tbody>",
    );
    for TableRow { name, what, summary } in rows {
        let _ = write!(
            out,
            "<tr><th scope=\"row\">{name}<small>{what}</small></th><td>{} of {}</td><td>{}</td><td>{}</td>",
            summary.localized,
            summary.queries,
            length(summary.median_translation),
            degrees(summary.median_rotation_deg)
        );
        for t in &thresholds {
            let share = summary.recall.get(*t).copied();
            let _ = write!(out, "<td>{}{}</td>", percent(share), bar(share));
        }
        let bytes =
            summary.sealed_bytes.map_or_else(|| "–".to_owned(), |b| format!("{:.1} kB", b as f64 / 1e3));
        let _ = write!(out, "<td>{}</td><td>{bytes}</td></tr>", percent(summary.mean_inlier_ratio));
    }
    out + "</tbody></table></div>"
}

/// What the estimator says of its poses, and how right it is; nothing where it was not asked.
pub(super) fn trust(rows: &[TableRow<'_>]) -> String {
    let asked: Vec<&TableRow<'_>> = rows.iter().filter(|row| row.summary.trusted.is_some()).collect();
    if asked.is_empty() {
        return String::new();
    }
    let mut out = String::from(
        "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Trust\"><table><thead><tr><th scope=\"col\">Scheme</th>\
         <th scope=\"col\">Trusted</th><th scope=\"col\">Trusted,<br>yet wrong</th><th scope=\"col\">Doubtful</th>\
         <th scope=\"col\">Not found</th><th scope=\"col\">Error over ±<br>(median)</th><th scope=\"col\">Truth within the<br>90 % region</th>\
         </tr></thead><tbody>",
    );
    for row in asked {
        let s = row.summary;
        let count = |n: Option<usize>| n.map_or_else(|| "–".to_owned(), |n| n.to_string());
        let wrong = if s.trusted_wrong.is_some_and(|n| n > 0) { " class=\"leak\"" } else { "" };
        let known = s.uncertainty.as_ref();
        let ratio = known.and_then(|u| u.center_error_over_sd);
        let ninety = known.and_then(|u| u.coverage.get("90").copied());
        let _ = write!(
            out,
            "<tr><th scope=\"row\">{}</th><td>{}</td><td{wrong}>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            row.name,
            count(s.trusted),
            count(s.trusted_wrong),
            count(s.doubtful),
            count(s.not_found),
            ratio.map_or_else(|| "–".to_owned(), |r| format!("{r:.2}")),
            percent(ninety),
        );
    }
    out + "</tbody></table></div>"
}

/// Median time of each stage, as a query goes through them.
pub(super) fn stage_times(rows: &[TableRow<'_>]) -> String {
    let known: BTreeSet<&String> = rows.iter().flat_map(|r| r.summary.median_ms.keys()).collect();
    // What is not on that road comes last.
    let place = |stage: &str| STAGES.iter().position(|s| *s == stage).unwrap_or(STAGES.len());
    let mut stages: Vec<&String> = known.into_iter().collect();
    stages.sort_by_key(|stage| place(stage));
    if stages.is_empty() {
        return String::new();
    }
    let mut out = String::from(
        "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Times\"><table><thead><tr>\
         <th scope=\"col\">Scheme</th>",
    );
    for stage in &stages {
        let _ = write!(out, "<th scope=\"col\">{}</th>", escape(stage));
    }
    out.push_str("</tr></thead><tbody>");
    for row in rows {
        let _ = write!(out, "<tr><th scope=\"row\">{}</th>", row.name);
        for stage in &stages {
            let _ = write!(out, "<td>{}</td>", milliseconds(row.summary.median_ms.get(*stage).copied()));
        }
        out.push_str("</tr>");
    }
    out + "</tbody></table></div>"
}

/// `"0.05/5"` as `5.0 cm, 5°`.
fn threshold_words(key: &str) -> String {
    let parsed = key.split_once('/').and_then(|(t, d)| Some((t.parse().ok()?, d.parse::<f64>().ok()?)));
    match parsed {
        Some((t, d)) => format!("{}, {d}°", length(Some(t)).replace(".0 ", " ").replace(".00 ", " ")),
        None => escape(key),
    }
}

/// A bar whose width is the share; drawn, since the page's policy takes no styles at elements.
fn bar(share: Option<f64>) -> String {
    let width = 46.0 * share.filter(|s| s.is_finite()).unwrap_or(0.0).clamp(0.0, 1.0);
    format!(
        "<svg class=\"bar\" viewBox=\"0 0 46 7\" aria-hidden=\"true\"><rect width=\"46\" height=\"7\" rx=\"3.5\" class=\"rail\"/>\
         <rect width=\"{width:.1}\" height=\"7\" rx=\"3.5\" class=\"fill\"/></svg>"
    )
}

pub(super) fn attacks(rows: &[AttackSummary]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let mut out = String::from(
        "<div class=\"scroll attacks\" tabindex=\"0\" role=\"region\" aria-label=\"Attacks\"><table><thead><tr><th scope=\"col\">Scheme\
         </th><th scope=\"col\">Attack</th><th scope=\"col\">Mean error</th><th scope=\"col\">Median error</th>\
         <th scope=\"col\">Recovered to<br>within 30 px</th><th scope=\"col\">Learned beyond<br>the guess</th><th scope=\"col\">Images</th>\
         <th scope=\"col\">Time a<br>image</th></tr></thead><tbody>",
    );
    let mut last = None;
    for row in rows {
        let guess = row.attack == Attack::PRIOR;
        let group = last.is_some_and(|l| l != &row.scheme);
        let name = if last == Some(&row.scheme) { String::new() } else { scheme_words(&row.scheme).0 };
        last = Some(&row.scheme);
        let class = match (guess, group) {
            (true, true) => " class=\"guess group\"",
            (true, false) => " class=\"guess\"",
            (false, true) => " class=\"group\"",
            (false, false) => "",
        };
        let leak = if !guess && row.under_30px > 0.5 { " class=\"leak\"" } else { "" };
        let bits = Some(row.bits_over_prior).filter(|b| b.is_finite() && !guess);
        let _ = write!(
            out,
            "<tr{class}><th scope=\"row\">{name}</th><td>{}</td><td>{}</td><td>{}</td><td{leak}>{}{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            escape(&capital(row.attack.words)),
            pixels(row.mean_px),
            pixels(row.median_px),
            percent(Some(row.under_30px)),
            bar(Some(row.under_30px)),
            bits.map_or_else(|| "–".to_owned(), |b| format!("{b:+.1} bits")),
            row.images,
            milliseconds(Some(row.ms)),
        );
    }
    out.push_str(
        "</tbody></table></div><p class=\"note\">One bit more than the guess halves the attacker's error; a negative \
         number means that the attack did worse than guessing. A large error therefore shows that this attack fails, \
         not that no attack can succeed.</p>",
    );
    out
}
