//! Gains of adversaries, as the stable JSON document.

use serde::Serialize;

use super::adversary::Adversary;

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
    /// How well the attack `occlusion` tells the private keypoints from others that the map does not explain, as the area under
    /// the ROC curve; absent for other adversaries.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hiding_auc: Option<f64>,
    /// All its attacks.
    pub attacks: Vec<AttackGain>,
}

/// One attack of an adversary with its gain.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AttackGain {
    /// Name of the attack.
    pub attack: String,
    /// Frames or seals that it used; absent for attacks on one query.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<usize>,
    /// Median error, pixels.
    pub median_px: f64,
    /// Gain over the prior-only baseline, bits per keypoint.
    pub bits_over_prior: f64,
}
