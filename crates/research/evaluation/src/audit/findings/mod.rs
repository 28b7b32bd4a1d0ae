//! The audit: the attacks on the inputs and on the paper's synthetic scene, the document, and all that a page draws.
//!
//! What is said in words is decided by the figures ([`conclusion`]). `veiloc-report` makes the page of it.

mod conclusion;
mod data;
mod gallery;
#[cfg(test)]
mod tests;
mod verdict;
mod words;

use std::path::{Path, PathBuf};
use std::time::Instant;

use image::RgbImage;
use image::imageops::{FilterType, resize};

use crate::EvalError;
use crate::audit::{
    AttackDocument, AttackEvaluation, AttackObserver, AttackTrial, NeighbourSource, Stage, attack_groups,
};
use crate::results::metrics::median;
use veiloc_features::Progress;

pub use conclusion::{conclusion, findings};
pub use data::{Audit, AuditDocument, AuditOptions, AuditPart, Part};
pub use gallery::{Gallery, Shown, ShownAttack, ShownScheme, Spread};
pub use verdict::base_share;
pub use words::{Sentence, capital, count, needs, percent, px, scheme_words};

/// Attacks inputs and synthetic scene.
///
/// `file_of(group, index)` names the file behind the keypoints of a group's image, or `None` when there is none or
/// it shall not be shown; it is asked for the drawn images only.
///
/// On the synthetic scene, which has no descriptors and no other images, neighbours are the oracle's and attacks that
/// need more are left out.
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
    let mut inputs = None;
    if with_inputs {
        let on_inputs = AttackEvaluation { synthetic: 0, ..evaluation.clone() };
        let mut watched = Watched::new(options.shown, progress, "Attacking the inputs");
        let document = attack_groups(&on_inputs, options.groups.clone(), &mut watched)?;
        progress.finish();
        let gallery = watched.gallery;
        let document = part(document, &gallery);
        let of = |s: &Shown| file_of(s.at.0, s.at.1).map(|path| load(&path, s.size)).transpose();
        let photographs = gallery.shown.iter().map(of).collect::<Result<_, _>>()?;
        inputs = Some(Part { document, gallery, photographs });
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
        let mut watched = Watched::new(1, progress, "Attacking the synthetic scene");
        let document = attack_groups(&on_scene, Vec::new(), &mut watched)?;
        progress.finish();
        let gallery = watched.gallery;
        synthetic = Some(Part { document: part(document, &gallery), gallery, photographs: vec![None] });
    }
    let first = inputs.as_ref().or(synthetic.as_ref());
    let said = first.map(|p| conclusion(&p.document)).unwrap_or_default();
    let document = AuditDocument {
        version: 1,
        command: "audit",
        conclusion: said.iter().map(|s| s.plain()).collect(),
        inputs: inputs.as_ref().map(|p| p.document.clone()),
        synthetic: synthetic.as_ref().map(|p| p.document.clone()),
    };
    Ok(Audit { document, inputs, synthetic, seconds: started.elapsed().as_secs_f64() })
}

/// The same with nothing asked for twice: a row of the document is one of the page.
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

fn part(attacks: AttackDocument, gallery: &Gallery) -> AuditPart {
    let bending = attacks.attacks.iter().map(|row| {
        let same = |s: &&Spread| s.scheme == row.scheme && s.attack == row.attack && s.corrupt == row.corrupt;
        gallery.spreads.iter().find(same).map_or(f64::NAN, |s| median(&s.bending))
    });
    AuditPart { bending: bending.collect(), keypoints: gallery.keypoints, attacks }
}

/// By what share the shape of an image may differ from that of its keypoints: sides are rounded when it is made smaller.
const SHAPE: f64 = 0.02;

/// An image in colour, of the size that its keypoints are in. Its metadata is not read, nor its orientation.
fn load(path: &Path, (width, height): (u32, u32)) -> Result<RgbImage, EvalError> {
    let fault = |e| EvalError::Io { path: path.to_owned(), source: std::io::Error::other(e) };
    let image = image::open(path).map_err(fault)?.into_rgb8();
    let (across, down) = image.dimensions();
    // Keypoints may be of the image made smaller, but not of one of another shape.
    let scale = f64::from(width) / f64::from(across);
    if (scale * f64::from(down) - f64::from(height)).abs() > SHAPE * f64::from(height) {
        return Err(EvalError::DataSet(format!(
            "{}: the image has {across} x {down} pixels, and its keypoints are of one of {width} x {height}; give the image \
             that the keypoints were found in",
            path.display()
        )));
    }
    let fits = image.dimensions() == (width, height);
    Ok(if fits { image } else { resize(&image, width, height, FilterType::Triangle) })
}

/// Collects for the page, and tells how far the work is.
struct Watched<'a> {
    gallery: Gallery,
    stage: Stage<'a>,
}

impl<'a> Watched<'a> {
    fn new(shown: usize, progress: &'a dyn Progress, stage: &'a str) -> Self {
        Self { gallery: Gallery::keeping(shown), stage: Stage::new(progress, stage) }
    }
}

impl AttackObserver for Watched<'_> {
    fn advance(&mut self, _done: usize, total: usize) {
        self.stage.advance(total);
    }

    fn saw(&mut self, trial: &AttackTrial<'_>) {
        self.gallery.saw(trial);
    }
}
