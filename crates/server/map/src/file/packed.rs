//! The section of a packed map: the large arrays of a map, each with as few bits as it needs.
//!
//! A map that is not changed any more needs no exact keypoints, and derived data (tracks follow from the points of
//! the keypoints) need not be stored. `docs/reference/map-format.md` specifies each field.

use veiloc_descriptor::{Descriptors, GlobalDescriptor};
use veiloc_geometry::Intrinsics;
use veiloc_geometry::Point3;
use veiloc_geometry::frames::World;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use super::layout::{PackedKeypointRecord, PackedPointRecord, PackedRecord};
use crate::compressed::PointSummary;
use crate::model::{MapImage, MapModel, MapPoint, Observation, PointId};

/// Encodes the section of a compressed and packed model.
pub(super) fn encode(model: &MapModel, origin: [f64; 3], of_points: &[PointSummary]) -> Vec<u8> {
    let keypoints = model.images.iter().map(|i| i.keypoints.len() as u64).sum();
    let head = PackedRecord { origin, points: model.points.len() as u64, keypoints };
    let mut bytes = head.as_bytes().to_vec();
    for (point, summary) in model.points.iter().zip(of_points) {
        bytes.extend_from_slice(point_record(point, summary, &origin).as_bytes());
    }
    for image in &model.images {
        let side = longer_side(&model.cameras[image.camera]);
        for (at, point) in image.keypoints.iter().zip(&image.point_of_keypoint) {
            let record = PackedKeypointRecord {
                point: point.map_or(u32::MAX, |id| id.0),
                at: at.map(|c| packed_coordinate(c, side)),
            };
            bytes.extend_from_slice(record.as_bytes());
        }
    }
    model.images.iter().for_each(|image| bytes.extend(image.descriptors.packed()));
    model.images.iter().for_each(|image| bytes.push(u8::from(has_codes(&image.global))));
    for image in &model.images {
        let signs = image.global.to_signs();
        // The signs of all-zero codes carry no information.
        bytes.extend(if has_codes(&image.global) { signs } else { vec![0; signs.len()] });
    }
    bytes
}

/// Content of the section; names, cameras and poses of `images` come from other sections.
pub(super) struct Unpacked {
    /// Origin of positions.
    pub(super) origin: [f64; 3],
    pub(super) images: Vec<MapImage>,
    pub(super) points: Vec<MapPoint>,
    pub(super) of_points: Vec<PointSummary>,
}

/// Number of keypoints of the section.
pub(super) fn keypoint_count(bytes: &[u8]) -> Result<usize, String> {
    let (head, _) = head(bytes)?;
    usize::try_from(head.keypoints).map_err(|_| "more keypoints than memory".to_owned())
}

/// Decodes the section; returns the reason if it is invalid.
///
/// `images` have no keypoints and descriptors yet; each comes with its number of keypoints.
pub(super) fn decode(
    bytes: &[u8],
    model: &MapModel,
    images: Vec<(MapImage, usize)>,
) -> Result<Unpacked, String> {
    let (head, mut rest) = head(bytes)?;
    let keypoints = keypoint_count(bytes)?;
    let count = usize::try_from(head.points).map_err(|_| "more points than memory".to_owned())?;
    if count >= u32::MAX as usize {
        return Err("more points than 32-bit numbers can count".to_owned());
    }
    let kind = model.profile.descriptor_kind();
    let codes = model.profile.global_model().global_len();
    let signs_len = GlobalDescriptor::signs_len(codes);
    let records: &[PackedPointRecord] = take(&mut rest, count)?;
    let keypoint_records: &[PackedKeypointRecord] = take(&mut rest, keypoints)?;
    let rows: &[u8] = take(&mut rest, keypoints.saturating_mul(kind.packed_len()))?;
    let has_global: &[u8] = take(&mut rest, images.len())?;
    let signs: &[u8] = take(&mut rest, images.len().saturating_mul(signs_len))?;
    if !rest.is_empty() {
        return Err("bytes behind its last record".to_owned());
    }

    let mut points: Vec<MapPoint> = records.iter().map(|r| r.point(&head.origin)).collect();
    let of_points = records.iter().map(PackedPointRecord::point_summary).collect();
    let (mut start, mut whole) = (0, Vec::with_capacity(images.len()));
    for (index, (image, count)) in images.into_iter().enumerate() {
        let own = start..start + count;
        start += count;
        let side = longer_side(&model.cameras[image.camera]);
        let mut links = Vec::with_capacity(count);
        for (keypoint, record) in (0_u32..).zip(&keypoint_records[own.clone()]) {
            let Some(point) = points.get_mut(record.point as usize) else {
                return Err(format!("keypoint {keypoint} of image {index} sees no point of the map"));
            };
            point.track.push(Observation { image: index as u32, keypoint });
            links.push(Some(PointId(record.point)));
        }
        let rows = &rows[own.start * kind.packed_len()..own.end * kind.packed_len()];
        let global = match has_global[index] {
            0 => Some(GlobalDescriptor::new(vec![0; codes])),
            1 => GlobalDescriptor::from_signs(&signs[index * signs_len..][..signs_len], codes),
            _ => None,
        };
        whole.push(MapImage {
            keypoints: keypoint_records[own].iter().map(|s| s.at.map(|c| coordinate(c, side))).collect(),
            descriptors: Descriptors::from_packed(kind, rows).map_err(|e| e.to_string())?,
            global: global.ok_or_else(|| format!("image {index} has no possible global descriptor"))?,
            point_of_keypoint: links,
            ..image
        });
    }
    Ok(Unpacked { origin: head.origin, images: whole, points, of_points })
}

