//! Map compression: keeps the most useful points, each with a few of its descriptors.
//!
//! ```text
//! points ── those that cover the images best ── of each a few keypoints with diverse descriptors ── compressed map
//!                  until the bytes are used
//! ```
//!
//! Localization needs enough points in each retrieved image, spread over it. The gain of a point is therefore its
//! contribution to image parts with few points ([`choose`]), per byte; keypoints without a point are removed. Of the
//! keypoints of a point those with the most representative descriptors stay ([`represent`]).
//!
//! Positions stay the same up to the rounding of a packed file, and for each point the number of observing images and
//! the covariance are stored ([`WholeMapSummary`]): match weights are the same as in the whole map.

mod choose;
mod represent;

use std::collections::BTreeMap;

use veiloc_descriptor::Descriptors;
use veiloc_map::{MapFile, MapImage, MapModel, MapPoint, Observation, PointId, WholeMapSummary, byte_count};

use self::choose::choose;
use self::represent::represent;
use crate::error::MappingError;
use crate::progress::Progress;

/// Size of a compressed map.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct CompressOptions {
    /// Maximum size of the file in bytes.
    pub bytes: u64,
    /// Maximum number of descriptors per point. Default 3 (`docs/results/scale.md` has the table).
    pub descriptors_per_point: usize,
}

impl CompressOptions {
    /// Options for a file of at most this many bytes.
    pub const fn new(bytes: u64) -> Self {
        Self { bytes, descriptors_per_point: 3 }
    }

    /// Sets the maximum number of descriptors per point; at least one.
    #[must_use]
    pub fn with_descriptors(self, descriptors_per_point: usize) -> Self {
        Self { descriptors_per_point: descriptors_per_point.max(1), ..self }
    }
}

/// A compressed map.
#[derive(Debug, Clone, PartialEq)]
pub struct CompressedMap {
    /// The compressed map; it has no self-test yet.
    pub model: MapModel,
    /// `[P]`, the indices of its points in the whole map, ascending.
    pub kept_points: Vec<PointId>,
}

/// Compresses a map.
///
/// Images, poses, cameras, profile and global descriptors stay: queries sealed for the whole map are valid for the
/// compressed one. Images cannot be added or removed, because the necessary keypoints are gone. The result depends on
/// map and options only.
///
/// # Errors
/// [`MappingError::TooSmall`] if the images alone exceed the size, [`MappingError::Compressed`] if the map is already
/// compressed, and [`MappingError::Map`] if it is inconsistent.
pub fn compress(
    model: &MapModel,
    options: &CompressOptions,
    progress: &dyn Progress,
) -> Result<CompressedMap, MappingError> {
    refuse_compressed(model)?;
    let file = MapFile::of_model(model)?;
    let bare = byte_count(&without_points(model, file.byte_count())) + RESERVE;
    if bare >= options.bytes {
        return Err(MappingError::TooSmall { bytes: options.bytes, least: bare });
    }
    progress.start("Choosing points", 1);
    let limit = options.descriptors_per_point;
    let chosen = choose(model, limit, options.bytes - bare);
    progress.advance(1);
    progress.finish();
    let kept_of = represent(model, &chosen, limit, progress);
    let mut small = assemble(model, &file, &kept_of);
    small.pack()?;
    Ok(CompressedMap { model: small, kept_points: kept_of.into_keys().collect() })
}

/// Maximum size of section gaps and a self-test, bytes.
const RESERVE: u64 = 2048;

/// Refuses changes of a compressed map.
pub(crate) fn refuse_compressed(model: &MapModel) -> Result<(), MappingError> {
    if model.compressed.is_some() { Err(MappingError::Compressed) } else { Ok(()) }
}

/// Returns the map without points and keypoints: the minimum that compression cannot remove.
fn without_points(model: &MapModel, bytes: u64) -> MapModel {
    let images = model.images.iter().map(|image| MapImage {
        keypoints: Vec::new(),
        descriptors: Descriptors::empty(image.descriptors.kind()),
        point_of_keypoint: Vec::new(),
        ..image.clone()
    });
    MapModel {
        cameras: model.cameras.clone(),
        images: images.collect(),
        points: Vec::new(),
        settings: model.settings,
        profile: model.profile.clone(),
        self_test: None,
        down: model.down,
        is_metric: model.is_metric,
        alignment: model.alignment,
        compressed: Some(WholeMapSummary {
            bytes,
            keypoints: 0,
            points: model.points.len() as u64,
            of_points: Vec::new(),
            packed_from: Some([0.0; 3]),
        }),
        region: None,
    }
}

/// Assembles the map of these points and keypoints.
fn assemble(model: &MapModel, file: &MapFile, kept_of: &BTreeMap<PointId, Vec<Observation>>) -> MapModel {
    let mut small = without_points(model, file.byte_count());
    // New indices of the remaining keypoints, in the old order within each image.
    let mut remaining: Vec<Vec<u32>> = vec![Vec::new(); model.images.len()];
    for observation in kept_of.values().flatten() {
        remaining[observation.image as usize].push(observation.keypoint);
    }
    for ((image, whole), keypoints) in small.images.iter_mut().zip(&model.images).zip(&mut remaining) {
        keypoints.sort_unstable();
        image.keypoints = keypoints.iter().map(|k| whole.keypoints[*k as usize]).collect();
        image.descriptors = whole.descriptors.select(keypoints.iter().map(|k| *k as usize));
    }
    let moved = |o: &Observation| {
        let keypoint = remaining[o.image as usize].partition_point(|k| *k < o.keypoint) as u32;
        Observation { image: o.image, keypoint }
    };
    small.points = kept_of
        .iter()
        .map(|(id, track)| {
            let whole = &model.points[id.index()];
            MapPoint { track: track.iter().map(moved).collect(), ..whole.clone() }
        })
        .collect();
    small.link_keypoints();
    small.compressed = Some(WholeMapSummary::of(file, kept_of.keys().copied()));
    small
}
