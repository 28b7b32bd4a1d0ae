//! Imports a complete COLMAP model as a map: its points and observations stay, descriptors are added.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use rayon::prelude::*;
use veiloc_geometry::{Pixel, PlanePoint};
use veiloc_map::colmap::{ColmapModel, ColmapPoint, ColmapPoint2d};
use veiloc_map::{MapModel, MapPoint, Observation};
use veiloc_protocol::ExtractionLimits;

use crate::build::diagnose::diagnose;
use crate::build::extract::{ExtractionResult, ExtractorPair, extract_each};
use crate::build::report::{MapWarning, warnings_about};
use crate::build::{append_images, profile};
use crate::coordinate_frames::{CoordinateFrameReport, compare_groups, refused};
use crate::error::MappingError;
use crate::input::bad_image::BadImage;
use crate::input::cache::ExtractedFeatures;
use crate::input::options::BuildOptions;
use crate::input::{Input, OnOtherCoordinateFrame};
use crate::progress::Progress;
use crate::triangulation::complete::Grid;

/// Result of an import.
#[derive(Debug)]
#[non_exhaustive]
pub struct ImportReport {
    /// Number of images in the map.
    pub images: usize,
    /// Images of the model that were left out because they are unusable.
    pub skipped: Vec<BadImage>,
    /// Points of the model.
    pub points: usize,
    /// Points in the map: those with detected keypoints near their observations in two or more images.
    pub points_kept: usize,
    /// Observations of the model.
    pub observations: usize,
    /// Observations of the model near a detected keypoint.
    pub observations_kept: usize,
    /// Mean reprojection error that the model's points state, pixels.
    pub stated_error_px: f64,
    /// The same, recomputed from poses, cameras and 2D points of the model.
    pub recomputed_error_px: f64,
    /// Share of points whose stated and recomputed errors differ by at most a hundredth of a pixel: 1 if COLMAP and
    /// veiloc agree on cameras and pixels. (COLMAP's older text models have six digits; COLMAP itself then reproduces
    /// the errors only to some thousandths of a pixel.)
    pub errors_equal: f64,
    /// Mean reprojection error of the map: detected keypoints against COLMAP's points, pixels.
    pub map_error_px: f64,
    /// Result of the comparison of groups of images with the rest; `None` if no group is linked weakly to it.
    pub coordinate_frame: Option<CoordinateFrameReport>,
    /// Reasons why the map may be unusable; empty if none was found.
    pub warnings: Vec<MapWarning>,
}

impl fmt::Display for ImportReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} images; {} of {} points kept, with {} of {} observations; reprojection error {:.3} px in the model, \
             {:.3} px recomputed (equal within 0.01 px for {:.1} % of points), {:.3} px in the map",
            self.images,
            self.points_kept,
            self.points,
            self.observations_kept,
            self.observations,
            self.stated_error_px,
            self.recomputed_error_px,
            100.0 * self.errors_equal,
            self.map_error_px,
        )
    }
}

