//! Images and their problems, joined: which keypoint of the image each match is of.

use std::collections::HashMap;
use std::path::Path;

use veiloc_attacks::KnownImage;
use veiloc_datasets::problem_files::{KeypointImage, read_keypoints};
use veiloc_datasets::problem_files::{Problem, read_problems};
use veiloc_geometry::Pixel;

use crate::EvalError;

/// Positions of the two files are equal when they agree to this, pixels; a camera's rounding is far smaller.
const SAME_PX: f64 = 1e-6;

/// An image with all its keypoints, and its matches.
#[derive(Debug, Clone)]
pub(super) struct Query {
    pub(super) image: KeypointImage,
    pub(super) problem: Problem,
    /// Keypoints of the image at the position of each keypoint of the problem, `[problem keypoints]`; at least one
    /// each, more where an extractor found several orientations.
    pub(super) rows_of: Vec<Vec<usize>>,
    /// Smallest distance ratio of a match of each keypoint, `[N]`; infinite without a match, 1 where no ratio is given.
    pub(super) ratios: Vec<f64>,
}

/// Images with problems, and those without: they serve as images of the map.
#[derive(Debug)]
pub(super) struct Data {
    pub(super) queries: Vec<Query>,
    pub(super) others: Vec<KeypointImage>,
}

/// Reads both files and joins them by name and position.
///
/// # Errors
/// [`EvalError`] when a file cannot be read, no name is in both, an image comes without descriptors, or a match is at
/// no keypoint of its image.
pub(super) fn read(keypoints: &Path, problems: &Path) -> Result<Data, EvalError> {
    let mut by_name: HashMap<String, Problem> =
        read_problems(problems)?.into_iter().map(|p| (p.name.clone(), p)).collect();
    let (mut queries, mut others) = (Vec::new(), Vec::new());
    for image in read_keypoints(keypoints)? {
        match by_name.remove(&image.name) {
            Some(problem) => queries.push(join(image, problem)?),
            None => others.push(image),
        }
    }
    if queries.is_empty() {
        return Err(EvalError::DataSet(format!(
            "{} and {} have no image name in common; both must come from the same images (eval problems --keypoints \
             writes both)",
            keypoints.display(),
            problems.display()
        )));
    }
    Ok(Data { queries, others })
}

fn join(image: KeypointImage, problem: Problem) -> Result<Query, EvalError> {
    if (image.width, image.height) != (problem.camera.width, problem.camera.height) {
        return Err(EvalError::DataSet(format!(
            "{}: the keypoints are of {} x {} pixels, the problem's camera takes {} x {}",
            image.name, image.width, image.height, problem.camera.width, problem.camera.height
        )));
    }
    let mut by_u: Vec<usize> = (0..image.keypoints.len()).collect();
    by_u.sort_by(|a, b| image.keypoints[*a].u.total_cmp(&image.keypoints[*b].u));
    let at = |p: &Pixel| -> Vec<usize> {
        let first = by_u.partition_point(|i| image.keypoints[*i].u < p.u - SAME_PX);
        let near = by_u[first..].iter().take_while(|i| image.keypoints[**i].u <= p.u + SAME_PX);
        let mut rows: Vec<usize> =
            near.copied().filter(|i| (image.keypoints[*i].v - p.v).abs() <= SAME_PX).collect();
        rows.sort_unstable();
        rows
    };
    let rows_of: Vec<Vec<usize>> = problem.keypoints.iter().map(at).collect();
    if let Some(lost) = rows_of.iter().position(Vec::is_empty) {
        let p = problem.keypoints[lost];
        return Err(EvalError::DataSet(format!(
            "{}: a match is at ({:.3}, {:.3}), where the image has no keypoint; both files must come from one \
             extraction, in pixels of a camera without distortion",
            image.name, p.u, p.v
        )));
    }
    let mut ratios = vec![f64::INFINITY; image.keypoints.len()];
    for (m, &keypoint) in problem.keypoint_of_match.iter().enumerate() {
        let ratio = problem.ratio.as_ref().map_or(1.0, |r| r[m]);
        for &row in &rows_of[keypoint] {
            ratios[row] = ratio.min(ratios[row]);
        }
    }
    descriptors(&image)?;
    Ok(Query { image, problem, rows_of, ratios })
}

/// The descriptors of an image, `[N · dimension]`, and their dimension.
pub(super) fn descriptors(image: &KeypointImage) -> Result<(&[u8], usize), EvalError> {
    match &image.descriptors {
        Some((bytes, dimension)) => Ok((bytes, *dimension)),
        None => Err(EvalError::DataSet(format!(
            "{} comes without descriptors, which transfer and prediction of neighbours read; write them with eval \
             problems --keypoints or eval keypoints",
            image.name
        ))),
    }
}

/// Some keypoints of an image with everything that is known of them.
pub(super) fn known(image: &KeypointImage, rows: &[usize]) -> Result<KnownImage, EvalError> {
    let (bytes, dimension) = descriptors(image)?;
    let chosen: Vec<u8> =
        rows.iter().flat_map(|r| &bytes[r * dimension..(r + 1) * dimension]).copied().collect();
    let keypoints = rows.iter().map(|r| image.keypoints[*r]).collect();
    let descriptors = veiloc_attacks::Descriptors::new(&chosen, dimension)?;
    Ok(KnownImage::new(keypoints, descriptors, image.width, image.height)?)
}