fn head(bytes: &[u8]) -> Result<(PackedRecord, &[u8]), String> {
    PackedRecord::read_from_prefix(bytes).map_err(|_| "shorter than its first record".to_owned())
}

/// Splits `count` records off the front of the bytes.
fn take<'a, T: FromBytes + Immutable + KnownLayout>(
    bytes: &mut &'a [u8],
    count: usize,
) -> Result<&'a [T], String> {
    let length = count.checked_mul(size_of::<T>()).filter(|length| *length <= bytes.len());
    let (own, rest) = bytes.split_at(length.ok_or("fewer records than announced")?);
    *bytes = rest;
    <[T]>::ref_from_bytes(own).map_err(|_| "not whole records".to_owned())
}

/// Whether an image has a global descriptor.
fn has_codes(global: &GlobalDescriptor) -> bool {
    global.as_codes().iter().any(|code| *code != 0)
}

fn point_record(point: &MapPoint, summary: &PointSummary, origin: &[f64; 3]) -> PackedPointRecord {
    let [x, y, z]: [f64; 3] = point.position.coords.into();
    let (log_sds, correlations) = packed_covariance(summary);
    PackedPointRecord {
        position: [x - origin[0], y - origin[1], z - origin[2]].map(|c| c as f32),
        error: (point.error * ERROR_STEPS).round().clamp(0.0, f64::from(u16::MAX)) as u16,
        seen_by: summary.seen_by.min(u16::MAX.into()) as u16,
        log_sds,
        correlations,
    }
}

impl PackedPointRecord {
    /// The point, still without observations.
    fn point(&self, origin: &[f64; 3]) -> MapPoint {
        let [x, y, z] = self.position.map(f64::from);
        MapPoint {
            position: Point3::<World>::new(origin[0] + x, origin[1] + y, origin[2] + z),
            track: Vec::new(),
            error: f64::from(self.error) / ERROR_STEPS,
        }
    }

    fn point_summary(&self) -> PointSummary {
        let sd = self.log_sds.map(|step| (f64::from(step) * LOG_STEP + SMALLEST_LOG_SD).exp());
        let [xy, xz, yz] = self.correlations.map(|c| f64::from(c) / CORRELATION_STEPS);
        let [xx, yy, zz] = [0, 1, 2].map(|i| (sd[i] * sd[i]) as f32);
        let of = |r: f64, i: usize, j: usize| (r * sd[i] * sd[j]) as f32;
        let covariance = [xx, of(xy, 0, 1), of(xz, 0, 2), yy, of(yz, 1, 2), zz];
        PointSummary { seen_by: self.seen_by.into(), covariance }
    }
}

/// Logarithms of the standard deviations, and the correlations; the correlations are shrunk slightly if rounding
/// would make the matrix indefinite.
fn packed_covariance(summary: &PointSummary) -> ([u16; 3], [i16; 3]) {
    let c = summary.covariance();
    let sd = [0, 1, 2].map(|i| c[i][i].max(0.0).sqrt());
    let log =
        |sd: f64| ((sd.ln() - SMALLEST_LOG_SD) / LOG_STEP).round().clamp(0.0, f64::from(u16::MAX)) as u16;
    let correlation = |i: usize, j: usize| c[i][j] / (sd[i] * sd[j]);
    let exact = [correlation(0, 1), correlation(0, 2), correlation(1, 2)];
    let log_sds = sd.map(log);
    let packed = |shrunk: f64| {
        exact.map(|r| {
            (r * shrunk * CORRELATION_STEPS).round().clamp(-CORRELATION_STEPS, CORRELATION_STEPS) as i16
        })
    };
    // Each step shrinks about three times more than rounding can add; the last step has no correlations.
    let holds = |correlations: &[i16; 3]| {
        let record = PackedPointRecord {
            position: [0.0; 3],
            error: 0,
            seen_by: 0,
            log_sds,
            correlations: *correlations,
        };
        record.point_summary().is_covariance()
    };
    let tries = (0..12).map(|n| packed(1.0 - SHRINKING * f64::from((1 << n) - 1)));
    (log_sds, tries.into_iter().find(holds).unwrap_or([0; 3]))
}

fn longer_side(camera: &Intrinsics) -> f32 {
    camera.width.max(camera.height).max(1) as f32
}

/// Quantizes a coordinate, pixels, over a range from a quarter of the longer side before the image to a quarter
/// behind it.
fn packed_coordinate(coordinate: f32, side: f32) -> u16 {
    ((coordinate / side + BEFORE) * (f32::from(u16::MAX) / RANGE)).round().clamp(0.0, f32::from(u16::MAX))
        as u16
}

fn coordinate(packed: u16, side: f32) -> f32 {
    (f32::from(packed) * (RANGE / f32::from(u16::MAX)) - BEFORE) * side
}

/// Steps of a reprojection error per pixel.
const ERROR_STEPS: f64 = 4096.0;
/// Logarithm of the smallest standard deviation of a position, map units.
const SMALLEST_LOG_SD: f64 = -35.0;
/// Step of the logarithm: a tenth of a percent.
const LOG_STEP: f64 = 70.0 / 65535.0;
/// Steps of a correlation from 0 to 1.
const CORRELATION_STEPS: f64 = 32767.0;
/// Shrinkage of correlations in the first attempt after the exact one.
const SHRINKING: f64 = 1e-4;
/// Margin before the image, in longer sides.
const BEFORE: f32 = 0.25;
/// Total range of coordinates, in longer sides.
const RANGE: f32 = 1.5;
