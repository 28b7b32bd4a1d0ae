//! What an audit is asked, and what it found.

use image::RgbImage;
use serde::Serialize;

use super::gallery::Gallery;
use crate::audit::{AttackDocument, AttackEvaluation, ImageGroup};

/// What an audit attacks, and how it reports.
#[derive(Debug, Clone)]
pub struct AuditOptions {
    /// Schemes, attacks and what the attacker knows. Its `files` are attacked after [`Self::groups`]; `synthetic` is the
    /// number of keypoints of the paper's synthetic scene, 0 for none.
    pub evaluation: AttackEvaluation,
    /// Images; may be none, for the synthetic scene alone.
    pub groups: Vec<ImageGroup>,
    /// Images that are drawn, from the first.
    pub shown: usize,
    /// The command that repeats the run, for the page.
    pub command: String,
}

/// The document of `veiloc audit --json`.
#[derive(Debug, Clone, Default, Serialize)]
pub struct AuditDocument {
    /// Version of this document; a field is never removed or given another meaning under the same number.
    pub version: u32,
    /// `audit`.
    pub command: &'static str,
    /// What was found in words, decided by the figures below: of the inputs, or of the synthetic scene without inputs.
    pub conclusion: Vec<String>,
    /// The attacks on the inputs; absent without inputs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inputs: Option<AuditPart>,
    /// The attacks on the paper's synthetic scene; absent when it was left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub synthetic: Option<AuditPart>,
}

/// The attacks on inputs or scene, as `veiloc attack` has them, and what only the audit measures.
#[derive(Debug, Clone, Default, Serialize)]
pub struct AuditPart {
    /// The document of `veiloc attack`.
    #[serde(flatten)]
    pub attacks: AttackDocument,
    /// Keypoints of all images.
    pub keypoints: usize,
    /// One entry for each of the document's attacks, in its order: how far the arrangement of the recovered keypoints is
    /// bent. The median, over keypoints and over 8 true neighbours of each, of the error of the offset to the neighbour in
    /// shares of its length: 0 when all are moved together, 1 when all fall on one place.
    pub bending: Vec<f64>,
}

/// What an audit found.
#[derive(Debug, Clone)]
pub struct Audit {
    /// All figures.
    pub document: AuditDocument,
    /// What a page draws of the inputs; `None` without inputs.
    pub inputs: Option<Part>,
    /// The same of the synthetic scene; `None` when it was left out.
    pub synthetic: Option<Part>,
    /// How long it took.
    pub seconds: f64,
}

/// One evaluation and what was collected of it.
#[derive(Debug, Clone)]
pub struct Part {
    /// Its figures.
    pub document: AuditPart,
    /// Single keypoints.
    pub gallery: Gallery,
    /// `[shown]`: the photographs behind the images that are drawn.
    pub photographs: Vec<Option<RgbImage>>,
}
