//! Checks that the poses of images are in the coordinate frame of a map, and transforms them if they are not.
//!
//! ```text
//! images with poses ── localized in the map without them ── given against localized pose ── agree
//!                                                                     │
//!                           consensus of at least three on one similarity ── another coordinate frame
//! ```
//!
//! A test that leaves out single images cannot detect a group in another coordinate frame: each of its images is supported by the
//! rest of the group.

mod consensus;
mod groups;
mod similarity;

use std::fmt;

use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use rayon::prelude::*;
use veiloc_localization::{LocalizeOptions, localize};
use veiloc_map::{MapFile, MapImage, MapModel};
use veiloc_protocol::Scheme;

pub use self::similarity::Similarity3;

pub(crate) use self::consensus::median;
use self::consensus::{Comparison, FoundCoordinateFrame, compare, most_agree};
use self::groups::weakly_linked;
use crate::calibration::query::{sealed, sealer_for, stored_features};
use crate::calibration::run::{evenly_spaced, scale};
use crate::error::MappingError;
use crate::progress::Progress;
use crate::triangulation::hold_out::drop_images;

/// A group of images whose poses are in another coordinate frame.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct OtherCoordinateFrame {
    /// Names of the images, in their order.
    pub names: Vec<String>,
    /// Number of images of the group that were localized in the map without them, with trusted poses that agree on the
    /// transform.
    pub localized: usize,
    /// The transform of the given poses to the coordinate frame of the map.
    pub map_from_given: Similarity3,
    /// Median distance between the given and the transformed camera centres, map units.
    pub distance: f64,
    /// Its standard deviation.
    pub distance_sd: f64,
    /// Standard deviation of the angle of the transform, degrees.
    pub angle_sd_deg: f64,
    /// Standard deviation of the scale of the transform; `None` if the camera centres are too few or too close to
    /// determine the scale, which is then 1.
    pub scale_sd: Option<f64>,
}

impl OtherCoordinateFrame {
    fn of(found: &FoundCoordinateFrame, model: &MapModel, images: &[usize]) -> Self {
        Self {
            names: images.iter().map(|image| model.images[*image].name.clone()).collect(),
            localized: found.members.len(),
            map_from_given: found.fit.map_from_given,
            distance: found.distance,
            distance_sd: found.distance_sd,
            angle_sd_deg: found.fit.rotation_sd_deg,
            scale_sd: found.fit.scale_sd,
        }
    }
}

impl fmt::Display for OtherCoordinateFrame {
    /// The group, and its distance from the map.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let similarity = &self.map_from_given;
        write!(
            f,
            "{} ({} localized): {:.3} ± {:.3} map units and {:.1} ± {:.1}° away",
            names_of(&self.names),
            self.localized,
            self.distance,
            self.distance_sd,
            similarity.angle_deg(),
            self.angle_sd_deg
        )?;
        match self.scale_sd {
            Some(sd) => write!(f, ", scale {:.3} ± {sd:.3}", similarity.scale),
            None => f.write_str(", scale not determined (taken as 1)"),
        }
    }
}

/// `a`, `a, b`, or `a to z (26 images)`.
fn names_of(names: &[String]) -> String {
    match names {
        [] => "no image".to_owned(),
        [first, .., last] if names.len() > 3 => format!("{first} to {last}, {} images", names.len()),
        few => few.join(", "),
    }
}

/// Result of the comparison of given poses with the coordinate frame of a map.
#[derive(Debug, Clone, Default, PartialEq)]
#[non_exhaustive]
pub struct CoordinateFrameReport {
    /// Number of images that were compared or should have been.
    pub tested: usize,
    /// Number of them that were localized in the map without them, with a trusted pose. The frame of the others could
    /// not be compared.
    pub localized: usize,
    /// Median distance between given and localized camera centres over the images that agree, map units.
    pub median_distance: f64,
    /// Names of images whose localized pose disagrees with the given one, without a common transform.
    pub disagreeing: Vec<String>,
    /// Names of images that agree on a coordinate frame that differs from the map's by more than their uncertainty, but too little
    /// to refuse them.
    pub near: Vec<String>,
    /// Groups whose poses were transformed.
    pub aligned: Vec<OtherCoordinateFrame>,
}

