//! What is said in words beside tables and figures.

use veiloc_evaluation::audit::{Part, Sentence, conclusion, findings};

use crate::format::escape;

/// The conclusion as a list, or the findings alone.
pub(super) fn said(part: &Part, with_limits: bool) -> String {
    let sentences = if with_limits { conclusion(&part.document) } else { findings(&part.document) };
    let items: Vec<String> = sentences.iter().map(html).collect();
    format!("<ul class=\"said\">{}</ul>", items.concat())
}

fn html(sentence: &Sentence) -> String {
    format!("<li><b>{}.</b> {}</li>", escape(&sentence.subject), escape(&sentence.text))
}

/// What stands below a table.
pub(super) fn note() -> &'static str {
    "<p class=\"note\">The guess uses nothing but the single line; an attack counts only by what it gains over that. One bit \
     beyond the guess halves the attacker's error, on average over keypoints; a negative number means that the attack did \
     worse than guessing. Bent: by how much of its length the offset from a keypoint to a neighbour is off, in the median; where \
     that is small and the error large, the layout is right but shifted or bent. Red: at least half of the keypoints.</p>"
}
