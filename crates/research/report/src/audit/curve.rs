//! How the attacks stand false neighbours: median error over the share that was replaced at random.

use std::fmt::Write as _;

use crate::format::escape;
use veiloc_evaluation::audit::px;
use veiloc_evaluation::audit::{Attack, AttackDocument, AttackSummary};

const WIDTH: f64 = 460.0;
const LEFT: f64 = 52.0;
const TOP: f64 = 14.0;
const BASE: f64 = 252.0;
/// Ends of the axis of errors, pixels.
const ENDS: (f64, f64) = (0.5, 1000.0);

/// The figure of one scheme; `None` where no attack ran at two shares. `color`: of an attack.
pub(super) fn figure(
    document: &AttackDocument,
    scheme: &str,
    title: &str,
    color: impl Fn(Attack) -> usize,
) -> Option<String> {
    let rows: Vec<&AttackSummary> = document.attacks.iter().filter(|r| r.scheme == scheme).collect();
    let mut attacks: Vec<Attack> = Vec::new();
    for row in &rows {
        let several = rows.iter().filter(|r| r.attack == row.attack).count() > 1;
        if several && !attacks.contains(&row.attack) {
            attacks.push(row.attack);
        }
    }
    let most = rows.iter().map(|r| r.corrupt).fold(0.0, f64::max);
    if attacks.is_empty() || most <= 0.0 {
        return None;
    }
    let x = |share: f64| LEFT + share / most * (WIDTH - LEFT - 24.0);
    let y = |error: f64| {
        let up = (error / ENDS.0).ln() / (ENDS.1 / ENDS.0).ln();
        BASE - up.clamp(0.0, 1.0) * (BASE - TOP)
    };
    let mut drawn = String::new();
    for pixels in [1.0, 10.0, 100.0, 1000.0] {
        let _ = write!(
            drawn,
            "<path class=\"grid\" d=\"M{LEFT} {at:.1}H{:.1}\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{pixels}</text>",
            WIDTH - 24.0,
            LEFT - 6.0,
            y(pixels) + 4.0,
            at = y(pixels),
        );
    }
    if let Some(guess) = rows.iter().find(|r| r.attack == Attack::PRIOR) {
        let at = y(guess.median_px);
        let _ = write!(drawn, "<path class=\"curve guessline\" d=\"M{LEFT} {at:.1}H{:.1}\"/>", WIDTH - 24.0);
    }
    let mut ticks: Vec<f64> = Vec::new();
    let mut legend = String::new();
    for attack in attacks {
        let mut of: Vec<&&AttackSummary> = rows.iter().filter(|r| r.attack == attack).collect();
        of.sort_by(|a, b| a.corrupt.total_cmp(&b.corrupt));
        let class = format!("curve k{}", color(attack) % 8);
        let mut path = String::new();
        for row in of {
            let (at, up) = (x(row.corrupt), y(row.median_px));
            let _ = write!(path, "{}{at:.1} {up:.1}", if path.is_empty() { 'M' } else { 'L' });
            let _ = write!(
                drawn,
                "<circle class=\"{class} point\" cx=\"{at:.1}\" cy=\"{up:.1}\" r=\"3.2\"><title>{:.0} %: {}</title></circle>",
                row.corrupt,
                px(row.median_px)
            );
            if !ticks.contains(&row.corrupt) {
                ticks.push(row.corrupt);
            }
        }
        let _ = write!(drawn, "<path class=\"{class}\" d=\"{path}\"/>");
        let _ = write!(
            legend,
            "<li><svg viewBox=\"0 0 24 12\" class=\"wide\" aria-hidden=\"true\"><path class=\"{class}\" d=\"M1 6H23\"/></svg>{}</li>",
            escape(attack.words)
        );
    }
    for share in ticks {
        let _ = write!(
            drawn,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{share:.0}</text>",
            x(share),
            BASE + 17.0
        );
    }
    Some(format!(
        "<figure><svg viewBox=\"0 0 {WIDTH} 310\" role=\"img\" aria-label=\"Median error by share of false neighbours\">{drawn}\
         <path class=\"axis\" d=\"M{LEFT} {BASE}H{:.0}\"/><text x=\"{:.0}\" y=\"{:.0}\" text-anchor=\"middle\">neighbours \
         replaced at random, percent</text></svg><figcaption><b>{}.</b> Median error in pixels; dashed: the guess.\
         <ul class=\"legend\">{legend}</ul></figcaption></figure>",
        WIDTH - 24.0,
        f64::midpoint(WIDTH, LEFT),
        BASE + 40.0,
        escape(title),
    ))
}
