//! Rows of the table: what runs, and its accumulated results.

use veiloc_attacks::ErrorSummary;
use veiloc_protocol::Scheme;

use super::attacks::Attack;
use super::document::AttackSummary;
use super::neighbours::NeighbourSource;
use super::options::{AttackEvaluation, PrivateRegion};
use crate::EvalError;
use crate::attack_evaluation::position_networks::TrainedPositions;
use crate::results::metrics::median;

/// A row while the attacks run.
pub(super) struct Row {
    pub(super) scheme: Scheme,
    pub(super) attack: Attack,
    pub(super) corrupt: f64,
    pub(super) frames: Option<usize>,
    pub(super) errors: Vec<f64>,
    /// Errors of accepted answers, if the attack rates them.
    pub(super) accepted: Option<Vec<f64>>,
    /// For each image, how well the attack tells the measured keypoints from others that the map does not explain, if it
    /// estimates what hides the map.
    pub(super) hiding_auc: Vec<f64>,
    /// Bits times keypoints, summed over images.
    pub(super) bits: f64,
    pub(super) ms: Vec<f64>,
}

/// Refuses contradictory options.
pub(super) fn check(evaluation: &AttackEvaluation) -> Result<(), EvalError> {
    let refuse = |why: String| Err(EvalError::Options(why));
    if evaluation.k == 0 && evaluation.attacks.iter().any(|a| a.needs.neighbours) {
        return refuse("attacks that use neighbours need at least one neighbour per keypoint".to_owned());
    }
    let several = evaluation.attacks.iter().any(|a| a.needs.frames || a.needs.seals);
    if let Some(n) = evaluation.frames.iter().find(|n| several && **n < 2) {
        return refuse(format!("an attack on several frames needs at least two, not {n}"));
    }
    if evaluation.positions.is_empty()
        && let Some(attack) = evaluation.attacks.iter().find(|a| a.needs.trained)
    {
        return refuse(format!("{attack} needs a position network, as research/train exports it"));
    }
    if matches!(evaluation.neighbours, NeighbourSource::Oracle | NeighbourSource::Transferred)
        && let Some(attack) = evaluation.attacks.iter().find(|a| a.needs.near_angles)
    {
        return refuse(format!(
            "{attack} restricts neighbours that are predicted from descriptors: name the predictor"
        ));
    }
    let needs = evaluation.attacks.iter().find(|a| a.needs.pose);
    let Some(server) = &evaluation.server else {
        return needs.map_or(Ok(()), |attack| {
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
        let by_map = evaluation.attacks.iter().any(|a| a.needs.map_images);
        if by_map || evaluation.neighbours == NeighbourSource::Transferred {
            // The private region belongs to the scene itself and is visible in the other images, unlike a person.
            return refuse(
                "a private region is in no map image, so nothing can be transferred to it".to_owned(),
            );
        }
    }
    Ok(())
}

/// Rows of the table, scheme by scheme, the baseline first.
pub(super) fn rows(evaluation: &AttackEvaluation, trained: &TrainedPositions) -> Vec<Row> {
    let mut rows = Vec::new();
    for &scheme in evaluation.schemes.iter().filter(|s| s.hides_positions()) {
        let known = |attack: &&Attack| {
            let anchored = matches!(scheme, Scheme::Dcl(_));
            (!attack.needs.trained || trained.knows(scheme)) && (!attack.needs.near_angles || anchored)
        };
        let mut push = |attack, corrupt, frames| {
            rows.push(Row {
                scheme,
                attack,
                corrupt,
                frames,
                errors: Vec::new(),
                accepted: None,
                hiding_auc: Vec::new(),
                bits: 0.0,
                ms: Vec::new(),
            });
        };
        push(Attack::PRIOR, 0.0, None);
        for &attack in evaluation.attacks.iter().filter(|a| **a != Attack::PRIOR).filter(known) {
            if attack.needs.frames || attack.needs.seals {
                evaluation.frames.iter().for_each(|frames| push(attack, 0.0, Some(*frames)));
            } else if attack.needs.neighbours {
                evaluation.corrupt.iter().for_each(|corrupt| push(attack, *corrupt, None));
            } else {
                push(attack, 0.0, None);
            }
        }
    }
    rows
}

pub(super) fn summary(row: &Row, images: usize) -> AttackSummary {
    let errors = ErrorSummary::of(&row.errors);
    let accepted = row.accepted.as_ref().map(|b| ErrorSummary::of(b));
    AttackSummary {
        scheme: row.scheme.to_string(),
        attack: row.attack,
        corrupt: row.corrupt,
        frames: row.frames,
        images,
        mean_px: errors.mean_px,
        median_px: errors.median_px,
        under_5px: errors.under_5px,
        under_10px: errors.under_10px,
        under_30px: errors.under_30px,
        bits_over_prior: row.bits / row.errors.len().max(1) as f64,
        accepted: accepted.map(|b| b.count as f64 / errors.count.max(1) as f64),
        accepted_median_px: accepted.filter(|b| b.count > 0).map(|b| b.median_px),
        accepted_under_10px: accepted.filter(|b| b.count > 0).map(|b| b.under_10px),
        hiding_auc: (!row.hiding_auc.is_empty()).then(|| median(&row.hiding_auc)),
        ms: median(&row.ms),
    }
}
