//! Results of attacks: the strongest on each scheme, all attacks, and figures of one image.

use crate::attack_evaluation::{
    Attack, AttackDocument, AttackSummary, Knowledge, Neighbours, ShownImage, StrongestAttacks,
};
use maud::{Markup, html};

use super::attack_figures::{AttackFigures, error_legend};
use veiloc_report::numbers::{capital, milliseconds, percent, pixels, scheme_name};
use veiloc_report::page::{facts, fold};
use veiloc_report::table::{Cell, Table, bar, cell, number, words};

/// An attack has recovered the keypoints when their median error is below this, pixels.
const RECOVERED_PX: f64 = 10.0;
/// Smallest gain over the baseline that counts, bits: less is written as zero.
const MIN_GAIN: f64 = 0.005;

/// Schemes in the order of the document.
pub(super) fn schemes(document: &AttackDocument) -> Vec<&str> {
    let baselines = document.attacks.iter().filter(|row| row.attack == Attack::PRIOR);
    baselines.map(|row| row.scheme.as_str()).collect()
}

/// The strongest attacks on each scheme, with an explanation.
pub(super) fn summary(document: &AttackDocument) -> Markup {
    let columns = vec![
        words("Scheme"),
        words("Attacker"),
        words("Result"),
        number("Median\nerror"),
        number("Within\n10 px"),
        number("Bits over\nthe baseline"),
        words("Strongest attack"),
    ];
    let mut table = Table::new("The strongest attack on each scheme", columns);
    for (index, StrongestAttacks { scheme, without_oracle, with_oracle }) in
        document.strongest().iter().enumerate()
    {
        let attackers = [
            ("without an oracle", *without_oracle),
            ("with true neighbours", *with_oracle),
            ("prior-only baseline", Some(Attack::PRIOR)),
        ];
        let mut is_first = true;
        for (attacker, attack) in attackers {
            let Some(row) = attack.and_then(|attack| document.row(scheme, attack)) else { continue };
            let is_baseline = row.attack == Attack::PRIOR;
            let cells = vec![
                cell(attacker.to_owned()),
                result(row).filter(|_| !is_baseline),
                cell(pixels(row.median_px)),
                Some(html! { (percent(row.under_10px)) (bar(row.under_10px)) }),
                bits(row),
                cell(Some(capital(row.attack.words)).filter(|_| !is_baseline)),
            ];
            let head = html! { @if is_first { (scheme_name(scheme)) small { (scheme) } } };
            table.push(row_class(is_baseline, is_first && index > 0), head, cells);
            is_first = false;
        }
    }
    let explanation = html! {
        p {
            "The table has, for each scheme, the strongest attack that a real attacker can run, the strongest one to which an \
             oracle gives the true nearest neighbours of each keypoint, which no real attacker has, and the prior-only baseline, \
             the best answer from the single line alone. Positions are recovered when half of the keypoints come out within \
             10 px of the truth; an attack is no better when it gains no bits over the baseline. One bit halves the error, on \
             average over keypoints; a negative number is worse than the baseline."
        }
        p {
            "A scheme protects against an attack as far as the attack gains nothing over the baseline. A large error shows that this attack fails, \
             not that every attack fails. Only positions are attacked here: descriptors are sent under every scheme."
        }
    };
    html! {
        (table.html())
        (fold("How to read this table", false, &explanation))
    }
}

/// The verdict: any gain over the baseline is named; `None` for an unknown one.
fn result(row: &AttackSummary) -> Cell {
    let (class, words) = match row.bits_over_prior {
        _ if row.median_px < RECOVERED_PX => ("result recovered", "recovered".to_owned()),
        bits if bits >= MIN_GAIN => ("result narrowed", format!("gains {bits:.2} bits")),
        bits if bits < MIN_GAIN => ("result protected", "no better".to_owned()),
        _ => return None,
    };
    Some(html! { span class=(class) { (words) } })
}

const fn row_class(is_baseline: bool, begins_group: bool) -> &'static str {
    match (is_baseline, begins_group) {
        (true, true) => "baseline group",
        (true, false) => "baseline",
        (false, true) => "group",
        (false, false) => "",
    }
}

fn bits(row: &AttackSummary) -> Cell {
    let is_known = row.attack != Attack::PRIOR && row.bits_over_prior.is_finite();
    cell(is_known.then(|| format!("{:+.2}", row.bits_over_prior)))
}

