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

use crate::EvalError;
use crate::attack_evaluation::{
    AttackDocument, AttackEvaluation, AttackObserver, AttackProgress, AttackTrial, ImageGroup,
    NeighbourSource, StrongestAttacks, attack_groups,
};

use crate::results::metrics::median;
pub use protection::PROTECTION;
pub use shown_images::{RowErrors, ShownAttack, ShownImage, ShownImages, ShownScheme};

/// Inputs and options of an audit.
#[derive(Debug, Clone)]
pub struct AuditOptions {
    /// Schemes, attacks and the attacker's knowledge. Its `files` are attacked after [`Self::groups`]; `synthetic` is
    /// the number of keypoints of the paper's synthetic scene, 0 for none.
    pub evaluation: AttackEvaluation,
    /// Images; may be empty, for the synthetic scene alone.
    pub groups: Vec<ImageGroup>,
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
/// [`EvalError`] as [`attack_groups`], or when an image cannot be read; [`EvalError::Options`] when there is
/// nothing to attack.
pub fn run_audit(
    options: &AuditOptions,
    file_of: &dyn Fn(usize, usize) -> Option<PathBuf>,
    progress: &dyn Progress,
) -> Result<Audit, EvalError> {
    let started = Instant::now();
    let evaluation = &once(&options.evaluation);
    let with_inputs = !options.groups.is_empty() || !evaluation.files.is_empty();
    if !with_inputs && evaluation.synthetic == 0 {
        return Err(EvalError::Options(
            "there is nothing to attack: no input, and no synthetic scene".to_owned(),
        ));
    }
    let mut document = AuditDocument { version: 1, command: "audit", ..AuditDocument::default() };
    let mut inputs = None;
    if with_inputs {
        let on_inputs = AttackEvaluation { synthetic: 0, ..evaluation.clone() };
        let mut watched = AuditObserver::new(options.shown, progress, "Attacking the inputs");
        let found = attack_groups(&on_inputs, options.groups.clone(), &mut watched)?;
        progress.finish();
        let mut gallery = watched.gallery;
        for shown in &mut gallery.shown {
            let path = file_of(shown.at.0, shown.at.1);
            shown.photograph = path.map(|path| load(&path, shown.size)).transpose()?;
        }
        document.inputs = Some(part(found, &gallery));
        inputs = Some(gallery);
    }
    let mut synthetic = None;
    if evaluation.synthetic > 0 {
        let on_scene = AttackEvaluation {
            files: Vec::new(),
            images: None,
            attacks: evaluation.attacks.iter().copied().filter(|a| a.needs.one_image()).collect(),
            neighbours: NeighbourSource::Oracle,
            ..evaluation.clone()
        };
        let mut watched = AuditObserver::new(1, progress, "Attacking the synthetic scene");
        let found = attack_groups(&on_scene, Vec::new(), &mut watched)?;
        progress.finish();
        document.synthetic = Some(part(found, &watched.gallery));
        synthetic = Some(watched.gallery);
    }
    Ok(Audit { document, inputs, synthetic, seconds: started.elapsed().as_secs_f64() })
}

/// The same without repeated schemes, attacks and shares.
fn once(evaluation: &AttackEvaluation) -> AttackEvaluation {
    fn distinct<T: PartialEq + Copy>(all: &[T]) -> Vec<T> {
        all.iter().enumerate().filter(|(i, x)| !all[..*i].contains(x)).map(|(_, x)| *x).collect()
    }
    AttackEvaluation {
        schemes: distinct(&evaluation.schemes),
        attacks: distinct(&evaluation.attacks),
        corrupt: distinct(&evaluation.corrupt),
        ..evaluation.clone()
    }
}

fn part(attacks: AttackDocument, gallery: &ShownImages) -> AuditPart {
    let relative_offset_error = attacks.attacks.iter().map(|row| {
        let same =
            |s: &&RowErrors| s.scheme == row.scheme && s.attack == row.attack && s.corrupt == row.corrupt;
        gallery.errors.iter().find(same).map_or(f64::NAN, |s| median(&s.relative_offset_error))
    });
    AuditPart {
        relative_offset_error: relative_offset_error.collect(),
        keypoints: gallery.keypoints,
        strongest: attacks.strongest(),
        attacks,
    }
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

/// Collects data for drawings, and reports progress.
struct AuditObserver<'a> {
    gallery: ShownImages,
    stage: AttackProgress<'a>,
}

impl<'a> AuditObserver<'a> {
    fn new(shown: usize, progress: &'a dyn Progress, stage: &'a str) -> Self {
        Self { gallery: ShownImages::with_limit(shown), stage: AttackProgress::new(progress, stage) }
    }
}

impl AttackObserver for AuditObserver<'_> {
    fn advance(&mut self, _done: usize, total: usize) {
        self.stage.advance(total);
    }

    fn saw(&mut self, trial: &AttackTrial<'_>) {
        self.gallery.saw(trial);
    }
}

#[cfg(test)]
mod tests {
    use veiloc_datasets::problem_files::synthetic_image;
    use veiloc_protocol::Scheme;

    use super::*;
    use crate::attack_evaluation::Attack;

    #[test]
    fn repeated_options_are_deduplicated() {
        let images = vec![synthetic_image(90, 1), synthetic_image(80, 2)];
        let once = AuditOptions {
            evaluation: AttackEvaluation {
                schemes: vec![Scheme::RandomLines, Scheme::default()],
                corrupt: vec![0.0, 30.0],
                ..AttackEvaluation::default()
            },
            groups: vec![ImageGroup { name: "two".to_owned(), images }],
            shown: 1,
            command: String::new(),
        };
        let mut twice = once.clone();
        twice.evaluation.schemes.extend(once.evaluation.schemes.clone());
        twice.evaluation.attacks.push(Attack::CLOSED_FORM);
        twice.evaluation.corrupt.push(0.0);
        let rows = |options: &AuditOptions| {
            let part =
                run_audit(options, &|_, _| None, &()).expect("it runs").document.inputs.expect("inputs");
            let errors: Vec<f64> = part.attacks.attacks.iter().map(|row| row.mean_px).collect();
            (part.keypoints, errors, part.relative_offset_error)
        };
        assert_eq!(rows(&twice), rows(&once));
        assert_eq!(rows(&once).0, 170);
    }
}
