//! Pages of documents: rows, outcomes, curves and large numbers of what an evaluation found.

use veiloc_evaluation::results::metrics::median;
use veiloc_evaluation::results::tables::TableData;
use veiloc_evaluation::results::{QueryResult, SchemeSummary};
use veiloc_geometry::CameraFromWorld;
use veiloc_pose::State;

use super::data::{PlaceView, QueryOutcome, RunFigure, RunReport, RunRow};
use crate::card::Card;
use crate::format::{length_or, percent};
use crate::plots::{self, ErrorAxis};

/// What tells rows apart.
type Key<'a> = (Option<&'a str>, &'a str, &'a str, Option<&'a str>);

impl RunReport {
    /// Adds a place with its part of a document: rows of the table and queries, each with its condition where the data has such.
    /// `truth` is the true pose of a query, where it is known.
    pub fn add_place<'a>(
        &mut self,
        view: PlaceView,
        rows: impl IntoIterator<Item = (Option<&'a str>, &'a SchemeSummary)>,
        queries: impl IntoIterator<Item = (Option<&'a str>, &'a QueryResult)>,
        truth: &dyn Fn(&str) -> Option<CameraFromWorld>,
    ) {
        let place = self.places.len();
        self.places.push(view);
        let rows: Vec<_> = rows.into_iter().collect();
        let several_scores = rows.iter().any(|(_, row)| row.score != rows[0].1.score);
        let mut keys: Vec<(Key<'a>, usize)> = Vec::new();
        for (condition, summary) in rows {
            let gravity = summary.variant.gravity.as_deref();
            let key: Key<'a> = (condition, &summary.scheme, &summary.score, gravity);
            keys.push((key, self.rows.len()));
            let mut beside: Vec<String> = Vec::new();
            if several_scores {
                beside.push(summary.score.clone());
            }
            beside.extend(gravity.map(|gravity| format!("gravity {gravity}")));
            self.rows.push(RunRow {
                place,
                condition: condition.map(str::to_owned),
                scheme: summary.scheme.clone(),
                beside: beside.join(", "),
                summary: Some(summary.clone()),
            });
        }
        for (condition, result) in queries {
            let gravity = result.variant.gravity.as_deref();
            let key = (condition, result.scheme.as_str(), result.score.as_str(), gravity);
            let Some((_, row)) = keys.iter().find(|(known, _)| *known == key) else { continue };
            self.outcomes.push(QueryOutcome::of(result, *row, truth(&result.name)));
        }
    }

    /// Draws curves of errors and bars of times over all queries; what there is nothing to draw of is left out.
    pub fn add_figures(&mut self, data: &TableData) {
        let drawn = [
            (
                plots::errors(data, ErrorAxis::Position),
                "The share of queries within an error of the position.",
            ),
            (
                plots::errors(data, ErrorAxis::Orientation),
                "The share of queries within an error of the orientation.",
            ),
            (plots::times(data), "Where the time of a query goes: the median of each stage."),
        ];
        let figures = drawn
            .into_iter()
            .filter_map(|(svg, caption)| Some(RunFigure { caption: caption.to_owned(), svg: svg.ok()? }));
        self.figures.extend(figures);
    }

    /// Fills the large numbers with those of the scheme the program is for, dcl, or of the first there is.
    pub fn add_cards(&mut self) {
        let is_dcl = |row: &RunRow| row.scheme.starts_with("dcl");
        let Some(main) = self.rows.iter().find(|row| is_dcl(row)).or(self.rows.first()) else { return };
        let (scheme, beside) = (main.scheme.clone(), main.beside.clone());
        let own: Vec<&QueryOutcome> = self
            .outcomes
            .iter()
            .filter(|o| self.rows.get(o.row).is_some_and(|r| r.scheme == scheme && r.beside == beside))
            .collect();
        if own.is_empty() {
            return;
        }
        let words = veiloc_evaluation::audit::scheme_words(&scheme);
        let mut cards = vec![Card {
            value: format!("{} of {}", own.iter().filter(|o| o.estimate.is_some()).count(), own.len()),
            label: "queries localized".to_owned(),
            note: format!("Under {}.", words.to_lowercase()),
        }];
        let judged: Vec<&&QueryOutcome> = own.iter().filter(|o| o.truth.is_some()).collect();
        if !judged.is_empty() {
            let errors = |of: fn(&QueryOutcome) -> Option<f64>| {
                median(&judged.iter().map(|o| of(o).unwrap_or(f64::INFINITY)).collect::<Vec<_>>())
            };
            let (position, rotation) = (errors(|o| o.position_error), errors(|o| o.rotation_error_deg));
            let rotation = if rotation.is_finite() { format!(", {rotation:.2}°") } else { String::new() };
            cards.push(Card {
                value: length_or(Some(position), "none"),
                label: format!("median error of the position{rotation}"),
                note: "Queries without a pose count as infinitely wrong.".to_owned(),
            });
        }
        let trusted: Vec<&&QueryOutcome> = own.iter().filter(|o| o.state == Some(State::Trusted)).collect();
        if !trusted.is_empty() {
            let sd = median(&trusted.iter().filter_map(|o| o.position_sd).collect::<Vec<_>>());
            cards.push(Card {
                value: percent(Some(trusted.len() as f64 / own.len() as f64)),
                label: "of poses trusted".to_owned(),
                note: if sd.is_finite() {
                    format!("Half of them claim ± {} or less.", length_or(Some(sd), "–"))
                } else {
                    "What the server says of its own answers.".to_owned()
                },
            });
        }
        let bytes: Vec<f64> = own.iter().filter_map(|o| o.bytes).map(|b| b as f64).collect();
        if !bytes.is_empty() {
            cards.push(Card {
                value: format!("{:.0} kB", median(&bytes) / 1e3),
                label: "sent for a query".to_owned(),
                note: "Lines and descriptors; no image and no keypoint.".to_owned(),
            });
        }
        self.cards.extend(cards);
    }
}

impl QueryOutcome {
    /// Of a document's query.
    pub fn of(result: &QueryResult, row: usize, truth: Option<CameraFromWorld>) -> Self {
        let sd = result.uncertainty;
        Self {
            row,
            name: result.name.clone(),
            truth,
            estimate: result.cam_from_world.as_ref().and_then(veiloc_evaluation::results::PoseDocument::pose),
            state: result.state,
            position_error: result.translation_error,
            rotation_error_deg: result.rotation_error_deg,
            position_sd: sd.and_then(|sd| sd.position_sd),
            rotation_sd_deg: sd.and_then(|sd| sd.rotation_sd_deg),
            inliers: result.inliers,
            matches: result.correspondences,
            bytes: result.sent.map(|sent| sent.sent_bytes).or(result.sealed_bytes),
            ms: (!result.ms.is_empty()).then(|| result.ms.values().sum()),
            remark: result.failure.clone(),
        }
    }
}
