//! `veiloc eval negatives`: images of elsewhere, sealed for a map and asked for their place in it.
//!
//! Every pose they get is wrong, and one that is trusted is a false positive. Each image is extracted once, sealed under
//! each scheme and localized as a server would. Nothing but its pixels is needed: a camera that is not known is guessed,
//! which makes the pose no worse, as there is no right one.

mod camera;
mod document;
mod table;

use std::path::PathBuf;

use rayon::prelude::*;
use veiloc_features::{Extractors, Image, Progress, SharedGlobal, load_gray};
use veiloc_geometry::Intrinsics;
use veiloc_localization::LocalizeOptions;
use veiloc_map::MapFile;
use veiloc_obfuscation::audit::options_for;
use veiloc_obfuscation::{SealError, SealOptions, extract_loaded};
use veiloc_protocol::Scheme;

use crate::error::EvalError;
use crate::road::{ask, equipped, send};
use camera::camera_of;

pub use camera::CameraSource;
pub use document::{Negative, NegativeRow, Negatives};
pub use table::table;

/// What to ask, and how.
#[derive(Debug, Clone)]
pub struct NegativesEvaluation {
    /// Images of elsewhere.
    pub images: Vec<NegativeImage>,
    /// Schemes, in the order of the table.
    pub schemes: Vec<Scheme>,
    /// Localization.
    pub localize: LocalizeOptions,
    /// Seed of sealing.
    pub seed: u64,
    /// What makes the features that the map asks for, as a device has it.
    pub extractors: Extractors,
    /// What makes the global descriptors of images, where the map's are made of them. Who evaluates owns the images, and so
    /// consents.
    pub global: Option<SharedGlobal>,
}

impl NegativesEvaluation {
    fn seal_options(&self, scheme: Scheme) -> SealOptions {
        equipped(options_for(scheme), &self.extractors, self.global.as_ref())
    }
}

/// An image of elsewhere.
#[derive(Debug, Clone)]
pub struct NegativeImage {
    /// What to call it.
    pub name: String,
    /// Its file.
    pub path: PathBuf,
    /// Its camera, if that is known; otherwise what EXIF tells, or a guess ([`CameraSource`]).
    pub camera: Option<Intrinsics>,
}

/// What came of the images, in their order, and of each scheme; equal whatever the number of threads.
///
/// An image that cannot be read, or is not of its camera's size, is told in [`Negatives::unread`] and counts nowhere. One
/// with too few keypoints to be sealed is a query that finds nothing.
///
/// # Errors
/// [`EvalError`] when the map holds nothing to localize in, or nothing is asked.
pub fn evaluate_negatives(
    map: &MapFile,
    evaluation: &NegativesEvaluation,
    progress: &dyn Progress,
) -> Result<Negatives, EvalError> {
    if map.image_count() == 0 || map.point_count() == 0 {
        return Err(EvalError::DataSet(
            "the map is empty, and finds nothing whatever it is asked; add posed images with `veiloc map add`".to_owned(),
        ));
    }
    if evaluation.images.is_empty() || evaluation.schemes.is_empty() {
        return Err(EvalError::Options("no image or scheme to evaluate".to_owned()));
    }
    progress.start("Localizing negatives", evaluation.images.len());
    let one = |image: &NegativeImage| {
        let answers = answers(map, image, evaluation);
        progress.advance(1);
        answers
    };
    let each: Vec<Result<Vec<Negative>, SealError>> = evaluation.images.par_iter().map(one).collect();
    progress.finish();
    let mut queries = Vec::new();
    let mut unread = Vec::new();
    for (image, answers) in evaluation.images.iter().zip(each) {
        match answers {
            Ok(answers) => queries.extend(answers),
            Err(error) => unread.push((image.name.clone(), error)),
        }
    }
    // Of each image stand its answers side by side, a scheme each.
    let count = evaluation.schemes.len();
    let of_scheme = |at: usize| queries.iter().skip(at).step_by(count).collect::<Vec<_>>();
    let schemes = evaluation.schemes.iter().enumerate();
    let rows = schemes.map(|(at, scheme)| NegativeRow::of(*scheme, &of_scheme(at))).collect();
    Ok(Negatives { rows, queries, unread })
}

/// The answers to one image, a scheme each.
fn answers(
    map: &MapFile,
    image: &NegativeImage,
    evaluation: &NegativesEvaluation,
) -> Result<Vec<Negative>, SealError> {
    let loaded = Image::from(load_gray(&image.path)?);
    let (known, source) = camera_of(image.camera.as_ref(), &image.path)?;
    let profile = map.profile();
    let extraction = evaluation.seal_options(Scheme::default());
    let (features, camera) = extract_loaded(loaded, &image.path, &known.intrinsics, profile, &extraction)?;
    let answer = |scheme: &Scheme| {
        let options = evaluation.seal_options(*scheme).with_focal(known.focal);
        let sent = send(&features, &camera, profile, &options, &image.name, evaluation.seed);
        match sent {
            Ok(sent) => {
                Negative::answered(&image.name, *scheme, source, &ask(map, &sent.bytes, &evaluation.localize))
            }
            Err(error) => Negative::unusable(&image.name, *scheme, source, &error),
        }
    };
    Ok(evaluation.schemes.iter().map(answer).collect())
}