/// A map without the images that are compared with it.
pub(crate) struct ReferenceMap {
    file: MapFile,
    scale: f64,
}

impl ReferenceMap {
    /// `None` if nothing can be localized in the map: it has no images, or no points.
    pub(crate) fn of(model: &MapModel) -> Result<Option<Self>, MappingError> {
        if model.images.is_empty() || model.points.is_empty() {
            return Ok(None);
        }
        Ok(Some(Self { file: MapFile::of_model(model)?, scale: scale(model) }))
    }

    /// Localizes up to `limit` of these images of `model`, evenly spaced. The images have features, and may lack points. Returns
    /// how many were tested, and those that were localized.
    fn localized(
        &self,
        model: &MapModel,
        images: &[usize],
        limit: usize,
        progress: &dyn Progress,
    ) -> (usize, Vec<Comparison>) {
        let tested: Vec<usize> = evenly_spaced(images.len(), limit).into_iter().map(|i| images[i]).collect();
        progress.start("Comparing coordinate frames", tested.len());
        let localized = tested.par_iter().map(|image| {
            let comparison = self.localize(model, *image);
            progress.advance(1);
            comparison
        });
        let comparisons: Vec<Comparison> = localized.collect::<Vec<_>>().into_iter().flatten().collect();
        progress.finish();
        (tested.len(), comparisons)
    }

    /// Localizes images as [`Self::localized`], and compares the poses. Returns the report, and the groups in another coordinate
    /// frame with their images.
    pub(crate) fn compare(
        &self,
        model: &MapModel,
        images: &[usize],
        limit: usize,
        progress: &dyn Progress,
    ) -> (CoordinateFrameReport, Vec<Group>) {
        let (tested, comparisons) = self.localized(model, images, limit, progress);
        let compared = compare(&comparisons, self.scale);
        let name = |index: &usize| model.images[comparisons[*index].image].name.clone();
        let distances = compared.agreeing.iter().map(|i| comparisons[*i].distance());
        let report = CoordinateFrameReport {
            tested,
            localized: comparisons.len(),
            median_distance: median(distances.collect()),
            disagreeing: compared.disagreeing.iter().map(name).collect(),
            near: compared.near.iter().map(name).collect(),
            aligned: Vec::new(),
        };
        let group_of = groups(model, images, &comparisons, &compared.agreeing, &compared.frames);
        let other = |(index, found): (usize, &FoundCoordinateFrame)| {
            let own = images.iter().zip(&group_of).filter(|(_, group)| **group == Some(index));
            let own: Vec<usize> = own.map(|(image, _)| *image).collect();
            let frame = OtherCoordinateFrame::of(found, model, &own);
            Group { images: own, coordinate_frame: frame }
        };
        (report, compared.frames.iter().enumerate().map(other).collect())
    }

    /// `None` without a trusted pose.
    fn localize(&self, model: &MapModel, index: usize) -> Option<Comparison> {
        let image: &MapImage = &model.images[index];
        let sealer = sealer_for(Scheme::Points, &model.profile).ok()?;
        let extracted = stored_features(model, image, &sealer);
        let mut rng = ChaCha20Rng::seed_from_u64(index as u64);
        let query = sealed(&sealer, extracted, &mut rng).ok()?;
        let found = localize(&query, &self.file, &LocalizeOptions::default()).ok()?;
        if !found.confidence.is_trusted() {
            return None;
        }
        Comparison::new(index, image.cam_from_world, found.cam_from_world, &found.covariance, self.scale)
    }
}

/// Images of a model whose poses are in another coordinate frame.
#[derive(Debug, Clone)]
pub(crate) struct Group {
    /// Their indices.
    pub(crate) images: Vec<usize>,
    pub(crate) coordinate_frame: OtherCoordinateFrame,
}

impl Group {
    /// Transforms the poses of the images.
    pub(crate) fn align(&self, model: &mut MapModel) {
        for index in &self.images {
            let pose = &mut model.images[*index].cam_from_world;
            *pose = self.coordinate_frame.map_from_given.transform_pose(pose);
        }
    }
}

/// Returns the error for these groups.
pub(crate) fn refused(groups: Vec<Group>) -> MappingError {
    MappingError::OtherCoordinateFrame {
        groups: groups.into_iter().map(|group| group.coordinate_frame.to_string()).collect(),
    }
}

