//! What a layout leaves to attackers: the guess, neighbours in another pencil, and what each adversary gains.

use std::collections::BTreeMap;

use veiloc_attacks::NeighbourLists;
use veiloc_audit::{
    Attack, AttackDocument, AttackEvaluation, AttackObserver, AuditError, ImageGroup, Measured,
    NeighbourSource, ServerKnowledge, Stage, attack_groups,
};
use veiloc_datasets::KeypointImage;
use veiloc_features::Progress;
use veiloc_geometry::Pencils;
use veiloc_query::{DclLayout, Scheme};

use super::adversary::{Adversary, AdversaryFigures};
use super::options::LayoutsEvaluation;
use super::place::Keypoints;
use crate::error::TradeoffError;

/// Frames that an adversary of several puts together, and seals of one image: as many as there are at most.
const FRAMES: [usize; 2] = [2, 8];
const SEALS: usize = 8;

/// What was found of all layouts.
pub(super) struct Privacy {
    /// By scheme.
    guess: BTreeMap<String, f64>,
    /// By scheme.
    others: BTreeMap<String, f64>,
    /// By scheme, in the order of [`Adversary::ALL`].
    adversaries: BTreeMap<String, Vec<AdversaryFigures>>,
}

impl Privacy {
    pub(super) fn of(
        evaluation: &LayoutsEvaluation,
        keypoints: &Keypoints,
        progress: &dyn Progress,
    ) -> Result<Self, TradeoffError> {
        let queries: Vec<KeypointImage> = keypoints.queries().cloned().collect();
        let base = AttackEvaluation {
            schemes: evaluation.layouts.iter().copied().map(Scheme::Dcl).collect(),
            k: evaluation.k,
            seed: evaluation.stress.seed,
            attacks: Vec::new(),
            ..AttackEvaluation::default()
        };
        let mut found = Self {
            guess: BTreeMap::new(),
            others: evaluation.layouts.iter().map(|l| of_layout(*l, &queries, evaluation.k)).collect(),
            adversaries: BTreeMap::new(),
        };
        let guessed = run(&base, queries.clone(), "Guessing", progress)?;
        found.guess.extend(guessed.attacks.into_iter().map(|a| (a.scheme, a.mean_px)));
        for adversary in Adversary::ALL {
            found.add(adversary, evaluation, keypoints, &base, progress)?;
        }
        progress.finish();
        Ok(found)
    }

