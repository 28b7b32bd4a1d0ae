//! Rows of the table: what runs, and its accumulated results.

use std::time::Duration;

use veiloc_attacks::{ErrorSummary, bits_over_prior, errors_px};
use veiloc_protocol::Scheme;

use super::attacks::{Attack, Knowledge};
use super::context::{AttackContext, RecoveredPositions};
use super::document::AttackSummary;
use super::neighbours::NeighbourSource;
use super::options::{AttackEvaluation, PrivateRegion};
use super::scene::Attacker;
use veiloc_geometry::statistics::median;

use crate::EvalError;
use crate::results::metrics::roc_auc;

/// Errors over all images, with the gain over the prior-only baseline.
#[derive(Debug, Clone, Default)]
pub(super) struct ErrorTally {
    /// Pixels.
    pub(super) errors: Vec<f64>,
    /// Bits times keypoints.
    bits: f64,
}

impl ErrorTally {
    /// Adds the errors of an image of this size, and those of its baseline.
    pub(super) fn add(&mut self, errors: &[f64], prior: &[f64], (width, height): (u32, u32)) {
        if !errors.is_empty() {
            self.bits += bits_over_prior(errors, prior, width, height) * errors.len() as f64;
            self.errors.extend(errors);
        }
    }

    /// Bits per keypoint, 0 without keypoints.
    pub(super) fn bits_over_prior(&self) -> f64 {
        self.bits / self.errors.len().max(1) as f64
    }
}

/// A row while the attacks run.
pub(super) struct Row {
    pub(super) scheme: Scheme,
    pub(super) attack: Attack,
    pub(super) corrupt: f64,
    pub(super) frames: Option<usize>,
    tally: ErrorTally,
    /// Errors of accepted answers, if the attack rates them.
    accepted: Option<Vec<f64>>,
    /// For each image, how well the attack tells the measured keypoints from others that the map does not explain, if it
    /// estimates what hides the map.
    hiding_auc: Vec<f64>,
    ms: Vec<f64>,
}

impl Row {
    fn new(scheme: Scheme, attack: Attack, corrupt: f64, frames: Option<usize>) -> Self {
        Self {
            scheme,
            attack,
            corrupt,
            frames,
            tally: ErrorTally::default(),
            accepted: None,
            hiding_auc: Vec::new(),
            ms: Vec::new(),
        }
    }

    /// Adds the answers on one image; returns the errors of all keypoints, measured or not.
    pub(super) fn add(
        &mut self,
        context: &AttackContext<'_>,
        found: &RecoveredPositions,
        duration: Duration,
    ) -> Result<Vec<f64>, EvalError> {
        let (truth, sent) = (&context.image().keypoints, &context.sent);
        if found.pixels.len() != truth.len() {
            return Err(EvalError::Options(format!(
                "the attack {} answered {} of {} keypoints",
                self.attack,
                found.pixels.len(),
                truth.len()
            )));
        }
        self.ms.push(duration.as_secs_f64() * 1e3);
        let all = errors_px(found.pixels.iter().copied(), truth);
        let errors = context.measured(&all);
        if let Some(accepted) = &found.accepted {
            let sure = (0..all.len()).filter(|i| sent.measured[*i] && accepted[*i]).map(|i| all[i]);
            self.accepted.get_or_insert_default().extend(sure);
        }
        if let Some(hiding) = &found.hiding {
            let unexplained = |i: &usize| sent.known[*i].is_none() && !sent.ignored[*i];
            let (own, others): (Vec<usize>, Vec<usize>) =
                (0..all.len()).filter(unexplained).partition(|i| sent.measured[*i]);
            let of = |rows: &[usize]| rows.iter().map(|i| hiding[*i]).collect::<Vec<f64>>();
            self.hiding_auc.extend(roc_auc(&of(&own), &of(&others)));
        }
        if self.attack == Attack::PRIOR {
            self.tally.errors.extend(errors);
        } else {
            self.tally.add(&errors, context.prior_errors(), (context.width(), context.height()));
        }
        Ok(all)
    }

