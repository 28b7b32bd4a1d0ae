//! The JSON document of `veiloc eval sessions`.

use serde::Serialize;
use veiloc_attacks::ErrorSummary;
use veiloc_obfuscation::PackUse;

use super::super::rows::ErrorTally;
use super::attack::{AttackedKeypoints, Method};
use super::device::SealedSession;
use super::motion::Motion;
use super::{Condition, SessionsEvaluation};
use veiloc_geometry::statistics::median;

use crate::results::metrics::finite;
use crate::results::{MapSummary, SchemeSummary};

/// Poses of single frames, and leakage of several frames of a session.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SessionsDocument {
    /// Version of this document.
    pub version: u32,
    /// The command, `eval sessions`.
    pub command: &'static str,
    /// Facts about the map.
    pub map: MapSummary,
    /// Images of the query list, which form one trajectory.
    pub images: usize,
    /// What the device sends with the pack of the map, `matches` or `explained`; absent without a pack.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub send: Option<&'static str>,
    /// Share of an image's keypoints that the private region holds.
    pub private: f64,
    /// Width of the band along borders of sectors that is left out, degrees.
    pub band_deg: f64,
    /// Width of the cells of a session's angles, radians.
    pub step: f64,
    /// Whether sessions remember the anchor and angle of each sent keypoint.
    pub memory: bool,
    /// Seed of every random choice.
    pub seed: u64,
    /// Pose results of single frames: one entry for each scheme, anchors and orientation error.
    pub frames: Vec<FramesFigures>,
    /// Leakage of several frames: one entry per scheme, anchors, motion, orientation error, target, method and number of
    /// frames.
    pub rows: Vec<SessionRow>,
}

impl SessionsDocument {
    pub(super) fn new(evaluation: &SessionsEvaluation, map: MapSummary) -> Self {
        Self {
            version: 1,
            command: "eval sessions",
            map,
            images: evaluation.scene.query_list.len(),
            send: evaluation.pack.map(PackUse::name),
            private: evaluation.private,
            band_deg: evaluation.session.band_deg,
            step: evaluation.session.step,
            memory: evaluation.session.memory,
            seed: evaluation.scene.seed,
            frames: Vec::new(),
            rows: Vec::new(),
        }
    }
}

/// The single frames of a trajectory.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FramesFigures {
    /// Anchors and orientation errors.
    #[serde(flatten)]
    pub condition: Condition,
    /// Number of new layout positions.
    pub starts: u32,
    /// Median number of sent keypoints per frame, without decoys.
    pub keypoints: f64,
    /// Recall, medians and times.
    #[serde(flatten)]
    pub summary: SchemeSummary,
}

impl FramesFigures {
    pub(super) fn new(condition: Condition, session: &SealedSession, mut summary: SchemeSummary) -> Self {
        let sealed = || session.frames.iter().filter_map(|s| s.as_ref().ok());
        let keypoints: Vec<f64> = sealed().map(|s| s.truth.source.iter().flatten().count() as f64).collect();
        let mut bytes: Vec<usize> = sealed().map(|s| s.bytes.len()).collect();
        bytes.sort_unstable();
        summary.sealed_bytes = bytes.get(bytes.len() / 2).copied();
        Self { condition, starts: session.starts, keypoints: median(&keypoints), summary }
    }
}

/// Leakage of several frames of a session.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SessionRow {
    /// Obfuscation scheme.
    pub scheme: String,
    /// Anchors and orientation errors.
    #[serde(flatten)]
    pub condition: Condition,
    /// Motion of the camera.
    pub motion: Motion,
    /// Number of frames, including the attacked one.
    pub frames: usize,
    /// Attacked keypoints.
    pub target: AttackedKeypoints,
    /// Method of the attack.
    pub method: Method,
    /// Number of attacked images with a pose that the server trusts.
    pub images: usize,
    /// Number of attacked keypoints.
    pub keypoints: usize,
    /// Median error of the prior-only baseline, pixels; null without keypoints.
    pub prior_median_px: Option<f64>,
    /// Median error of the attack, pixels; null without keypoints.
    pub median_px: Option<f64>,
    /// Share of keypoints with an error under 10 px, 0 to 1; null without keypoints.
    pub under_10px: Option<f64>,
    /// Gain over the prior-only baseline, bits per keypoint: mean of `log2(e_prior / e_attack)`, errors clamped to 1
    /// px and the diagonal; null without keypoints.
    pub bits_over_prior: Option<f64>,
    #[serde(skip)]
    tally: ErrorTally,
    #[serde(skip)]
    prior: Vec<f64>,
}

impl SessionRow {
    /// Empty rows by target, method and number of frames.
    pub(super) fn of(counts: &[usize], condition: Condition, motion: Motion) -> Vec<Self> {
        let mut rows = Vec::new();
        for target in AttackedKeypoints::ALL {
            for &method in Method::of(motion) {
                rows.extend(counts.iter().map(|&frames| Self {
                    scheme: condition.scheme.to_string(),
                    condition,
                    motion,
                    frames,
                    target,
                    method,
                    images: 0,
                    keypoints: 0,
                    prior_median_px: None,
                    median_px: None,
                    under_10px: None,
                    bits_over_prior: None,
                    tally: ErrorTally::default(),
                    prior: Vec::new(),
                }));
            }
        }
        rows
    }

    /// Adds the errors of an image of this size; `prior`: those of the best answer for bits and for errors in pixels.
    pub(super) fn add(&mut self, errors: &[f64], prior: [&[f64]; 2], size: (u32, u32)) {
        if !errors.is_empty() {
            self.images += 1;
            self.tally.add(errors, prior[0], size);
            self.prior.extend(prior[1]);
        }
    }

    /// The row with its final figures.
    pub(super) fn finished(mut self) -> Self {
        let (errors, prior) = (ErrorSummary::of(&self.tally.errors), ErrorSummary::of(&self.prior));
        self.keypoints = errors.count;
        if errors.count > 0 {
            self.prior_median_px = finite(prior.median_px);
            self.median_px = finite(errors.median_px);
            self.under_10px = finite(errors.under_10px);
            self.bits_over_prior = finite(self.tally.bits_over_prior());
        }
        self
    }

    /// Whether two rows differ in the number of frames only.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        let key = |row: &Self| (row.condition, row.motion, row.target, row.method);
        key(self) == key(other)
    }
}

impl AttackedKeypoints {
    /// The attacked keypoints, as one word.
    pub(super) const fn word(self) -> &'static str {
        match self {
            Self::Private => "private",
            Self::Matched => "matched",
        }
    }
}

impl Method {
    /// The method, as one word.
    pub(super) const fn word(self) -> &'static str {
        match self {
            Self::SeveralFrames => "planes",
            Self::StaticCamera => "scatter",
        }
    }
}