/// All attacks on all schemes; for each scheme, first those without an oracle. `bending`: one value per row of the
/// document, or empty.
pub(super) fn table(document: &AttackDocument, bending: &[f64]) -> Markup {
    let columns = vec![
        words("Scheme"),
        words("Attack"),
        words("From an\noracle"),
        number("Neighbours\nreplaced"),
        number("Mean\nerror"),
        number("Median\nerror"),
        number("Within\n5 px"),
        number("Within\n10 px"),
        number("Within\n30 px"),
        number("Bits over\nthe baseline"),
        number("Error of\noffsets"),
        number("Images"),
        number("Time per\nimage"),
    ];
    let mut table = Table::new("Every attack on every scheme", columns);
    let schemes = schemes(document);
    let mut rows: Vec<(usize, &AttackSummary)> = document.attacks.iter().enumerate().collect();
    rows.sort_by_key(|(_, row)| {
        (schemes.iter().position(|scheme| *scheme == row.scheme), document.uses_oracle(row.attack))
    });
    let images = rows.iter().map(|(_, row)| row.images).max();
    let images_differ = rows.iter().any(|(_, row)| Some(row.images) != images);
    let mut last = None;
    for (index, row) in rows {
        let is_first = last != Some(&row.scheme);
        let is_baseline = row.attack == Attack::PRIOR;
        let share = |share: f64| Some(html! { span.leak[!is_baseline && share >= 0.5] { (percent(share)) } });
        let cells = vec![
            cell(capital(row.attack.words)),
            cell(document.uses_oracle(row.attack).then(|| "neighbours".to_owned())),
            cell((row.corrupt > 0.0).then(|| format!("{:.0} %", row.corrupt))),
            cell(pixels(row.mean_px)),
            cell(pixels(row.median_px)),
            share(row.under_5px),
            share(row.under_10px),
            share(row.under_30px),
            bits(row),
            cell(bending.get(index).filter(|bent| bent.is_finite()).map(|bent| percent(*bent))),
            cell(images_differ.then(|| row.images.to_string())),
            cell(milliseconds(row.ms)),
        ];
        let head = html! { @if is_first { (scheme_name(&row.scheme)) small { (row.scheme) } } };
        table.push(row_class(is_baseline, is_first && last.is_some()), head, cells);
        last = Some(&row.scheme);
    }
    html! {
        (table.html())
        p.note {
            "Red: at least half of the keypoints. "
            @if !bending.is_empty() {
                "Error of offsets: the median error of the offset from a keypoint to a neighbour, over its length; where it is small \
                 and the error in pixels large, the layout is right, but shifted or bent. "
            }
        }
    }
}

/// What each attack of a document requires beside the query.
pub(super) fn needs(document: &AttackDocument) -> Markup {
    let mut attacks: Vec<Attack> = Vec::new();
    for row in &document.attacks {
        if !attacks.contains(&row.attack) {
            attacks.push(row.attack);
        }
    }
    let entry = |attack: &Attack| {
        let neighbours = match document.neighbours {
            Neighbours::Oracle => {
                format!("the true {} nearest keypoints of each, from an oracle", document.k)
            }
            Neighbours::Predicted => "neighbours predicted from descriptors".to_owned(),
            Neighbours::Network => "neighbours predicted from descriptors by a network".to_owned(),
            Neighbours::Transferred => "neighbours in the images of a map".to_owned(),
        };
        let needs = match (attack.holds, attack.needs(Knowledge::Neighbours)) {
            ("", false) => "nothing else".to_owned(),
            ("", true) => neighbours,
            (holds, false) => holds.to_owned(),
            (holds, true) => format!("{holds}, and {neighbours}"),
        };
        (attack.name.to_owned(), format!("{}. Needs: {needs}.", capital(attack.words)))
    };
    facts(&attacks.iter().map(entry).collect::<Vec<_>>())
}

/// One image under every scheme and attack, in small figures. `id` makes its element ids unique on the page.
pub(super) fn gallery(shown: &ShownImage, document: &AttackDocument, id: &str) -> Markup {
    let figures = AttackFigures::new(shown, id);
    html! {
        (figures.shared())
        (error_legend())
        @for scheme in &shown.schemes {
            h4 { (scheme_name(&scheme.scheme.to_string())) }
            div.gallery {
                (figures.sent(scheme, "As sent."))
                @for attack in &scheme.attacks {
                    @let oracle = if document.uses_oracle(attack.attack) { " (with true neighbours)" } else { "" };
                    (figures.recovered(attack, &format!("{}{oracle}.", capital(attack.attack.words))))
                }
            }
        }
    }
}