/// Index of the frame of each image, `None` for the map's: that of the compared image that is nearest in the order of
/// names, first of the same folder.
fn groups(
    model: &MapModel,
    images: &[usize],
    comparisons: &[Comparison],
    agreeing: &[usize],
    frames: &[FoundCoordinateFrame],
) -> Vec<Option<usize>> {
    let name = |image: usize| model.images[image].name.as_str();
    let mut ranked: Vec<usize> = images.to_vec();
    ranked.sort_by_key(|image| name(*image));
    let rank = |image: usize| ranked.iter().position(|other| *other == image).unwrap_or(0);
    let folder = |image: usize| name(image).rsplit_once('/').map_or("", |(folder, _)| folder);
    let members = frames.iter().enumerate().flat_map(|(g, f)| f.members.iter().map(move |m| (*m, Some(g))));
    let known: Vec<(usize, usize, Option<usize>)> = agreeing
        .iter()
        .map(|m| (*m, None))
        .chain(members)
        .map(|(m, group)| (comparisons[m].image, rank(comparisons[m].image), group))
        .collect();
    images
        .iter()
        .map(|image| {
            let own = rank(*image);
            let distance =
                |other: usize, rank: usize| (folder(other) != folder(*image), rank.abs_diff(own), rank);
            known.iter().min_by_key(|(other, rank, _)| distance(*other, *rank)).and_then(|known| known.2)
        })
        .collect()
}

/// Finds groups of images of a map whose poses are in another coordinate frame than the rest: each group that shares few points
/// with the rest is localized in the map without it. Returns `None` for the report if there is no such group.
pub(crate) fn compare_groups(
    model: &MapModel,
    progress: &dyn Progress,
) -> Result<(Option<CoordinateFrameReport>, Vec<Group>), MappingError> {
    let mut total: Option<CoordinateFrameReport> = None;
    let mut found: Vec<Group> = Vec::new();
    for linked in weakly_linked(model, MIN_GROUP, MAX_LINK_RATIO).into_iter().take(MAX_GROUPS) {
        // A part of a group in another coordinate frame, or a group with such a part, is not compared again.
        if found.iter().any(|other| other.images.iter().any(|image| linked.images.contains(image))) {
            continue;
        }
        let mut rest = model.clone();
        drop_images(&mut rest, &linked.images.iter().map(|image| *image as u32).collect());
        let Some(reference) = ReferenceMap::of(&rest)? else { continue };
        let compare = |limit: usize| reference.compare(model, &linked.images, limit, progress);
        let mut compared = compare(PROBES_OF_GROUP);
        if compared.0.localized > 0 && linked.images.len() > PROBES_OF_GROUP {
            compared = compare(MAX_TESTED_OF_GROUP);
        }
        let (report, groups) = compared;
        let sum = total.get_or_insert_default();
        sum.tested += report.tested;
        sum.localized += report.localized;
        sum.median_distance = sum.median_distance.max(report.median_distance);
        sum.near.extend(report.near);
        // Few images are the matter of the self-test, which leaves out one at a time.
        if report.disagreeing.len() >= MIN_GROUP {
            sum.disagreeing.extend(report.disagreeing);
        }
        found.extend(groups.into_iter().filter(|group| group.coordinate_frame.localized >= MIN_GROUP));
    }
    Ok((total, found))
}

