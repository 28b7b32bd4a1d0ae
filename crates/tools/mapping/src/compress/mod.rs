//! A map made small: the points that help most, each with a few of its descriptors.
//!
//! ```text
//! points ── those that cover the images best ── of each a few keypoints, as unlike as its descriptors are ── small map
//!                  until the bytes are spent
//! ```
//! What a query is localized by is that enough points are found in each retrieved image, spread over it. So a point is worth
//! what it adds to the parts of images that have few yet ([`choose`]), by the bytes it takes; keypoints that see no point
//! go. Of the keypoints of a point those stay whose descriptors stand best for all of them ([`represent`]).
//!
//! Positions stay as they are, up to the rounding of a packed file, and of each point the number of images that saw it and its covariance are remembered
//! ([`Compressed`]): a small map believes a match as much as the whole one does.

mod choose;
mod represent;

use std::collections::BTreeMap;

use veiloc_descriptor::Descriptors;
use veiloc_map::{Compressed, MapFile, MapImage, MapModel, MapPoint, Observation, PointId, byte_count};

use self::choose::choose;
use self::represent::represent;
use crate::error::MappingError;
use crate::progress::Progress;

/// How small a map is to be.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct CompressOptions {
    /// Bytes of the file, at most.
    pub bytes: u64,
    /// Descriptors that a point keeps, at most. Default 3 (`docs/results/scale.md` has the table).
    pub descriptors_per_point: usize,
}

impl CompressOptions {
    /// A file of at most so many bytes.
    pub const fn new(bytes: u64) -> Self {
        Self { bytes, descriptors_per_point: 3 }
    }

    /// With at most so many descriptors a point; at least one.
    #[must_use]
    pub fn with_descriptors(self, descriptors_per_point: usize) -> Self {
        Self { descriptors_per_point: descriptors_per_point.max(1), ..self }
    }
}

/// A map that was made small.
#[derive(Debug, Clone, PartialEq)]
pub struct Compression {
    /// The small map; it has no self-test yet.
    pub model: MapModel,
    /// `[P]`, which points of the whole map its points are, in rising order.
    pub kept: Vec<PointId>,
}

/// Makes a map small.
///
/// Images, poses, cameras, profile and global descriptors stay: queries sealed for the whole map fit the small one. Images
/// can neither join nor leave it: keypoints that would be needed are gone. The result depends on map and options alone.
///
/// # Errors
/// [`MappingError::TooSmall`] when the images alone take more bytes, [`MappingError::Compressed`] when the map was made small
/// before, and [`MappingError::Map`] when it does not hold together.
pub fn compress(
    model: &MapModel,
    options: &CompressOptions,
    progress: &dyn Progress,
) -> Result<Compression, MappingError> {
    refuse_compressed(model)?;
    let file = MapFile::of_model(model)?;
    let bare = byte_count(&emptied(model, file.byte_count())) + RESERVE;
    if bare >= options.bytes {
        return Err(MappingError::TooSmall { bytes: options.bytes, least: bare });
    }
    progress.start("Choosing points", 1);
    let most = options.descriptors_per_point;
    let chosen = choose(model, most, options.bytes - bare);
    progress.advance(1);
    progress.finish();
    let kept_of = represent(model, &chosen, most, progress);
    let mut small = assemble(model, &file, &kept_of);
    small.pack()?;
    Ok(Compression { model: small, kept: kept_of.into_keys().collect() })
}

/// What gaps between sections and a self-test take, bytes at most.
const RESERVE: u64 = 2048;

/// Compressed maps change no more.
pub(crate) fn refuse_compressed(model: &MapModel) -> Result<(), MappingError> {
    if model.compressed.is_some() { Err(MappingError::Compressed) } else { Ok(()) }
}

/// The map without any point or keypoint: what no compression saves.
fn emptied(model: &MapModel, bytes: u64) -> MapModel {
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
        compressed: Some(Compressed {
            bytes,
            keypoints: 0,
            points: model.points.len() as u64,
            of_points: Vec::new(),
            packed_from: Some([0.0; 3]),
        }),
        region: None,
    }
}

/// The map of these points and keypoints alone.
fn assemble(model: &MapModel, file: &MapFile, kept_of: &BTreeMap<PointId, Vec<Observation>>) -> MapModel {
    let mut small = emptied(model, file.byte_count());
    // New indices of the keypoints that stay: those of an image in the order that they had.
    let mut staying: Vec<Vec<u32>> = vec![Vec::new(); model.images.len()];
    for observation in kept_of.values().flatten() {
        staying[observation.image as usize].push(observation.keypoint);
    }
    for ((image, whole), keypoints) in small.images.iter_mut().zip(&model.images).zip(&mut staying) {
        keypoints.sort_unstable();
        image.keypoints = keypoints.iter().map(|k| whole.keypoints[*k as usize]).collect();
        image.descriptors = whole.descriptors.select(keypoints.iter().map(|k| *k as usize));
    }
    let moved = |o: &Observation| {
        let keypoint = staying[o.image as usize].partition_point(|k| *k < o.keypoint) as u32;
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
    small.compressed = Some(Compressed::of(file, kept_of.keys().copied()));
    small
}
