//! What attacks and neighbours are called in sentences.

use veiloc_protocol::Scheme;

use super::verdict::base_share;
use crate::audit::{Attack, AttackDocument, Neighbours};

/// What an attacker must hold beside the sealed query.
pub fn needs(attack: Attack, document: &AttackDocument) -> String {
    let told = match (document.neighbours, base_share(document)) {
        (Neighbours::Oracle, replaced) if replaced > 0.0 && replaced.is_finite() => format!(
            "somebody who names {} near keypoints of each, {replaced:.0} % of them at random",
            document.k
        ),
        (Neighbours::Oracle, _) => {
            format!("somebody who names the true {} nearest keypoints of each", document.k)
        }
        (Neighbours::Predicted, _) => "neighbours predicted from descriptors".to_owned(),
        (Neighbours::Network, _) => "neighbours predicted from descriptors by a network".to_owned(),
        (Neighbours::Transferred, _) => "map images that tell who is near whom".to_owned(),
    };
    match (attack.holds, attack.needs.neighbours) {
        ("", false) => "nothing else".to_owned(),
        ("", true) => told,
        (holds, false) => holds.to_owned(),
        (holds, true) => format!("{holds}, and {told}"),
    }
}

/// A scheme's name for people, with its layout. What reads as no scheme stands for itself.
pub fn scheme_words(scheme: &str) -> String {
    let setting = scheme.split_once(':').map(|(_, setting)| setting);
    match (scheme.parse::<Scheme>(), setting) {
        (Ok(known), None) => known.words().to_owned(),
        (Ok(known), Some(setting)) => format!("{} ({setting})", known.words()),
        (Err(_), _) => scheme.to_owned(),
    }
}

/// Pixels with one decimal, the same in table, sentence and caption.
pub fn px(value: f64) -> String {
    if value.is_finite() { format!("{value:.1} px") } else { "–".to_owned() }
}

/// A share of 1 in percent with one decimal.
pub fn percent(share: f64) -> String {
    if share.is_finite() { format!("{:.1} %", 100.0 * share) } else { "–".to_owned() }
}

/// Counted things, `1 image`, `2 images`.
pub fn count(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// The text with a capital in front.
pub fn capital(text: &str) -> String {
    let mut chars = text.chars();
    chars.next().map_or_else(String::new, |c| c.to_uppercase().collect::<String>() + chars.as_str())
}

/// `a`, `a and b`, `a, b and c`.
pub(super) fn listed(words: &[&str]) -> String {
    match words {
        [] => String::new(),
        [one] => (*one).to_owned(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

/// A sentence of the conclusion: of what it speaks, and what it says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sentence {
    /// Of what it speaks.
    pub subject: String,
    /// What it says, beginning with a capital.
    pub text: String,
}

impl Sentence {
    /// The text begins with a capital.
    pub fn new(subject: impl Into<String>, text: impl Into<String>) -> Self {
        Self { subject: subject.into(), text: capital(&text.into()) }
    }

    /// For a terminal or a document.
    pub fn plain(&self) -> String {
        format!("{}: {}", self.subject, self.text)
    }
}
