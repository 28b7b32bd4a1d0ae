//! Colours of attacks and order of schemes, the same in all figures of a part.

use veiloc_evaluation::audit::{Attack, Part};

/// Colour of an attack.
pub(super) fn color(part: &Part, attack: Attack) -> usize {
    let mut attacks: Vec<Attack> = Vec::new();
    for row in part.document.attacks.attacks.iter().filter(|r| r.attack != Attack::PRIOR) {
        if !attacks.contains(&row.attack) {
            attacks.push(row.attack);
        }
    }
    // The strongest come last in the order of attacks, and the strongest is red.
    attacks.iter().rev().position(|a| *a == attack).unwrap_or(0)
}

/// Schemes in the order of the document.
pub(super) fn schemes(part: &Part) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for row in &part.document.attacks.attacks {
        if !names.contains(&row.scheme.as_str()) {
            names.push(&row.scheme);
        }
    }
    names
}
