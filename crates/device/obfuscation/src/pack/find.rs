//! Retrieval and matching on the device, and which rows the place explains.

use veiloc_descriptor::{
    Descriptors, MatchEvidence, MatchOptions, RETRIEVED_IMAGES, images_of_other_places, match_images,
    match_probability,
};
use veiloc_protocol::{Candidate, MatchWeight};

use super::KnownPlace;
use crate::SealError;

/// Up to this ratio of its distance to the place over that to the background, the place explains a row.
const EXPLAINED: f32 = 0.8;
/// Up to this ratio it explains a row that matches a point of the view with at least [`PROBABLE`].
const EXPLAINED_IN_VIEW: f32 = 0.9;
/// Probability of a match before geometry.
const PROBABLE: f64 = 0.2;
/// Fewer rows that probably match are chance: the image does not show the place, and a server would not find it.
pub(super) const MIN_MATCHES: usize = 12;
/// Probability from which a match counts as one of them.
const LIKELY: f64 = 0.5;

/// What the place says about the rows of an image.
pub(super) struct FoundRows {
    /// `[N]`
    pub(super) rows: Vec<ExplainedRow>,
    /// Images of the pack that show the same view, best first.
    pub(super) images: Vec<usize>,
}

/// What a place says about a row.
#[derive(Debug, Clone, PartialEq)]
pub struct ExplainedRow {
    /// Its distance to the nearest descriptor of the place over that to the nearest one of the background.
    pub ratio: f32,
    /// The point of the view that it matches best.
    pub candidate: Option<Candidate>,
}

impl ExplainedRow {
    /// Whether the row may be sent.
    pub fn is_explained(&self) -> bool {
        let is_probable = || self.candidate.is_some_and(|best| best.weight.probability() >= PROBABLE);
        self.ratio <= EXPLAINED || self.ratio <= EXPLAINED_IN_VIEW && is_probable()
    }

    /// Whether an image with these rows shows the place; of another one nothing is sealed.
    pub fn show_place(rows: &[Self]) -> bool {
        Self::likely(rows) >= MIN_MATCHES
    }

    /// How many rows probably match.
    fn likely(rows: &[Self]) -> usize {
        let is_likely = |row: &&Self| row.candidate.is_some_and(|best| best.weight.probability() >= LIKELY);
        rows.iter().filter(|row| row.is_explained()).filter(is_likely).count()
    }
}

impl KnownPlace {
    /// What the place says about each row of an image, and which of its images show the view.
    ///
    /// # Errors
    /// [`SealError::PackKind`] for another kind; [`SealError::NotThisPlace`] when hardly any row probably matches.
    pub(super) fn find(&self, descriptors: &Descriptors) -> Result<FoundRows, SealError> {
        let found = self.found(descriptors)?;
        if !ExplainedRow::show_place(&found.rows) {
            let matching = ExplainedRow::likely(&found.rows);
            return Err(SealError::NotThisPlace { matching, extracted: descriptors.len() });
        }
        Ok(found)
    }

    pub(super) fn found(&self, descriptors: &Descriptors) -> Result<FoundRows, SealError> {
        let explanations = self.explain(descriptors)?;
        let near = explanations.iter().filter(|row| row.ratio <= EXPLAINED_IN_VIEW);
        let images = self.images_of_view(near.map(|row| (row.nearest, 1.0 - row.ratio)));
        let of_row = |explanation: &super::background::Explanation| ExplainedRow {
            ratio: explanation.ratio,
            candidate: None,
        };
        let mut rows: Vec<ExplainedRow> = explanations.iter().map(of_row).collect();
        let prior = descriptors.kind().match_prior();
        let view = images.iter().map(|image| (*image, self.pack().image(*image)));
        for m in match_images(descriptors.view(), view, &MatchOptions::default()) {
            let evidence = MatchEvidence {
                ratio: m.ratio.into(),
                votes: Some(m.votes),
                track_length: Some(self.images_of(m.point).len() as u32),
            };
            let weight = MatchWeight::of_probability(match_probability(&prior, &evidence));
            let best = &mut rows[m.query].candidate;
            if best.is_none_or(|known| weight > known.weight) {
                *best = Some(Candidate { point: m.point, weight });
            }
        }
        Ok(FoundRows { rows, images })
    }

    /// The images that see most of the points of these rows of the pack, each with a weight; best first, then those of
    /// other places that look nearly as much like the view.
    fn images_of_view(&self, rows: impl Iterator<Item = (usize, f32)>) -> Vec<usize> {
        let mut support = vec![0.0_f32; self.pack().image_count()];
        for (row, weight) in rows {
            for image in self.images_of(self.pack().points()[row]) {
                support[*image as usize] += weight;
            }
        }
        let mut ranked: Vec<(usize, f32)> =
            support.into_iter().enumerate().filter(|(_, support)| *support > 0.0).collect();
        ranked.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        let points = |image: usize| self.pack().image(image).points().to_vec();
        let others = images_of_other_places(&ranked, RETRIEVED_IMAGES, points);
        ranked.into_iter().take(RETRIEVED_IMAGES).map(|(image, _)| image).chain(others).collect()
    }
}
