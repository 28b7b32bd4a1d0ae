//! The audit: attacks on images and on the paper's synthetic scene, with their document and the data for a report's
//! drawings.

mod protection;
mod shown_images;

use std::path::{Path, PathBuf};
use std::time::Instant;

use image::RgbImage;
use image::imageops::{FilterType, resize};
use serde::Serialize;
use veiloc_features::Progress;

use super::{Attack, AttackDocument, AttackEvaluation, NeighbourSource, StrongestAttacks, evaluate_attacks};
use veiloc_geometry::statistics::median;

use crate::EvalError;
pub use protection::PROTECTION;
pub use shown_images::{ShownAttack, ShownImage, ShownImages, ShownScheme};

/// Inputs and options of an audit.
#[derive(Debug, Clone)]
pub struct AuditOptions {
    /// Images, which may be none, schemes, attacks and the attacker's knowledge; `synthetic` is the number of keypoints of
    /// the paper's synthetic scene, 0 for none.
    pub evaluation: AttackEvaluation,
    /// Number of images that are drawn, from the first.
    pub shown: usize,
    /// The command that repeats the run, for the report.
    pub command: String,
}

/// Attacks on the inputs and on the paper's synthetic scene.
#[derive(Debug, Clone, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AuditDocument {
    /// 1.
    pub version: u32,
    /// `audit`.
    pub command: &'static str,
    /// The attacks on the inputs; absent without inputs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inputs: Option<AuditPart>,
    /// The attacks on the paper's synthetic scene; absent when it was left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub synthetic: Option<AuditPart>,
}

/// The attacks of `veiloc attack`, with figures that only the audit computes.
#[derive(Debug, Clone, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AuditPart {
    /// The document of `veiloc attack`.
    #[serde(flatten)]
    pub attacks: AttackDocument,
    /// Number of keypoints of all images.
    pub keypoints: usize,
    /// The strongest attacks, one entry per scheme.
    pub strongest: Vec<StrongestAttacks>,
    /// One entry for each of the document's attacks, in its order: the relative error of the offsets between
    /// neighbouring keypoints. The median, over keypoints and 8 true neighbours of each, of the error of the offset
    /// divided by its length: 0 for a common translation, 1 if all positions coincide.
    pub relative_offset_error: Vec<f64>,
}

/// Results of an audit.
#[derive(Debug, Clone)]
pub struct Audit {
    /// All figures.
    pub document: AuditDocument,
    /// Data for drawings of the inputs; `None` without inputs.
    pub inputs: Option<ShownImages>,
    /// Data for drawings of the synthetic scene; `None` when it was left out.
    pub synthetic: Option<ShownImages>,
    /// Duration, seconds.
    pub seconds: f64,
}

/// Attacks inputs and synthetic scene.
///
/// `file_of(group, index)` returns the image file of the keypoints, or `None` when there is none or it must not be
/// shown; it is called for the drawn images only.
///
/// The synthetic scene has no descriptors and no other images: its neighbours come from the oracle, and attacks that
/// need more are skipped.
///
/// # Errors
/// [`EvalError`] as [`evaluate_attacks`], or when an image cannot be read; [`EvalError::Options`] when there is
/// nothing to attack.
pub fn run_audit(
    options: &AuditOptions,
    file_of: &dyn Fn(usize, usize) -> Option<PathBuf>,
    progress: &dyn Progress,
) -> Result<Audit, EvalError> {
    let started = Instant::now();
    let evaluation = &options.evaluation;
    let with_inputs = !evaluation.groups.is_empty() || !evaluation.files.is_empty();
    if !with_inputs && evaluation.synthetic == 0 {
        return Err(EvalError::Options(
            "there is nothing to attack: no input, and no synthetic scene".to_owned(),
        ));
    }
    let mut audit = Audit {
        document: AuditDocument { version: 1, command: "audit", ..AuditDocument::default() },
        inputs: None,
        synthetic: None,
        seconds: 0.0,
    };
    if with_inputs {
        let on_inputs = AttackEvaluation { synthetic: 0, ..evaluation.clone() };
        let (part, mut found) = part(&on_inputs, options.shown, "Attacking the inputs", progress)?;
        for shown in &mut found.shown {
            let path = file_of(shown.at.0, shown.at.1);
            shown.photograph = path.map(|path| load(&path, shown.size)).transpose()?;
        }
        (audit.document.inputs, audit.inputs) = (Some(part), Some(found));
    }
    if evaluation.synthetic > 0 {
        let on_scene = AttackEvaluation {
            groups: Vec::new(),
            files: Vec::new(),
            images: None,
            attacks: evaluation.attacks.iter().copied().filter(Attack::needs_one_image).collect(),
            neighbours: NeighbourSource::Oracle,
            place: None,
            ..evaluation.clone()
        };
        let (part, found) = part(&on_scene, 1, "Attacking the synthetic scene", progress)?;
        (audit.document.synthetic, audit.synthetic) = (Some(part), Some(found));
    }
    audit.seconds = started.elapsed().as_secs_f64();
    Ok(audit)
}

/// Runs the attacks, and collects the positions of the first images.
fn part(
    evaluation: &AttackEvaluation,
    shown: usize,
    stage: &str,
    progress: &dyn Progress,
) -> Result<(AuditPart, ShownImages), EvalError> {
    let mut found = ShownImages::with_limit(shown);
    let attacks = evaluate_attacks(evaluation, stage, progress, &mut |trial| found.add(trial))?;
    let part = AuditPart {
        relative_offset_error: found.offset_errors.iter().map(|errors| median(errors)).collect(),
        keypoints: found.keypoints,
        strongest: attacks.strongest(),
        attacks,
    };
    Ok((part, found))
}

/// Tolerance between the aspect ratios of an image and its keypoints: sides are rounded when an image is resized.
const ASPECT_TOLERANCE: f64 = 0.02;

/// A colour image with the size of its keypoints. Its metadata is not read, so its orientation is ignored.
fn load(path: &Path, (width, height): (u32, u32)) -> Result<RgbImage, EvalError> {
    let fault = |e| EvalError::Io { path: path.to_owned(), source: std::io::Error::other(e) };
    let image = image::open(path).map_err(fault)?.into_rgb8();
    let (across, down) = image.dimensions();
    // Keypoints may belong to a resized version of the image, but not to another aspect ratio.
    let scale = f64::from(width) / f64::from(across);
    if (scale * f64::from(down) - f64::from(height)).abs() > ASPECT_TOLERANCE * f64::from(height) {
        return Err(EvalError::DataSet(format!(
            "{}: the image has {across} x {down} pixels, and its keypoints are of one of {width} x {height}; give the image \
             that the keypoints were found in",
            path.display()
        )));
    }
    let fits = image.dimensions() == (width, height);
    Ok(if fits { image } else { resize(&image, width, height, FilterType::Triangle) })
}
