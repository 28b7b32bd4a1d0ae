//! `veiloc eval negatives`: out-of-map images, sealed for a map and localized in it.
//!
//! Every pose they get is wrong, and a trusted pose is a false positive. Each image is extracted once, sealed under
//! each scheme and localized as on a server. Only its pixels are needed: an unknown camera is assumed, which cannot
//! make the pose worse, since no pose is right.

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
use crate::pipeline::{SimulatedGravity, decode_and_localize, seal_query, with_extractors};
use camera::camera_of;

pub use camera::CameraSource;
pub use document::{NegativeQuery, NegativeRow, NegativesResult};
pub use table::table;

/// Inputs and options.
#[derive(Debug, Clone)]
pub struct NegativesEvaluation {
    /// Out-of-map images.
    pub images: Vec<NegativeImage>,
    /// Schemes, in the order of the table.
    pub schemes: Vec<Scheme>,
    /// Localization.
    pub localize: LocalizeOptions,
    /// Seed of sealing.
    pub seed: u64,
    /// Seals each query with a random gravity direction of this stated standard deviation, degrees; the map needs a
    /// direction of gravity. `None`: without gravity.
    pub random_gravity_sd_deg: Option<f64>,
    /// Extractors for the features of the map, as on a device.
    pub extractors: Extractors,
    /// Extractor of global image descriptors, if the map uses them. The evaluator owns the images, so consent is
    /// implied.
    pub global: Option<SharedGlobal>,
}

impl NegativesEvaluation {
    fn seal_options(&self, scheme: Scheme) -> SealOptions {
        with_extractors(options_for(scheme), &self.extractors, self.global.as_ref())
    }
}

/// An out-of-map image.
#[derive(Debug, Clone)]
pub struct NegativeImage {
    /// Name in the results.
    pub name: String,
    /// Its file.
    pub path: PathBuf,
    /// Its camera, if known; otherwise that of its EXIF metadata, or an assumed one ([`CameraSource`]).
    pub camera: Option<Intrinsics>,
}

/// Results of the images, in their order, and of each scheme; independent of the number of threads.
///
/// An image that cannot be read, or has another size than its camera, is listed in [`NegativesResult::unread`] and not
/// counted. An image with too few keypoints to be sealed counts as a query without a pose.
///
/// # Errors
/// [`EvalError`] when the map is empty, or there are no queries.
pub fn evaluate_negatives(
    map: &MapFile,
    evaluation: &NegativesEvaluation,
    progress: &dyn Progress,
) -> Result<NegativesResult, EvalError> {
    if map.image_count() == 0 || map.point_count() == 0 {
        return Err(EvalError::DataSet(
            "the map is empty, so no query can be localized; add posed images with `veiloc map add`"
                .to_owned(),
        ));
    }
    if evaluation.images.is_empty() || evaluation.schemes.is_empty() {
        return Err(EvalError::Options("no image or scheme to evaluate".to_owned()));
    }
    if evaluation.random_gravity_sd_deg.is_some() && map.down().is_none() {
        return Err(EvalError::Options(
            "the map has no direction of gravity, so that of queries would not be used; build it with --down"
                .to_owned(),
        ));
    }
    progress.start("Localizing negatives", evaluation.images.len());
    let one = |image: &NegativeImage| {
        let answers = answers(map, image, evaluation);
        progress.advance(1);
        answers
    };
    let each: Vec<Result<Vec<NegativeQuery>, SealError>> = evaluation.images.par_iter().map(one).collect();
    progress.finish();
    let mut queries = Vec::new();
    let mut unread = Vec::new();
    for (image, answers) in evaluation.images.iter().zip(each) {
        match answers {
            Ok(answers) => queries.extend(answers),
            Err(error) => unread.push((image.name.clone(), error)),
        }
    }
    // The answers to one image are adjacent, one per scheme.
    let count = evaluation.schemes.len();
    let of_scheme = |at: usize| queries.iter().skip(at).step_by(count).collect::<Vec<_>>();
    let schemes = evaluation.schemes.iter().enumerate();
    let rows = schemes.map(|(at, scheme)| NegativeRow::of(*scheme, &of_scheme(at))).collect();
    Ok(NegativesResult { rows, queries, unread })
}

/// The answers to one image, one per scheme.
fn answers(
    map: &MapFile,
    image: &NegativeImage,
    evaluation: &NegativesEvaluation,
) -> Result<Vec<NegativeQuery>, SealError> {
    let loaded = Image::from(load_gray(&image.path)?);
    let (known, source) = camera_of(image.camera.as_ref(), &image.path)?;
    let profile = map.profile();
    let extraction = evaluation.seal_options(Scheme::default());
    let (features, camera) = extract_loaded(loaded, &image.path, &known.intrinsics, profile, &extraction)?;
    let gravity = evaluation
        .random_gravity_sd_deg
        .and_then(|sd_deg| SimulatedGravity::random(&image.name, sd_deg, evaluation.seed));
    let answer = |scheme: &Scheme| {
        let options = evaluation.seal_options(*scheme).with_focal(known.focal).with_gravity(gravity);
        let sent = seal_query(&features, &camera, profile, &options, &image.name, evaluation.seed);
        match sent {
            Ok(sent) => NegativeQuery::answered(
                &image.name,
                *scheme,
                source,
                &decode_and_localize(map, &sent.bytes, &evaluation.localize),
            ),
            Err(error) => NegativeQuery::unusable(&image.name, *scheme, source, &error),
        }
    };
    Ok(evaluation.schemes.iter().map(answer).collect())
}
