//! Privacy of a layout: the prior-only baseline, neighbours in another pencil, and the gain of each adversary.

use std::collections::BTreeMap;

use serde::Serialize;
use veiloc_attacks::NeighbourLists;
use veiloc_datasets::problem_files::KeypointImage;
use veiloc_features::Progress;
use veiloc_geometry::Pencils;
use veiloc_protocol::{DclLayout, Scheme};

use super::options::LayoutsEvaluation;
use crate::EvalError;
use crate::privacy::adversaries::{Adversary, AttackedKeypoints, Attackers, Gain};

/// One adversary on all attacked queries, with its best attack.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AdversaryFigures {
    /// The adversary.
    pub adversary: &'static str,
    /// Whether such an attacker can exist.
    pub realistic: bool,
    /// Its best attack.
    pub attack: String,
    /// Frames or seals that it used; absent for attacks on one query.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<usize>,
    /// Gain over the prior-only baseline, bits per keypoint.
    pub bits: f64,
    /// Its mean error, pixels.
    pub mean_px: f64,
    /// Its median error, pixels.
    pub median_px: f64,
}

impl AdversaryFigures {
    fn of(adversary: Adversary, gain: &Gain) -> Self {
        Self {
            adversary: adversary.name(),
            realistic: adversary.is_realistic(),
            attack: gain.best.attack.to_string(),
            frames: gain.best.frames,
            bits: gain.best.bits_over_prior,
            mean_px: gain.best.mean_px,
            median_px: gain.best.median_px,
        }
    }
}

/// Results of all layouts.
pub(super) struct Privacy {
    /// By scheme.
    prior_error: BTreeMap<String, f64>,
    /// By scheme.
    others: BTreeMap<String, f64>,
    /// By scheme, in the order of [`Adversary::ALL`].
    adversaries: BTreeMap<String, Vec<AdversaryFigures>>,
}

impl Privacy {
    pub(super) fn of(
        evaluation: &LayoutsEvaluation,
        keypoints: &AttackedKeypoints,
        progress: &dyn Progress,
    ) -> Result<Self, EvalError> {
        let schemes: Vec<Scheme> = evaluation.layouts.iter().copied().map(Scheme::Dcl).collect();
        // Without training data the predictor is trained on the map: stronger than any outsider, and equal for all
        // layouts.
        let train = match &keypoints.scene {
            Some(scene) if evaluation.train.is_empty() => vec![scene.map_file.clone()],
            _ => evaluation.train.clone(),
        };
        let attackers = Attackers {
            keypoints,
            schemes: &schemes,
            train: &train,
            network: evaluation.network.as_deref(),
            positions: &evaluation.positions,
            slow_attacks: false,
            k: evaluation.k,
            seed: evaluation.stress.seed,
        };
        let all: Vec<&KeypointImage> = keypoints.all().collect();
        let mut found = Self {
            prior_error: attackers.prior_errors(progress)?,
            others: evaluation.layouts.iter().map(|l| of_layout(*l, &all, evaluation.k)).collect(),
            adversaries: BTreeMap::new(),
        };
        for adversary in Adversary::ALL {
            for (scheme, gain) in attackers.gains(adversary, progress)? {
                found.adversaries.entry(scheme).or_default().push(AdversaryFigures::of(adversary, &gain));
            }
        }
        progress.finish();
        Ok(found)
    }

    /// Mean error of the prior-only baseline, pixels; NaN for a layout that was not evaluated.
    pub(super) fn prior_error(&self, scheme: &str) -> f64 {
        self.prior_error.get(scheme).copied().unwrap_or(f64::NAN)
    }

    /// Share of the nearest neighbours in another pencil; NaN as for [`Self::prior_error`].
    pub(super) fn other_pencil(&self, scheme: &str) -> f64 {
        self.others.get(scheme).copied().unwrap_or(f64::NAN)
    }

    /// Gains of the adversaries.
    pub(super) fn adversaries(&self, scheme: &str) -> &[AdversaryFigures] {
        self.adversaries.get(scheme).map_or(&[], Vec::as_slice)
    }
}

/// The scheme, and the share of the keypoints' `k` true nearest neighbours that are in another pencil.
fn of_layout(layout: DclLayout, images: &[&KeypointImage], k: usize) -> (String, f64) {
    let (mut other, mut all) = (0_usize, 0_usize);
    for image in images {
        let pencils = Pencils::of_image([image.width, image.height], &layout.layout());
        let anchors: Vec<_> = image.keypoints.iter().map(|p| pencils.anchor_of(*p)).collect();
        let nearest = NeighbourLists::nearest(&image.keypoints, k);
        for (i, own) in anchors.iter().enumerate() {
            let neighbours = nearest.of(i);
            all += neighbours.len();
            other += neighbours.iter().filter(|n| anchors[**n as usize] != *own).count();
        }
    }
    (Scheme::Dcl(layout).to_string(), other as f64 / all as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use veiloc_datasets::problem_files::synthetic_image;

    /// Uniform keypoints with a few neighbours: the share across a border is proportional to the border's length.
    #[test]
    fn neighbours_are_counted_across_borders() {
        let image = synthetic_image(3000, 1);
        let share = |text: &str| {
            let Ok(Scheme::Dcl(layout)) = text.parse() else { panic!("{text}") };
            let (name, share) = of_layout(layout, &[&image], 4);
            assert_eq!(name, Scheme::Dcl(layout).to_string());
            share
        };
        let halves = share("dcl:paper");
        // One border of 480 px; neighbours are about 10 px away, half of that across the border on average, over 640
        // px.
        assert!((0.003..0.02).contains(&halves), "{halves}");
        let stripes = share("dcl:axis=90:sectors=40:anchors=0/-0.5+0/0.5");
        assert!((3.0..12.0).contains(&(stripes / halves)), "{stripes} {halves}");
    }
}
