//! Table 1: a row for each scheme and attack.

use std::fmt::Write as _;

use super::InversionRow;
use crate::format::{escape, percent, pixels, scheme_words};

/// A scheme's name for people, escaped, also of what is no scheme.
pub(super) fn given(scheme: &str) -> String {
    match scheme {
        "bag" => "Descriptors alone".to_owned(),
        "nothing" => "Nothing at all".to_owned(),
        scheme => scheme_words(scheme).0,
    }
}

/// An attack's name for people, escaped.
pub(super) fn attack_words(attack: &str, by: Option<&str>) -> String {
    let words = match attack {
        "none" => "nothing need be recovered",
        "guess" => "the guess",
        "closed-form" => "closed form, told the true neighbours",
        "graph" => "graph, told the true neighbours",
        "realistic" => "the best that is told nothing",
        "lines" => "none: lines as they are sent",
        other => other,
    };
    let by = by.map_or_else(String::new, |by| format!(" ({by})"));
    escape(&format!("{words}{by}"))
}

/// How much of what keypoints give beyond nothing a row gives, by PSNR; `None` without both of these rows.
pub(super) fn of_the_way(rows: &[InversionRow], row: &InversionRow) -> Option<f64> {
    let psnr = |scheme: &str| rows.iter().find(|r| r.scheme == scheme).map(|r| r.psnr);
    let (least, most) = (psnr("nothing")?, psnr("points")?);
    // Of a network that learned nothing there is no way to go.
    (most - least > 0.1).then(|| (row.psnr - least) / (most - least))
}

pub(super) fn table(rows: &[InversionRow]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    // A judge that was not there has no column.
    let has = |of: fn(&InversionRow) -> bool| rows.iter().any(of);
    let optional = [
        (has(|r| r.lpips.is_some()), "LPIPS"),
        (has(|r| r.feature_distance.is_some()), "Feature<br>distance"),
        (has(|r| r.objects.is_some()), "Objects<br>found again"),
        (has(|r| r.told_apart.is_some()), "Wrong places<br>told apart"),
        (rows.iter().any(|row| of_the_way(rows, row).is_some()), "Of what<br>keypoints give"),
    ];
    let mut out = String::from(
        "<div class=\"scroll attacks\" tabindex=\"0\" role=\"region\" aria-label=\"Table 1\"><table><thead><tr>\
         <th scope=\"col\">Scheme</th><th scope=\"col\">Attack</th><th scope=\"col\">Mean error<br>of positions</th>\
         <th scope=\"col\">PSNR</th><th scope=\"col\">SSIM</th>",
    );
    for (_, name) in optional.iter().filter(|(shown, _)| *shown) {
        let _ = write!(out, "<th scope=\"col\">{name}</th>");
    }
    out.push_str("</tr></thead><tbody>");
    let mut last = None;
    for row in rows {
        let first = last != Some(&row.scheme);
        let class = match (row.scheme.as_str(), first && last.is_some()) {
            ("nothing", _) => " class=\"guess group\"",
            (_, true) => " class=\"group\"",
            (_, false) => "",
        };
        last = Some(&row.scheme);
        let real = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), |v| format!("{v:.3}"));
        let _ = write!(
            out,
            "<tr{class}><th scope=\"row\">{}</th><td>{}</td><td>{}</td><td>{:.2} dB</td><td>{:.3}</td>",
            if first { given(&row.scheme) } else { String::new() },
            attack_words(&row.attack, row.by.as_deref()),
            row.mean_px.map_or_else(|| "–".to_owned(), pixels),
            row.psnr,
            row.ssim,
        );
        let cells = [
            real(row.lpips),
            real(row.feature_distance),
            row.objects.map_or_else(|| "–".to_owned(), |[found, all]| format!("{found} of {all}")),
            percent(row.told_apart),
            of_the_way(rows, row).map_or_else(|| "–".to_owned(), |share| format!("{:.0} %", 100.0 * share)),
        ];
        for (cell, _) in cells.iter().zip(optional).filter(|(_, (shown, _))| *shown) {
            let _ = write!(out, "<td>{cell}</td>");
        }
        out.push_str("</tr>");
    }
    out + "</tbody></table></div>"
}