    pub(super) fn summary(&self) -> AttackSummary {
        let errors = ErrorSummary::of(&self.tally.errors);
        let accepted = self.accepted.as_ref().map(|b| ErrorSummary::of(b));
        AttackSummary {
            scheme: self.scheme.to_string(),
            attack: self.attack,
            corrupt: self.corrupt,
            frames: self.frames,
            images: self.ms.len(),
            keypoints: errors.count,
            mean_px: errors.mean_px,
            median_px: errors.median_px,
            under_5px: errors.under_5px,
            under_10px: errors.under_10px,
            under_30px: errors.under_30px,
            bits_over_prior: self.tally.bits_over_prior(),
            accepted: accepted.map(|b| b.count as f64 / errors.count.max(1) as f64),
            accepted_median_px: accepted.filter(|b| b.count > 0).map(|b| b.median_px),
            accepted_under_10px: accepted.filter(|b| b.count > 0).map(|b| b.under_10px),
            hiding_auc: (!self.hiding_auc.is_empty()).then(|| median(&self.hiding_auc)),
            ms: median(&self.ms),
        }
    }
}

/// Refuses contradictory options.
pub(super) fn check(evaluation: &AttackEvaluation) -> Result<(), EvalError> {
    let refuse = |why: String| Err(EvalError::Options(why));
    if evaluation.k == 0 && evaluation.needs(Knowledge::Neighbours).is_some() {
        return refuse("attacks that use neighbours need at least one neighbour per keypoint".to_owned());
    }
    let several = evaluation.attacks.iter().any(Attack::combines_several);
    if let Some(n) = evaluation.frames.iter().find(|n| several && **n < 2) {
        return refuse(format!("an attack on several frames needs at least two, not {n}"));
    }
    if evaluation.positions.is_empty()
        && let Some(attack) = evaluation.needs(Knowledge::Network)
    {
        return refuse(format!("{attack} needs a position network, as research/train exports it"));
    }
    if matches!(evaluation.neighbours, NeighbourSource::Oracle | NeighbourSource::Transferred)
        && let Some(attack) = evaluation.needs(Knowledge::NearAngles)
    {
        return refuse(format!(
            "{attack} restricts neighbours that are predicted from descriptors: name the predictor"
        ));
    }
    let Some(server) = &evaluation.server else {
        return evaluation.needs(Knowledge::Pose).map_or(Ok(()), |attack| {
            refuse(format!(
                "{attack} is an attack of a server that has localized the query; give its matches"
            ))
        });
    };
    if let Some(private) = &server.private {
        if let PrivateRegion::Share(share) = private
            && !(*share > 0.0 && *share < 1.0)
        {
            return refuse(format!(
                "a private region cannot hold {share} of the keypoints; give a share between 0 and 1"
            ));
        }
        let by_map = evaluation.needs(Knowledge::MapImages).is_some();
        if by_map || evaluation.neighbours == NeighbourSource::Transferred {
            // The private region belongs to the scene itself and is visible in the other images, unlike a person.
            return refuse(
                "a private region is in no map image, so nothing can be transferred to it".to_owned(),
            );
        }
    }
    Ok(())
}

/// Rows of the table, each once, scheme by scheme, the baseline first.
pub(super) fn rows(attacker: &Attacker<'_>) -> Vec<Row> {
    let AttackEvaluation { attacks, corrupt, frames, .. } = attacker.evaluation;
    let mut rows: Vec<Row> = Vec::new();
    for &scheme in &attacker.schemes {
        let mut push = |attack: Attack, corrupt: f64, frames: Option<usize>| {
            let key = |row: &Row| (row.scheme, row.attack, row.corrupt, row.frames);
            if rows.iter().all(|row| key(row) != (scheme, attack, corrupt, frames)) {
                rows.push(Row::new(scheme, attack, corrupt, frames));
            }
        };
        push(Attack::PRIOR, 0.0, None);
        let applies = |attack: &&Attack| {
            (!attack.needs(Knowledge::Network) || attacker.networks.knows(scheme))
                && (!attack.needs(Knowledge::NearAngles) || matches!(scheme, Scheme::Dcl(_)))
        };
        for &attack in attacks.iter().filter(applies) {
            if attack.combines_several() {
                for count in frames {
                    push(attack, 0.0, Some(*count));
                }
            } else if attack.needs(Knowledge::Neighbours) {
                for share in corrupt {
                    push(attack, *share, None);
                }
            } else {
                push(attack, 0.0, None);
            }
        }
    }
    rows
}
