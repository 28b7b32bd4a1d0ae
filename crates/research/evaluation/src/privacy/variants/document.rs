//! What was found, as the stable JSON document.

use std::collections::BTreeMap;

use serde::Serialize;
use veiloc_attacks::ErrorSummary;

use super::data::Query;
use super::privacy::Judgement;
use super::variant::Variant;
use crate::results::metrics::finite;
use crate::results::metrics::median;
use crate::results::{QueryResult, SchemeSummary};

/// The document that `veiloc eval tradeoff --json` prints.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TradeoffDocument {
    /// Version of this document; a field is never removed or given another meaning under the same number.
    pub version: u32,
    /// `eval tradeoff`.
    pub command: &'static str,
    /// Names of the files of keypoints and of problems.
    pub data: Vec<String>,
    /// Images that poses were estimated for.
    pub queries: usize,
    /// How many of them were attacked.
    pub attacked: usize,
    /// Images of the map, queries among them, of which each query has all but itself for the transfer.
    pub map_images: usize,
    /// Images that taught the predictor of neighbours.
    pub train_images: usize,
    /// Neighbours a keypoint.
    pub k: usize,
    /// Whether the estimator's noise was raised by what the variant adds on average.
    pub tell_noise: bool,
    /// Thresholds of the recall, `translation/degrees`, in the order asked for; the plot shows the first.
    pub thresholds: Vec<String>,
    /// First seed.
    pub seed: u64,
    /// Seeds that poses were estimated with.
    pub seeds: u64,
    /// One entry a variant.
    pub variants: Vec<VariantFigures>,
}

/// One variant.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct VariantFigures {
    /// The variant as text.
    pub variant: String,
    /// Keypoints sent of an image, mean over the attacked.
    pub sent: f64,
    /// Decoys beside them.
    pub decoys: f64,
    /// What attacks got, the guess first.
    pub attacks: Vec<AttackFigures>,
    /// Share of predicted neighbours that are true; null without a predictor.
    pub precision: Option<f64>,
    /// The same when they are drawn at random.
    pub chance: f64,
    /// Poses.
    pub localization: LocalizationFigures,
}

/// One attack on all attacked images.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AttackFigures {
    /// `guess`, `graph`, `graph-P` with `P` percent false neighbours, `transfer`.
    pub attack: String,
    /// Mean error of a keypoint that was sent, pixels; null when none was.
    pub mean_px: Option<f64>,
    /// Median error, pixels.
    pub median_px: Option<f64>,
    /// Median error as a share of the image's diagonal.
    pub median_share: Option<f64>,
    /// Share of the sent keypoints with an error under 10 px, 0 to 1.
    pub under_10px: Option<f64>,
    /// The same under 30 px.
    pub under_30px: Option<f64>,
    /// Keypoints of an image with an error under 10 px, mean: what is not sent is not found.
    pub found_10px: f64,
    /// The same under 30 px.
    pub found_30px: f64,
    /// Median error after each anchor's answers were scaled about it as fits the truth best, pixels.
    pub shape_median_px: Option<f64>,
}

/// Poses of one variant; a query that was not localized counts as infinitely wrong.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LocalizationFigures {
    /// How many queries; each counts once a seed.
    pub queries: usize,
    /// How many got a pose.
    pub localized: usize,
    /// How many got a pose that the estimator trusts.
    pub trusted: usize,
    /// How many of the trusted are outside every threshold.
    pub trusted_wrong: usize,
    /// Matches of a query, median.
    pub matches: f64,
    /// Threshold (`translation/degrees`) to share of queries within it, 0 to 1.
    pub recall: BTreeMap<String, f64>,
    /// Median, degrees; null when more than half were not localized.
    pub median_rotation_deg: Option<f64>,
    /// Median, map units.
    pub median_translation: Option<f64>,
}