    /// Runs what an adversary tries on all layouts; one who lacks what it takes is left out.
    fn add(
        &mut self,
        adversary: Adversary,
        evaluation: &LayoutsEvaluation,
        keypoints: &Keypoints,
        base: &AttackEvaluation,
        progress: &dyn Progress,
    ) -> Result<(), TradeoffError> {
        let predicted = || NeighbourSource::Predicted { train: keypoints.train.clone() };
        // What the map shows is known under every layout: what counts is the rest.
        let knowing = || ServerKnowledge {
            problems: vec![keypoints.problems.clone()],
            private: None,
            measured: Measured::Hidden,
        };
        let mut attack = AttackEvaluation {
            attacks: adversary.attacks().iter().filter_map(|name| name.parse::<Attack>().ok()).collect(),
            images: Some(keypoints.attacked.len()),
            ..base.clone()
        };
        let mut images = keypoints.attacked.clone();
        match adversary {
            Adversary::LearnedNeighbours => attack.neighbours = predicted(),
            Adversary::Network => match &evaluation.network {
                Some(model) => attack.neighbours = NeighbourSource::Network { model: model.clone() },
                None => return Ok(()),
            },
            Adversary::NearbyImages | Adversary::TrueNeighbours => {}
            Adversary::KnownPose => {
                attack.neighbours = predicted();
                attack.server = Some(knowing());
            }
            Adversary::KnownPoseAndImages => attack.server = Some(knowing()),
            Adversary::SeveralFrames => {
                attack.server = Some(knowing());
                images.extend(keypoints.others.iter().cloned());
                attack.frames = FRAMES.into_iter().filter(|n| *n <= images.len()).collect();
                if attack.frames.is_empty() {
                    return Ok(());
                }
            }
            Adversary::SeveralSeals => attack.frames = vec![SEALS],
        }
        let needs_map = attack.attacks.iter().any(|a| a.needs.map_images || a.needs.other_images);
        if needs_map && adversary != Adversary::SeveralFrames {
            images.extend(keypoints.map.iter().cloned());
        }
        // A server that finds no pose under a layout knows nothing there; the others are attacked without it.
        let found = loop {
            match run(&attack, images.clone(), adversary.name(), progress) {
                Err(AuditError::NoPose { scheme, .. }) => {
                    attack.schemes.retain(|s| s.to_string() != scheme);
                    if attack.schemes.is_empty() {
                        return Ok(());
                    }
                }
                found => break found?,
            }
        };
        for scheme in &attack.schemes {
            let name = scheme.to_string();
            let best = (found.attacks.iter())
                .filter(|a| a.scheme == name && a.attack != Attack::PRIOR)
                .max_by(|a, b| a.bits_over_prior.total_cmp(&b.bits_over_prior));
            let Some(best) = best else { continue };
            let figures = AdversaryFigures {
                adversary: adversary.name(),
                realistic: adversary.is_realistic(),
                attack: best.attack.to_string(),
                frames: best.frames,
                bits: best.bits_over_prior,
                mean_px: best.mean_px,
                median_px: best.median_px,
            };
            self.adversaries.entry(name).or_default().push(figures);
        }
        Ok(())
    }

    /// Mean error of the guess, pixels; NaN for a layout that was not judged.
    pub(super) fn guess(&self, scheme: &str) -> f64 {
        self.guess.get(scheme).copied().unwrap_or(f64::NAN)
    }

    /// Share of the nearest neighbours that are in another pencil; as [`Self::guess`].
    pub(super) fn other_pencil(&self, scheme: &str) -> f64 {
        self.others.get(scheme).copied().unwrap_or(f64::NAN)
    }

    /// What adversaries gained.
    pub(super) fn adversaries(&self, scheme: &str) -> &[AdversaryFigures] {
        self.adversaries.get(scheme).map_or(&[], Vec::as_slice)
    }
}

fn run(
    attack: &AttackEvaluation,
    images: Vec<KeypointImage>,
    stage: &str,
    progress: &dyn Progress,
) -> Result<AttackDocument, AuditError> {
    let group = ImageGroup { name: "queries".to_owned(), images };
    attack_groups(attack, vec![group], &mut Watched(Stage::new(progress, stage)))
}

/// Tells how far the work is.
struct Watched<'a>(Stage<'a>);

impl AttackObserver for Watched<'_> {
    fn advance(&mut self, _done: usize, total: usize) {
        self.0.advance(total);
    }
}

/// The scheme, and which share of the `k` true nearest neighbours of keypoints are in another pencil.
fn of_layout(layout: DclLayout, images: &[KeypointImage], k: usize) -> (String, f64) {
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
    use veiloc_datasets::synthetic_image;

    /// Evenly spread keypoints, a few neighbours: about so many are across a border as border there is.
    #[test]
    fn neighbours_are_counted_across_borders() {
        let images = [synthetic_image(3000, 1)];
        let share = |text: &str| {
            let Ok(Scheme::Dcl(layout)) = text.parse() else { panic!("{text}") };
            let (name, share) = of_layout(layout, &images, 4);
            assert_eq!(name, Scheme::Dcl(layout).to_string());
            share
        };
        let halves = share("dcl");
        // One border of 480 px; neighbours are some 10 px away, half of that across it on average, over 640 px.
        assert!((0.003..0.02).contains(&halves), "{halves}");
        let stripes = share("dcl:axis=90:sectors=40:anchors=0/-0.5+0/0.5");
        assert!((3.0..12.0).contains(&(stripes / halves)), "{stripes} {halves}");
    }
}
