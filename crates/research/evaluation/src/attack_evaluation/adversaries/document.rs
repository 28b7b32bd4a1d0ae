//! Gains of adversaries, as the stable JSON document.

use std::collections::BTreeMap;

use serde::Serialize;

use super::adversary::Adversary;
use super::attackers::{AttackGain, Gain};
use super::options::AdversariesEvaluation;

/// Also of `--attack-json` of `eval dataset`.
/// `veiloc eval adversaries --help` lists the adversaries; one without the required resources (a map, training data, a
/// trusted pose) has no row.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AdversariesDocument {
    /// Version of this document.
    pub version: u32,
    /// `eval adversaries`.
    pub command: &'static str,
    /// Neighbours per keypoint.
    pub k: usize,
    /// Seed of every draw.
    pub seed: u64,
    /// Requested adversaries whose resources are missing everywhere.
    pub missing: Vec<Adversary>,
    /// One entry per scene or file, adversary and scheme.
    pub rows: Vec<AdversaryRow>,
}

/// Gain of one adversary from the queries of one scheme.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AdversaryRow {
    /// The scene, or the file of keypoints.
    pub data: String,
    /// The adversary.
    pub adversary: &'static str,
    /// Whether such an attacker can exist; no attacker has true neighbours.
    pub realistic: bool,
    /// Obfuscation scheme.
    pub scheme: String,
    /// Its best attack, by gain over the prior-only baseline.
    pub attack: String,
    /// Frames or seals that it used; absent for attacks on one query.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<usize>,
    /// Number of attacked images.
    pub images: usize,
    /// Share of their keypoints on which errors are measured, 0 to 1: for a server that knows its map, the keypoints
    /// that the map does not show, or those of the private region.
    pub measured: f64,
    /// Precision of its predicted neighbours, 0 to 1; absent for an oracle, and if no neighbours are used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub precision: Option<f64>,
    /// Median error of the prior-only baseline on the same keypoints, pixels.
    pub prior_median_px: f64,
    /// Median error, pixels.
    pub median_px: f64,
    /// Share of keypoints with an error under 10 px, 0 to 1.
    pub under_10px: f64,
    /// The same under 30 px.
    pub under_30px: f64,
    /// Gain over the prior-only baseline, bits per keypoint; negative if the attack is worse.
    pub bits_over_prior: f64,
    /// How well the attack `hole` tells the private keypoints from others that the map does not explain, as the area under
    /// the ROC curve; absent for other adversaries.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hiding_auc: Option<f64>,
    /// All its attacks.
    pub attacks: Vec<AttackGain>,
}

impl AdversariesDocument {
    pub(super) fn new(evaluation: &AdversariesEvaluation) -> Self {
        Self {
            version: 1,
            command: "eval adversaries",
            k: evaluation.k,
            seed: evaluation.seed,
            missing: Vec::new(),
            rows: Vec::new(),
        }
    }

    /// Lists the adversaries without a row.
    pub(super) fn list_missing(&mut self, evaluation: &AdversariesEvaluation) {
        let there = |a: &Adversary| self.rows.iter().any(|row| row.adversary == a.name());
        self.missing = evaluation.adversaries.iter().copied().filter(|a| !there(a)).collect();
    }

    /// Adds the rows of an adversary, in the order of the schemes.
    pub(super) fn add(
        &mut self,
        data: &str,
        adversary: Adversary,
        mut gains: BTreeMap<String, Gain>,
        evaluation: &AdversariesEvaluation,
    ) {
        for scheme in &evaluation.schemes {
            let scheme = scheme.to_string();
            let Some(gain) = gains.remove(&scheme) else { continue };
            self.rows.push(AdversaryRow {
                data: data.to_owned(),
                adversary: adversary.name(),
                realistic: adversary.is_realistic(),
                scheme,
                attack: gain.best.attack.to_string(),
                frames: gain.best.frames,
                images: gain.best.images,
                measured: gain.measured,
                precision: gain.precision,
                prior_median_px: gain.prior.median_px,
                median_px: gain.best.median_px,
                under_10px: gain.best.under_10px,
                under_30px: gain.best.under_30px,
                bits_over_prior: gain.best.bits_over_prior,
                hiding_auc: gain.hiding_auc,
                attacks: gain.tried,
            });
        }
    }

    /// Gain of an adversary; `None` if its resources were missing.
    pub fn of(&self, data: &str, adversary: Adversary, scheme: &str) -> Option<&AdversaryRow> {
        self.rows
            .iter()
            .find(|row| row.data == data && row.adversary == adversary.name() && row.scheme == scheme)
    }
}
