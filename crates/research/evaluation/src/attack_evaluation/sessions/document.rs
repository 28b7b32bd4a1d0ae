//! The JSON document of `veiloc eval sessions`.

use crate::results::metrics::{finite, median};
use crate::results::{MapSummary, SchemeSummary};
use serde::Serialize;
use veiloc_attacks::{ErrorSummary, bits_over_prior};
use veiloc_obfuscation::SessionAnchors;
use veiloc_protocol::Scheme;

use super::SessionsEvaluation;
use super::attack::{AttackErrors, AttackedKeypoints, Method};
use super::device::{Gyroscope, Sealed};
use super::motion::Motion;

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
    /// Reference of the anchors: `image`, `world` or `gravity`.
    pub anchors: String,
    /// Standard deviation of each orientation's error about each axis, degrees.
    pub gyro_deg: f64,
    /// Standard deviation of the orientation's drift from one frame to the next, degrees.
    pub drift_deg: f64,
    /// Number of new layout positions.
    pub starts: u32,
    /// Median number of sent keypoints per frame, without decoys.
    pub keypoints: f64,
    /// Recall, medians and times.
    #[serde(flatten)]
    pub summary: SchemeSummary,
}

impl FramesFigures {
    pub(super) fn new(
        anchors: SessionAnchors,
        gyroscope: &Gyroscope,
        starts: u32,
        sealed: &[Result<Sealed, String>],
        mut summary: SchemeSummary,
    ) -> Self {
        let sealed = || sealed.iter().filter_map(|s| s.as_ref().ok());
        let keypoints: Vec<f64> = sealed().map(|s| s.truth.source.iter().flatten().count() as f64).collect();
        let mut bytes: Vec<usize> = sealed().map(|s| s.bytes.len()).collect();
        bytes.sort_unstable();
        summary.sealed_bytes = bytes.get(bytes.len() / 2).copied();
        Self {
            anchors: anchors.to_string(),
            gyro_deg: gyroscope.gyro_deg,
            drift_deg: gyroscope.drift_deg,
            starts,
            keypoints: median(&keypoints),
            summary,
        }
    }
}

/// Leakage of several frames of a session.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SessionRow {
    /// Obfuscation scheme.
    pub scheme: String,
    /// Reference of the anchors: `image`, `world` or `gravity`.
    pub anchors: String,
    /// Motion of the camera.
    pub motion: Motion,
    /// Number of frames, including the attacked one.
    pub frames: usize,
    /// Standard deviation of each orientation's error about each axis, degrees.
    pub gyro_deg: f64,
    /// Standard deviation of the orientation's drift from one frame to the next, degrees.
    pub drift_deg: f64,
    /// Attacked keypoints.
    target: AttackedKeypoints,
    /// Method of the attack.
    method: Method,
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
    errors: Vec<f64>,
    #[serde(skip)]
    prior: Vec<f64>,
    /// Bits times keypoints.
    #[serde(skip)]
    bits: f64,
}

impl SessionRow {
    /// Empty rows by measure, method and number of frames.
    pub(super) fn of(
        evaluation: &SessionsEvaluation,
        scheme: Scheme,
        anchors: SessionAnchors,
        motion: Motion,
        gyroscope: &Gyroscope,
    ) -> Vec<Self> {
        let mut rows = Vec::new();
        for measured in AttackedKeypoints::ALL {
            for method in Method::of(motion) {
                rows.extend(evaluation.frames.iter().map(|frames| Self {
                    scheme: scheme.to_string(),
                    anchors: anchors.to_string(),
                    motion,
                    frames: *frames,
                    gyro_deg: gyroscope.gyro_deg,
                    drift_deg: gyroscope.drift_deg,
                    target: measured,
                    method: *method,
                    images: 0,
                    keypoints: 0,
                    prior_median_px: None,
                    median_px: None,
                    under_10px: None,
                    bits_over_prior: None,
                    errors: Vec::new(),
                    prior: Vec::new(),
                    bits: 0.0,
                }));
            }
        }
        rows
    }

    /// Adds an image.
    pub(super) fn add(&mut self, attacked: &AttackErrors) {
        if attacked.errors.is_empty() {
            return;
        }
        let (width, height) = attacked.size;
        let bits = bits_over_prior(&attacked.errors, &attacked.prior, width, height);
        self.bits += bits * attacked.errors.len() as f64;
        self.images += 1;
        self.errors.extend(&attacked.errors);
        self.prior.extend(&attacked.prior_for_pixels);
    }

    /// The row with its final figures.
    pub(super) fn finished(mut self) -> Self {
        let (errors, prior) = (ErrorSummary::of(&self.errors), ErrorSummary::of(&self.prior));
        self.keypoints = errors.count;
        if errors.count > 0 {
            self.prior_median_px = finite(prior.median_px);
            self.median_px = finite(errors.median_px);
            self.under_10px = finite(errors.under_10px);
            self.bits_over_prior = finite(self.bits / errors.count as f64);
        }
        self
    }

    /// Whether two rows differ in the number of frames only.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        let key = |r: &Self| (r.scheme.clone(), r.anchors.clone(), r.motion, r.target, r.method);
        key(self) == key(other) && [self.gyro_deg, self.drift_deg] == [other.gyro_deg, other.drift_deg]
    }

    /// The attacked keypoints, as one word.
    pub const fn attacked_keypoints(&self) -> &'static str {
        match self.target {
            AttackedKeypoints::Private => "private",
            AttackedKeypoints::Matched => "matched",
        }
    }

    /// The method, as one word.
    pub(super) const fn by(&self) -> &'static str {
        match self.method {
            Method::SeveralFrames => "planes",
            Method::RestingCamera => "scatter",
        }
    }
}
