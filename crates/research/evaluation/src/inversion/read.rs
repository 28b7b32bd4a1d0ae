//! Images of files, to learn from.

use std::collections::BTreeSet;
use std::path::PathBuf;

use crate::EvalError;
use crate::inversion::example::Example;
use crate::inversion::task::InversionTask;
use rayon::prelude::*;
use veiloc_datasets::problem_files::keypoints_of_image;
use veiloc_features::{Extractor, Progress, load_colour};
use veiloc_protocol::ExtractionLimits;

/// Reads images, finds their keypoints, and keeps what is learned from, in their order.
///
/// # Errors
/// The first in that order, if there is one: a file that is no image.
pub fn read_examples(
    paths: &[PathBuf],
    extractor: &dyn Extractor,
    limits: ExtractionLimits,
    task: &InversionTask,
    progress: &dyn Progress,
) -> Result<Vec<Example>, EvalError> {
    progress.start("Reading images", paths.len());
    let read = |path: &PathBuf| {
        let keypoints = keypoints_of_image(path, extractor, limits)?;
        let example = Example::new(&load_colour(path)?, &keypoints, task);
        progress.advance(1);
        example
    };
    let examples: Vec<Result<Example, EvalError>> = paths.par_iter().map(read).collect();
    progress.finish();
    examples.into_iter().collect()
}

/// A figure of an image that was learned from would be worth nothing. Images are told by what is on the grid, whatever they
/// are called.
///
/// # Errors
/// [`EvalError::SharedImages`] when an image is in both sets.
pub fn refuse_shared(training: &[Example], validation: &[Example]) -> Result<(), EvalError> {
    let learned: BTreeSet<&[u8]> = training.iter().map(Example::colours).collect();
    let shared = validation.iter().filter(|example| learned.contains(example.colours())).count();
    if shared > 0 { Err(EvalError::SharedImages { images: shared }) } else { Ok(()) }
}