impl VariantFigures {
    /// Sums up the attacked images and all queries. `judged[i]`: keypoints, decoys and attacks of `queries[attacked[i]]`.
    pub(super) fn of(
        variant: &Variant,
        queries: &[Query],
        attacked: &[usize],
        judged: &[(usize, usize, Judgement)],
        summary: &SchemeSummary,
        located: &[&QueryResult],
    ) -> Self {
        let images = judged.len().max(1) as f64;
        let mean =
            |of: &dyn Fn(&(usize, usize, Judgement)) -> f64| judged.iter().map(of).sum::<f64>() / images;
        let names = judged.first().map_or(0, |j| j.2.attacks.len());
        let attacks = (0..names)
            .map(|a| {
                let (mut errors, mut shares, mut shape) = (Vec::new(), Vec::new(), Vec::new());
                for (q, (_, _, judgement)) in attacked.iter().zip(judged) {
                    let image = &queries[*q].image;
                    let diagonal = f64::from(image.width).hypot(f64::from(image.height));
                    let attack = &judgement.attacks[a];
                    errors.extend_from_slice(&attack.errors);
                    shares.extend(attack.errors.iter().map(|e| e / diagonal));
                    shape.extend_from_slice(&attack.shape);
                }
                let name = judged.first().map_or_else(String::new, |j| j.2.attacks[a].attack.clone());
                AttackFigures::of(name, &errors, &shares, &shape, images)
            })
            .collect();
        let (right, entries) =
            judged.iter().filter_map(|j| j.2.predicted).fold((0.0, 0.0), |sum, p| (sum.0 + p.0, sum.1 + p.1));
        let matches: Vec<f64> = located.iter().map(|r| r.correspondences as f64).collect();
        Self {
            variant: variant.to_string(),
            sent: mean(&|j| j.0 as f64),
            decoys: mean(&|j| j.1 as f64),
            attacks,
            precision: finite(right / entries),
            chance: mean(&|j| j.2.by_lot),
            localization: LocalizationFigures {
                queries: summary.queries,
                localized: summary.localized,
                trusted: summary.trusted.unwrap_or(0),
                trusted_wrong: summary.trusted_wrong.unwrap_or(0),
                matches: median(&matches),
                recall: summary.recall.clone(),
                median_rotation_deg: summary.median_rotation_deg,
                median_translation: summary.median_translation,
            },
        }
    }

    /// What this attack got, if it ran.
    pub fn attack(&self, name: &str) -> Option<&AttackFigures> {
        self.attacks.iter().find(|a| a.attack == name)
    }
}

impl AttackFigures {
    fn of(attack: String, errors: &[f64], shares: &[f64], shape: &[f64], images: f64) -> Self {
        let all = ErrorSummary::of(errors);
        let count = errors.len() as f64;
        let found = |share: f64| if errors.is_empty() { 0.0 } else { share * count / images };
        Self {
            attack,
            mean_px: finite(all.mean_px),
            median_px: finite(all.median_px),
            median_share: finite(median(shares)),
            under_10px: finite(all.under_10px),
            under_30px: finite(all.under_30px),
            found_10px: found(all.under_10px),
            found_30px: found(all.under_30px),
            shape_median_px: finite(median(shape)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::AttackFigures;

    #[test]
    fn figures_count_keypoints_of_a_image() {
        let errors = [4.0, 8.0, 20.0, 100.0];
        let figures =
            AttackFigures::of("graph".to_owned(), &errors, &[0.1, 0.2, 0.3, 0.4], &[1.0, 2.0, 3.0], 2.0);
        assert_eq!((figures.median_px, figures.mean_px), (Some(14.0), Some(33.0)));
        assert_eq!((figures.under_10px, figures.under_30px), (Some(0.5), Some(0.75)));
        assert_eq!((figures.found_10px, figures.found_30px), (1.0, 1.5));
        assert_eq!((figures.median_share, figures.shape_median_px), (Some(0.25), Some(2.0)));
        let nothing = AttackFigures::of("graph".to_owned(), &[], &[], &[], 2.0);
        assert_eq!((nothing.median_px, nothing.found_10px), (None, 0.0));
    }
}