/// Builds a map from a complete COLMAP model; `input` is made from the same model, and names the image folder.
///
/// A COLMAP model has no descriptors. Keypoints are extracted from the images, and each observation is assigned to the
/// nearest keypoint within 2 pixels (and to keypoints at the same position with other orientations). Positions of
/// points are COLMAP's. Points without such keypoints in two or more images are left out. All keypoints with a point
/// stay, and the strongest of the others up to the limit in
/// [`BuildSettings::extraction`](veiloc_map::BuildSettings::extraction).
///
/// # Errors
/// [`MappingError`]: a model without images, unusable images, no keypoints, no point with a keypoint near one of its
/// observations, or a group of images whose poses are in another coordinate frame than the rest ([`MappingError::OtherCoordinateFrame`],
/// unless [`Input::on_other_coordinate_frame`] accepts it; the points of the model cannot be aligned).
pub fn import(
    colmap: &ColmapModel,
    input: &Input<'_>,
    options: &BuildOptions,
    progress: &dyn Progress,
) -> Result<(MapModel, ImportReport), MappingError> {
    options.settings.check()?;
    let extractors = input.extractors().unwrap_or(&options.extractors);
    let extractor = extractors.named(&options.features)?;
    let checked = input.check(|_| false)?;
    let wanted = options.settings.extraction;
    let generous = ExtractionLimits { max_keypoints: MAX_KEYPOINTS, ..wanted };
    let extractor_pair = ExtractorPair { extractor, global: options.global.as_ref() };
    let ExtractionResult { images, features, skipped } =
        extract_each(checked, extractor_pair, generous, progress, |image, found| {
            let observed = colmap.image_by_name(&image.name).map_or(&[][..], |i| &i.points2d);
            let joined = join(observed, &found.keypoints);
            keep_strongest(found, joined, wanted.max_keypoints as usize)
        })?;
    let (features, joined): (Vec<ExtractedFeatures>, Vec<ObservationAssignment>) =
        features.into_iter().unzip();
    let profile = profile(&features, options, progress)?;
    let mut model = MapModel::empty(profile, options.settings);
    append_images(&mut model, &images, features)?;

    let mut tracks: BTreeMap<u64, Vec<Observation>> = BTreeMap::new();
    for (image, joined) in (0..).zip(&joined) {
        for &(point, keypoint) in &joined.keypoints {
            tracks.entry(point).or_default().push(Observation { image, keypoint });
        }
    }
    for point in colmap.points() {
        let Some(mut track) = tracks.remove(&point.id) else { continue };
        track.sort_unstable();
        // One image does not determine the depth of a point, so nothing would check its position.
        let images: BTreeSet<u32> = track.iter().map(|o| o.image).collect();
        if images.len() < MIN_IMAGES {
            continue;
        }
        model.points.push(MapPoint { position: point.position, error: 0.0, track });
    }
    measure(&mut model);
    model.link_keypoints();
    progress.finish();
    if model.points.is_empty() {
        return Err(MappingError::NothingImported { points: colmap.points().len() });
    }
    let mut report = report(colmap, &model, joined.iter().map(|j| j.observations).sum(), skipped);
    if input.other_coordinate_frame() != OnOtherCoordinateFrame::Accept {
        let (frame, groups) = compare_groups(&model, progress)?;
        if !groups.is_empty() {
            return Err(refused(groups));
        }
        report.warnings.extend(frame.iter().filter(|f| f.localized > 0).flat_map(MapWarning::of_frame));
        report.coordinate_frame = frame;
    }
    Ok((model, report))
}

/// Assignment of keypoints to points in an image.
struct ObservationAssignment {
    /// Point id and keypoint.
    keypoints: Vec<(u64, u32)>,
    /// Observations of the model that were assigned.
    observations: usize,
}

fn join(points2d: &[ColmapPoint2d], keypoints: &[[f32; 2]]) -> ObservationAssignment {
    let grid = Grid::new((0..).zip(keypoints.iter().copied()), MAX_DISTANCE_PX);
    let at = |k: u32| {
        let [u, v] = keypoints[k as usize];
        Pixel::new(f64::from(u), f64::from(v))
    };
    let mut pairs: Vec<(f64, u32, usize)> = Vec::new();
    for (index, observed) in points2d.iter().enumerate().filter(|(_, p)| p.point.is_some()) {
        for keypoint in grid.near(observed.pixel) {
            let distance = at(keypoint).distance(&observed.pixel);
            if distance <= MAX_DISTANCE_PX {
                pairs.push((distance, keypoint, index));
            }
        }
    }
    // The nearest first; a keypoint gets one point, and an observation is assigned to one position.
    pairs.sort_by(|x, y| x.0.total_cmp(&y.0).then((x.1, x.2).cmp(&(y.1, y.2))));
    let mut point_of: BTreeMap<u32, u64> = BTreeMap::new();
    let mut position_of: BTreeMap<usize, Pixel> = BTreeMap::new();
    // First a keypoint for each observation: several observations may share a position, with different orientations.
    for &(_, keypoint, index) in &pairs {
        let Some(point) = points2d[index].point else { continue };
        if let (Entry::Vacant(keypoint), Entry::Vacant(position)) =
            (point_of.entry(keypoint), position_of.entry(index))
        {
            position.insert(at(*keypoint.key()));
            keypoint.insert(point);
        }
    }
    // Then the free keypoints at the same positions.
    for (_, keypoint, index) in pairs {
        let (Some(point), Some(position)) = (points2d[index].point, position_of.get(&index)) else {
            continue;
        };
        if position.distance(&at(keypoint)) <= SAME_POSITION_PX {
            point_of.entry(keypoint).or_insert(point);
        }
    }
    ObservationAssignment {
        observations: position_of.len(),
        keypoints: point_of.into_iter().map(|(k, p)| (p, k)).collect(),
    }
}