/// The similarity from the coordinate frame of a map to that of another map, by localizing up to `limit` of its images in the other.
///
/// # Errors
/// [`MappingError::Alignment`]: other descriptors, fewer than three localized images, or no similarity on which more than
/// half of them agree.
pub(crate) fn common_coordinate_frame(
    model: &MapModel,
    reference: &MapModel,
    limit: usize,
    progress: &dyn Progress,
) -> Result<OtherCoordinateFrame, MappingError> {
    let refuse = |reason: String| Err(MappingError::Alignment { reason });
    let (in_reference, queries, images) = opened(model, reference)?;
    let (report, groups) = in_reference.compare(&queries, &images, limit, progress);
    let CoordinateFrameReport { tested, localized, .. } = report;
    let of_groups: usize = groups.iter().map(|group| group.coordinate_frame.localized).sum();
    let same = localized.saturating_sub(of_groups + report.disagreeing.len());
    if localized < MIN_GROUP {
        return refuse(too_few(localized, tested));
    }
    let identity = OtherCoordinateFrame {
        names: queries.images.iter().map(|image| image.name.clone()).collect(),
        localized: same,
        map_from_given: Similarity3::identity(),
        distance: 0.0,
        distance_sd: 0.0,
        angle_sd_deg: 0.0,
        scale_sd: None,
    };
    let frames = || groups.iter().map(|group| &group.coordinate_frame).chain([&identity]);
    match frames().max_by_key(|frame| frame.localized) {
        Some(best) if best.localized >= MIN_GROUP && 2 * best.localized > localized => Ok(best.clone()),
        _ => {
            let each: Vec<String> =
                frames().filter(|frame| frame.localized > 0).map(|frame| format!("\n  {frame}")).collect();
            refuse(format!(
                "{localized} of {tested} images of the one map are localized in the other, but they do not agree on one \
                 transform; a map may have parts in coordinate frames of their own, or the maps show places that look alike:{}",
                each.concat()
            ))
        }
    }
}

/// The similarity from the coordinate frame of a map to that of another map, as [`common_coordinate_frame`], also if it is so near to
/// the identity that images of both may be in one map: content that moves by it keeps less error.
///
/// # Errors
/// As [`common_coordinate_frame`].
pub(crate) fn similarity_between(
    model: &MapModel,
    reference: &MapModel,
    limit: usize,
    progress: &dyn Progress,
) -> Result<OtherCoordinateFrame, MappingError> {
    let (in_reference, queries, images) = opened(model, reference)?;
    let (tested, comparisons) = in_reference.localized(&queries, &images, limit, progress);
    let localized = comparisons.len();
    let found = most_agree(&comparisons).ok_or_else(|| {
        let reason = if localized < MIN_GROUP {
            too_few(localized, tested)
        } else {
            format!("{localized} of {tested} images of the one map are localized in the other, but less than half agree")
        };
        MappingError::Alignment { reason }
    })?;
    Ok(OtherCoordinateFrame::of(&found, &queries, &images))
}

/// The other map, and the images of a map as queries that are sealed for it.
fn opened(
    model: &MapModel,
    reference: &MapModel,
) -> Result<(ReferenceMap, MapModel, Vec<usize>), MappingError> {
    let refuse = |reason: String| Err(MappingError::Alignment { reason });
    let kinds = [model, reference].map(|map| map.profile.descriptor_kind());
    if kinds[0] != kinds[1] {
        let [own, other] = kinds.map(|kind| kind.name().to_owned());
        return refuse(format!(
            "one map has features {own}, the other {other}; build both with the same --features"
        ));
    }
    let Some(in_reference) = ReferenceMap::of(reference)? else {
        return refuse("nothing can be localized in the other map: it has no points".to_owned());
    };
    let queries = MapModel { profile: reference.profile.clone(), ..model.clone() };
    let images = (0..queries.images.len()).collect();
    Ok((in_reference, queries, images))
}

fn too_few(localized: usize, tested: usize) -> String {
    format!(
        "{localized} of {tested} images of the one map are localized in the other, and {MIN_GROUP} are needed; the maps must \
         show a common part"
    )
}

/// Maximum number of localized images of those that are added: as in a self-test.
pub(crate) const MAX_TESTED: usize = 50;
/// Images of a group that are localized first in a build. If none of them is found in the rest, the group probably is
/// of another place.
const PROBES_OF_GROUP: usize = 5;
/// Maximum number of localized images of a group in a build.
const MAX_TESTED_OF_GROUP: usize = 12;
/// Minimum number of images of a group in another coordinate frame.
const MIN_GROUP: usize = 3;
/// Groups that are compared, at most.
const MAX_GROUPS: usize = 8;
/// Strongest link of a compared group to the rest, over its median link. Of real places with groups of three and more:
/// in one coordinate frame 0.3 and more unless they hardly overlap (0.01 to 0.17 in a walk through rooms); moved by a
/// twentieth of the distance to the scene 0.04, by more 0 to 0.02.
const MAX_LINK_RATIO: f64 = 0.2;
