//! The large numbers of a report.

use veiloc_geometry::statistics::median;
use veiloc_pose::State;

use super::data::{LocalizationReport, Method};
use crate::numbers::{degrees, kilobytes, percent, scheme_name};
use crate::page::Card;
use crate::scene::QueryOutcome;

impl LocalizationReport {
    /// Fills the large numbers with those of dcl, or of the first scheme.
    pub fn add_cards(&mut self) {
        let is_dcl = |method: &Method| method.scheme.starts_with("dcl");
        let Some(main) = self.methods.iter().find(|m| is_dcl(m)).or(self.methods.first()) else { return };
        let is_main = |method: &Method| method.scheme == main.scheme && method.variant == main.variant;
        let own: Vec<&QueryOutcome> =
            self.outcomes.iter().filter(|o| self.methods.get(o.method).is_some_and(is_main)).collect();
        if own.is_empty() {
            return;
        }
        let card = |value: String, label: &str, note: String| Card { value, label: label.to_owned(), note };
        let median_of = |of: &dyn Fn(&QueryOutcome) -> Option<f64>| {
            let values: Vec<f64> = own.iter().filter_map(|outcome| of(outcome)).collect();
            Some(median(&values)).filter(|_| !values.is_empty())
        };
        let localized = own.iter().filter(|outcome| outcome.estimate.is_some()).count();
        let note = format!("Under {}.", scheme_name(&main.scheme).to_lowercase());
        let mut cards = vec![card(format!("{localized} of {}", own.len()), "queries localized", note)];
        let or_lost = |error: Option<f64>| Some(error.unwrap_or(f64::INFINITY));
        if let Some(error) = median_of(&|o| o.truth.and_then(|_| or_lost(o.position_error))) {
            let rotation = median_of(&|o| o.truth.and_then(|_| or_lost(o.rotation_error_deg)));
            let rotation = rotation.filter(|r| r.is_finite());
            let rotation = rotation.map_or_else(String::new, |r| format!(", {}", degrees(r)));
            cards.push(card(
                if error.is_finite() { self.unit.length(error) } else { "none".to_owned() },
                &format!("{}{rotation}", self.unit.head("median error of the position")),
                "A query without a pose counts as an infinite error.".to_owned(),
            ));
        }
        let trusted = own.iter().filter(|outcome| outcome.state == Some(State::Trusted)).count();
        if trusted > 0 {
            let sd = median_of(&|o| o.position_sd.filter(|_| o.state == Some(State::Trusted)));
            let note = sd.map_or_else(String::new, |sd| {
                format!("The median ± of their positions is {}.", self.unit.with_unit(sd))
            });
            cards.push(card(
                percent(trusted as f64 / own.len() as f64),
                "of queries have a trusted pose",
                note,
            ));
        }
        if let Some(bytes) = median_of(&|o| o.bytes.map(|bytes| bytes as f64)) {
            let note = "Lines and descriptors; no image and no keypoint.".to_owned();
            cards.push(card(kilobytes(bytes), "sent per query", note));
        }
        self.cards.extend(cards);
    }
}
