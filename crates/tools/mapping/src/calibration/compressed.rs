//! Self-test of a compressed map with the images of the whole map, and search for the smallest map within a recall
//! loss.

use std::collections::BTreeMap;

use crate::MappingError;
use crate::{CompressOptions, CompressedMap, HoldOutMap, Progress, compress};
use veiloc_map::{
    HeldOut, HeldOutPoint, MapFile, MapModel, MapView, PointEvidence, PointId, PointSummary, SelfTest,
};

use crate::calibration::run::{SelfTestOptions, self_test, test_in};

/// Localizes images of a map in a compressed version of it; each image is left out of both. Queries are made from the
/// whole map's features of an image, and points are those of the whole map without it.
///
/// The result belongs in the compressed map's `self_test`. The choice of points is not repeated without the image.
///
/// # Errors
/// As for [`self_test`].
pub fn self_test_compressed(
    whole: &MapModel,
    small: &CompressedMap,
    options: &SelfTestOptions,
    progress: &dyn Progress,
) -> Result<SelfTest, MappingError> {
    let (file, whole_file) = (MapFile::of_model(&small.model)?, MapFile::of_model(whole)?);
    let hold_out = HoldOutMap::of(whole);
    let id_of: BTreeMap<PointId, PointId> =
        small.kept_points.iter().copied().zip((0..).map(PointId)).collect();
    let without = |image: usize| {
        let in_whole = hold_out.without(&hold_out.with_neighbors(image));
        let view = MapView::without(&whole_file, &in_whole);
        let moved = |(id, point): (&PointId, &Option<HeldOutPoint>)| {
            let remembered = || PointSummary::new(view.seen_by(*id) as u32, &view.point_covariance(*id));
            let point = point.as_ref().map(|point| HeldOutPoint {
                position: point.position,
                evidence: PointEvidence::Summary(remembered()),
            });
            Some((*id_of.get(id)?, point))
        };
        HeldOut {
            images: in_whole.images.clone(),
            points: in_whole.points.iter().filter_map(moved).collect(),
        }
    };
    test_in(whole, &file, &without, options, progress)
}

/// Finds the smallest map whose self-test is at most `points` percentage points below the whole map's, in the mean of
/// trusted images and images within 1 % of the scale and 1°, averaged over the schemes; returns it with its self-test.
///
/// Searches by bisection, to a tenth of the size. `None` if no compressed map reaches it.
///
/// # Errors
/// As for [`self_test`] and [`compress`].
pub fn smallest_within(
    whole: &MapModel,
    points: f64,
    compress_options: &CompressOptions,
    options: &SelfTestOptions,
    progress: &dyn Progress,
) -> Result<Option<CompressedMap>, MappingError> {
    let of_whole = match &whole.self_test {
        Some(test) => test.clone(),
        None => self_test(whole, options, progress)?,
    };
    let min_recall = recall(&of_whole) - points / 100.0;
    let bytes = veiloc_map::byte_count(whole);
    let (mut found, mut low, mut high) = (None, 0.0, bytes as f64);
    while high - low > SIZE_TOLERANCE * high {
        let size = if low > 0.0 { f64::midpoint(low, high) } else { high / FIRST_STEP };
        let sized =
            CompressOptions::new(size as u64).with_descriptors(compress_options.descriptors_per_point);
        let mut small = match compress(whole, &sized, progress) {
            Ok(small) => small,
            // This is the minimum size.
            Err(MappingError::TooSmall { least, .. }) => {
                low = least as f64;
                continue;
            }
            Err(error) => return Err(error),
        };
        let test = self_test_compressed(whole, &small, options, progress)?;
        // Written so that NaN fails.
        if recall(&test) >= min_recall {
            small.model.self_test = Some(test);
            high = size;
            found = Some(small);
        } else {
            low = size;
        }
    }
    Ok(found)
}

/// Mean over all schemes of the share of trusted images and the share of images within 1 % of the scale.
fn recall(test: &SelfTest) -> f64 {
    let of = |count: u32| f64::from(count) / f64::from(test.images.max(1));
    let sum: f64 = test.schemes.iter().map(|s| f64::midpoint(of(s.trusted), of(s.within_of_scale[1]))).sum();
    sum / test.schemes.len().max(1) as f64
}

/// Relative size difference at which the search ends.
const SIZE_TOLERANCE: f64 = 0.1;
/// Factor between the sizes of the first steps, until a map is too small.
const FIRST_STEP: f64 = 3.0;
