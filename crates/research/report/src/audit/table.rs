//! All figures of an evaluation.

use std::fmt::Write as _;

use crate::format::{escape, milliseconds};
use veiloc_evaluation::audit::Attack;
use veiloc_evaluation::audit::{AttackDocument, AttackSummary, AuditPart};
use veiloc_evaluation::audit::{percent, px, scheme_words};

/// Rows with their place in the document; of each scheme those first that were told nothing by an oracle.
fn in_order(document: &AttackDocument) -> Vec<(usize, &AttackSummary)> {
    let mut schemes: Vec<&str> = Vec::new();
    for row in &document.attacks {
        if !schemes.contains(&row.scheme.as_str()) {
            schemes.push(&row.scheme);
        }
    }
    let mut rows: Vec<(usize, &AttackSummary)> = document.attacks.iter().enumerate().collect();
    rows.sort_by_key(|(_, row)| {
        (schemes.iter().position(|s| *s == row.scheme), document.is_told(row.attack))
    });
    rows
}

/// One row per scheme, attack and share of replaced neighbours.
pub(super) fn table(part: &AuditPart) -> String {
    let rows = &part.attacks.attacks;
    let any_replaced = rows.iter().any(|r| r.corrupt > 0.0);
    let replaced_head = if any_replaced { "<th>Neighbours<br>replaced</th>" } else { "" };
    let mut out = format!(
        "<div class=\"scroll attacks\"><table><thead><tr><th>Scheme</th><th>Attack</th>{replaced_head}\
         <th>Mean<br>error</th><th>Median<br>error</th><th>Within<br>5 px</th><th>Within<br>10 px</th><th>Within<br>30 px</th>\
         <th>Bits beyond<br>the guess</th><th>Bent</th><th>Time a<br>image</th></tr></thead><tbody>",
    );
    let columns = 10 + usize::from(any_replaced);
    let mut last: Option<(&str, bool)> = None;
    for (index, row) in in_order(&part.attacks) {
        let told = part.attacks.is_told(row.attack);
        if told && last == Some((&row.scheme, false)) {
            let _ = write!(
                out,
                "<tr class=\"told\"><th></th><td colspan=\"{}\">Told the true neighbours by an oracle, which nobody is</td></tr>",
                columns - 1
            );
        }
        let guess = row.attack == Attack::PRIOR;
        let begins = last.is_none_or(|(scheme, _)| scheme != row.scheme);
        let class = match (guess, begins && last.is_some()) {
            (true, true) => " class=\"guess group\"",
            (true, false) => " class=\"guess\"",
            (false, true) => " class=\"group\"",
            (false, false) => "",
        };
        let name = if begins {
            format!("{}<small>{}</small>", escape(&scheme_words(&row.scheme)), escape(&row.scheme))
        } else {
            String::new()
        };
        last = Some((&row.scheme, told));
        let leak = |share: f64| if !guess && share >= 0.5 { " class=\"leak\"" } else { "" };
        let bits = if guess { "0".to_owned() } else { format!("{:+.2}", row.bits_over_prior) };
        let replaced = match (any_replaced, row.corrupt > 0.0) {
            (true, true) => format!("<td>{:.0} %</td>", row.corrupt),
            (true, false) => "<td></td>".to_owned(),
            (false, _) => String::new(),
        };
        let bent = part.bending.get(index).copied().unwrap_or(f64::NAN);
        let _ = write!(
            out,
            "<tr{class}><th>{name}</th><td>{}<small>{}</small></td>{replaced}<td>{}</td><td>{}</td><td{}>{}</td>\
             <td{}>{}</td><td{}>{}</td><td>{bits}</td><td>{}</td><td>{}</td></tr>",
            escape(row.attack.words),
            escape(row.attack.name),
            px(row.mean_px),
            px(row.median_px),
            leak(row.under_5px),
            percent(row.under_5px),
            leak(row.under_10px),
            percent(row.under_10px),
            leak(row.under_30px),
            percent(row.under_30px),
            percent(bent),
            milliseconds(Some(row.ms)),
        );
    }
    out + "</tbody></table></div>"
}