/// Keeps all keypoints with a point, and the strongest others up to `limit` in total.
fn keep_strongest(
    found: ExtractedFeatures,
    mut joined: ObservationAssignment,
    limit: usize,
) -> (ExtractedFeatures, ObservationAssignment) {
    let mut keep = vec![false; found.keypoints.len()];
    for (_, keypoint) in &joined.keypoints {
        keep[*keypoint as usize] = true;
    }
    let mut room = limit.saturating_sub(joined.keypoints.len());
    for kept in &mut keep {
        if !*kept && room > 0 {
            (*kept, room) = (true, room - 1);
        }
    }
    let indices: Vec<usize> = (0..keep.len()).filter(|k| keep[*k]).collect();
    for (_, keypoint) in &mut joined.keypoints {
        let new = indices.binary_search(&(*keypoint as usize)).expect("every keypoint with a point is kept");
        *keypoint = new as u32;
    }
    let keypoints = indices.iter().map(|k| found.keypoints[*k]).collect();
    (
        ExtractedFeatures { keypoints, descriptors: found.descriptors.select(indices), global: found.global },
        joined,
    )
}

/// Mean reprojection error of each point over its track, in the images.
fn measure(model: &mut MapModel) {
    let MapModel { cameras, images, points, .. } = model;
    points.par_iter_mut().for_each(|point| {
        let errors = point.track.iter().map(|o| {
            let image = &images[o.image as usize];
            let [u, v] = image.keypoints[o.keypoint as usize];
            let projected = PlanePoint::from_camera_point(&image.cam_from_world.transform(&point.position));
            // A model may contain points behind their cameras; the image's size stands for an infinite error.
            projected.map_or(f64::from(cameras[image.camera].width), |p| {
                cameras[image.camera].project(p).distance(&Pixel::new(f64::from(u), f64::from(v)))
            })
        });
        point.error = errors.sum::<f64>() / point.track.len().max(1) as f64;
    });
}

/// Recomputes the mean reprojection error of a point of a COLMAP model from its poses, cameras and 2D points, pixels.
/// `None` if the point has no track or lies behind one of its cameras.
pub(crate) fn recomputed_error(colmap: &ColmapModel, point: &ColmapPoint) -> Option<f64> {
    let mut sum = 0.0;
    for (image, keypoint) in &point.track {
        let image = colmap.image_by_id(*image)?;
        let projected = PlanePoint::from_camera_point(&image.cam_from_world.transform(&point.position))?;
        let observed = image.points2d.get(*keypoint as usize)?;
        sum += colmap.camera_of(image).project(projected).distance(&observed.pixel);
    }
    (!point.track.is_empty()).then(|| sum / point.track.len() as f64)
}

fn report(
    colmap: &ColmapModel,
    model: &MapModel,
    observations_kept: usize,
    skipped: Vec<BadImage>,
) -> ImportReport {
    let points = colmap.points();
    let mut warnings = warnings_about(model);
    if !warnings.is_empty() {
        warnings.extend(diagnose(model));
    }
    let errors: Vec<(f64, f64)> =
        points.iter().filter_map(|p| Some((p.error, recomputed_error(colmap, p)?))).collect();
    let count = errors.len().max(1) as f64;
    let equal = errors.iter().filter(|(stated, own)| (stated - own).abs() <= 0.01).count();
    ImportReport {
        images: model.images.len(),
        skipped,
        points: points.len(),
        points_kept: model.points.len(),
        observations: points.iter().map(|p| p.track.len()).sum(),
        observations_kept,
        stated_error_px: errors.iter().map(|e| e.0).sum::<f64>() / count,
        recomputed_error_px: errors.iter().map(|e| e.1).sum::<f64>() / count,
        errors_equal: equal as f64 / count,
        map_error_px: model.mean_reprojection_error(),
        coordinate_frame: None,
        warnings,
    }
}

/// Maximum number of keypoints per image for the assignment.
const MAX_KEYPOINTS: u32 = 65_536;
/// Minimum number of images in which a point of the map has a keypoint.
const MIN_IMAGES: usize = 2;
/// Maximum distance of an observation and its keypoint.
const MAX_DISTANCE_PX: f64 = 2.0;
/// Closer keypoints are one position, detected with several orientations.
const SAME_POSITION_PX: f64 = 0.01;

#[cfg(test)]
mod tests {
    use super::*;

    /// Two points that share a pixel, each with a keypoint of another orientation: both keep their observation.
    #[test]
    fn each_observation_at_one_position_gets_a_keypoint() {
        let observed = |u, point| ColmapPoint2d { pixel: Pixel::new(u, 20.0), point: Some(point) };
        let keypoints = [[10.0, 20.0], [10.0, 20.0], [10.0, 20.0], [11.0, 20.0], [30.0, 20.0]];
        let joined = join(&[observed(10.0, 7), observed(10.0, 8), observed(31.5, 9)], &keypoints);
        assert_eq!(joined.observations, 3);
        let of = |point: u64| joined.keypoints.iter().filter(|(p, _)| *p == point).count();
        assert_eq!((of(7) + of(8), of(9)), (3, 1));
        assert!(of(7) > 0 && of(8) > 0);
    }
}
