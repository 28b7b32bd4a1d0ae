//! What attacks and neighbours are called in sentences.

use super::verdict::base_share;
use crate::audit::AttackDocument;
use crate::report::format::escape;

/// An attack's name for people; one that is not known stands for itself.
pub(super) fn attack_words(attack: &str) -> String {
    match attack {
        "prior" => "guess from the single line".to_owned(),
        "learned-prior" => "guess with a learned density".to_owned(),
        "closed-form" => "the paper's attack (closed form)".to_owned(),
        "closed-form-in-image" => "closed form held in the image".to_owned(),
        "closed-form-informed" => "closed form that knows the scheme".to_owned(),
        "closed-form-consensus" => "closed form with consensus".to_owned(),
        "transfer" => "positions taken over from a map".to_owned(),
        "graph" => "layout of the neighbour graph".to_owned(),
        "transfer-graph" => "layout begun at positions of a map".to_owned(),
        "server-side" => "the paper's server-side attack".to_owned(),
        "server-side-points" => "server-side attack by points alone".to_owned(),
        "iterative" => "the paper's iterative server-side attack".to_owned(),
        "guided-transfer" => "positions taken over along the flow of inliers".to_owned(),
        "several-frames" => "triangulation of several frames".to_owned(),
        other => other.to_owned(),
    }
}

/// What an attacker must hold beside the sealed query; `None` where these words do not know.
pub(super) fn needs(attack: &str, document: &AttackDocument) -> Option<String> {
    let replaced = base_share(document);
    let told = match document.neighbours {
        "oracle" if replaced > 0.0 && replaced.is_finite() => {
            format!(
                "somebody who names {} near keypoints of each, {replaced:.0} % of them at random",
                document.k
            )
        }
        "oracle" => format!("somebody who names the true {} nearest keypoints of each", document.k),
        "predicted" => "neighbours predicted from descriptors".to_owned(),
        "transferred" => "map images that tell who is near whom".to_owned(),
        other => format!("neighbours from the source “{other}”"),
    };
    match attack {
        "prior" => Some("nothing else".to_owned()),
        "learned-prior" => Some("keypoints of other images".to_owned()),
        "transfer" => Some("other images of the place, with keypoints and descriptors".to_owned()),
        "transfer-graph" => Some(format!("other images of the place, and {told}")),
        "graph" => Some(told),
        "server-side" | "server-side-points" | "iterative" => {
            Some(format!("a server that has found the pose, and {told}"))
        }
        "guided-transfer" => {
            Some("a server that has found the pose, with the keypoints of its map images".to_owned())
        }
        "several-frames" => Some("several queries of one place whose poses a server has found".to_owned()),
        other if other.starts_with("closed-form") => Some(told),
        _ => None,
    }
}

/// A scheme's name for people.
pub(super) fn scheme_words(scheme: &str) -> String {
    let (name, setting) = scheme.split_once(':').map_or((scheme, None), |(n, s)| (n, Some(s)));
    let words = match name {
        "random-lines" => "Random lines",
        "coordinate-permutation" => "Coordinate permutation",
        "dcl" => "Dual convergent lines",
        other => other,
    };
    setting.map_or_else(|| words.to_owned(), |s| format!("{words} ({s})"))
}

/// Pixels with one decimal, the same in table, sentence and caption.
pub(super) fn px(value: f64) -> String {
    if value.is_finite() { format!("{value:.1} px") } else { "–".to_owned() }
}

/// A share of 1 in percent with one decimal.
pub(super) fn percent(share: f64) -> String {
    if share.is_finite() { format!("{:.1} %", 100.0 * share) } else { "–".to_owned() }
}

/// Counted things, `1 image`, `2 images`.
pub(super) fn count(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// The text with a capital in front.
pub(super) fn capital(text: &str) -> String {
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
pub(super) struct Sentence {
    pub(super) subject: String,
    pub(super) text: String,
}

impl Sentence {
    /// The text begins with a capital.
    pub(super) fn new(subject: impl Into<String>, text: impl Into<String>) -> Self {
        Self { subject: subject.into(), text: capital(&text.into()) }
    }

    /// For a terminal or a document.
    pub(super) fn plain(&self) -> String {
        format!("{}: {}", self.subject, self.text)
    }

    /// For the page.
    pub(super) fn html(&self) -> String {
        format!("<li><b>{}.</b> {}</li>", escape(&self.subject), escape(&self.text))
    }
}
