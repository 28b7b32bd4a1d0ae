//! Aligns a map to another world frame: metres, north, gravity, or the coordinate frame of another map.
//!
//! - [`align_to_positions`]: the similarity that fits known positions of images or points; robust against wrong ones.
//! - [`read_positions`]: such positions from a file. [`gps_positions`]: from GPS in the EXIF of the images.
//! - [`align_to_map`]: the similarity to another map of the same place, by localizing this map's images in it.
//! - [`level`]: the rotation that makes gravity −z.
//! - [`transform`]: applies a similarity to a map.

mod gps;
mod positions;

use veiloc_geometry::nalgebra::{DMatrix, Matrix3, Rotation3, UnitQuaternion, Vector3};
use veiloc_map::{GravityDirection, MapModel};

pub use self::gps::gps_positions;
pub use self::positions::read_positions;
use crate::compress::refuse_compressed;
use crate::coordinate_frames::OtherCoordinateFrame;
use crate::coordinate_frames::{MAX_TESTED, Similarity3, common_coordinate_frame};
use crate::error::MappingError;
use crate::progress::Progress;

/// A position in a map, and where it is known to be.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownPosition {
    /// What it is, for people: the name of an image, or the line of a file.
    pub name: String,
    /// The position in the map, map units.
    pub in_map: Vector3<f64>,
    /// The position in the new coordinate frame.
    pub known: Vector3<f64>,
}

/// The fit of a similarity to known positions.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Alignment {
    /// `x_new = s R x_map + t`.
    pub new_from_map: Similarity3,
    /// Distance between the transformed and the known position, new units, in the order of the input.
    pub residuals: Vec<f64>,
    /// Whether the position was used: its distance is not far above the usual one.
    pub used: Vec<bool>,
    /// Root mean square of the distances that were used, new units.
    pub rms: f64,
}

/// Fits a similarity to at least three known positions.
///
/// Of many samples of three positions, the similarity with the least median distance selects the positions whose distance
/// is at most 2.5 standard deviations; a closed form (Umeyama, PAMI 1991) fits these. Up to half of the positions may be wrong,
/// if there are five or more.
///
/// # Errors
/// [`MappingError::Alignment`]: fewer than three positions, or all of them on one line.
pub fn align_to_positions(positions: &[KnownPosition]) -> Result<Alignment, MappingError> {
    let refuse = |reason: &str| Err(MappingError::Alignment { reason: reason.to_owned() });
    if positions.len() < 3 {
        return refuse("three known positions are needed, and more are better");
    }
    let all: Vec<(Vector3<f64>, Vector3<f64>)> = positions.iter().map(|p| (p.in_map, p.known)).collect();
    if shape(all.iter().map(|pair| pair.0)) < MIN_SHAPE || shape(all.iter().map(|pair| pair.1)) < MIN_SHAPE {
        return refuse(
            "the known positions lie on a line, so the rotation about it is not determined; add a position beside it",
        );
    }
    let distances = |similarity: &Similarity3| -> Vec<f64> {
        all.iter().map(|(x, y)| (similarity.transform(x) - y).norm()).collect()
    };
    let mut best: Option<(f64, Similarity3)> = None;
    for sample in samples(all.len()) {
        let Some(found) = closed_form(&sample.map(|i| all[i])) else { continue };
        let median = crate::coordinate_frames::median(distances(&found));
        if best.is_none_or(|(least, _)| median < least) {
            best = Some((median, found));
        }
    }
    let Some((median, start)) = best else {
        return refuse(
            "no three of the known positions determine a rotation; add positions that are not on a line",
        );
    };
    // 1.4826 makes the median of absolute errors a standard deviation; n / (n - 2) corrects for few positions.
    let extent = all.iter().map(|(_, y)| y.norm()).fold(0.0, f64::max);
    let sd = 1.4826 * median * (1.0 + 5.0 / all.len() as f64);
    let limit = (2.5 * sd).max(1e-9 * extent);
    let used: Vec<bool> = distances(&start).iter().map(|distance| *distance <= limit).collect();
    let kept: Vec<_> = all.iter().zip(&used).filter(|(_, used)| **used).map(|(pair, _)| *pair).collect();
    let new_from_map = closed_form(&kept).unwrap_or(start);
    let residuals = distances(&new_from_map);
    let squares: f64 = residuals.iter().zip(&used).filter(|(_, used)| **used).map(|(r, _)| r * r).sum();
    let rms = (squares / kept.len().max(1) as f64).sqrt();
    Ok(Alignment { new_from_map, residuals, used, rms })
}

/// Umeyama's closed form; `None` if the positions lie on a line.
fn closed_form(pairs: &[(Vector3<f64>, Vector3<f64>)]) -> Option<Similarity3> {
    if shape(pairs.iter().map(|pair| pair.0)) < MIN_SHAPE {
        return None;
    }
    let count = pairs.len() as f64;
    let (mean_x, mean_y) =
        pairs.iter().fold((Vector3::zeros(), Vector3::zeros()), |(x, y), pair| (x + pair.0, y + pair.1));
    let (mean_x, mean_y) = (mean_x / count, mean_y / count);
    let (mut covariance, mut spread) = (Matrix3::zeros(), 0.0);
    for (x, y) in pairs {
        covariance += (y - mean_y) * (x - mean_x).transpose();
        spread += (x - mean_x).norm_squared();
    }
    let svd = covariance.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let sign = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    let rotation = Rotation3::from_matrix_unchecked(u * sign * v_t);
    let scale = (rotation.matrix().transpose() * covariance).trace() / spread;
    let found = Similarity3 { scale, rotation, translation: mean_y - scale * (rotation * mean_x) };
    (scale.is_finite() && scale > 0.0).then_some(found)
}

/// How far positions are from a line: the second over the first singular value of their spread.
fn shape(positions: impl Iterator<Item = Vector3<f64>>) -> f64 {
    let positions: Vec<Vector3<f64>> = positions.collect();
    let mean = positions.iter().sum::<Vector3<f64>>() / positions.len().max(1) as f64;
    let rows =
        DMatrix::from_fn(positions.len().max(3), 3, |i, j| positions.get(i).map_or(0.0, |p| p[j] - mean[j]));
    let mut values: Vec<f64> = rows.singular_values().iter().copied().collect();
    values.sort_by(|a, b| b.total_cmp(a));
    if values[0] > 0.0 { values[1] / values[0] } else { 0.0 }
}

/// Samples of three positions: all of few, or evenly spread ones of many.
fn samples(count: usize) -> Vec<[usize; 3]> {
    let all = |i: usize| (i + 1..count).flat_map(move |j| (j + 1..count).map(move |k| [i, j, k]));
    let total = count * (count - 1) * (count - 2) / 6;
    let step = total.div_ceil(MAX_SAMPLES).max(1);
    (0..count).flat_map(all).step_by(step).collect()
}

/// The similarity from a map's coordinate frame to that of another map of the same place, by localizing its images in the other.
///
/// # Errors
/// [`MappingError::Alignment`]: fewer than three images are localized, or they do not agree on one similarity. Both maps
/// must have the same kind of descriptors.
pub fn align_to_map(
    model: &MapModel,
    reference: &MapModel,
    progress: &dyn Progress,
) -> Result<OtherCoordinateFrame, MappingError> {
    common_coordinate_frame(model, reference, MAX_TESTED, progress)
}

/// The rotation that makes the direction of gravity −z.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub struct Level {
    /// The rotation, as a similarity of scale 1.
    pub new_from_map: Similarity3,
    /// Median angle between the horizontal axes of the images and the horizontal plane, degrees; `None` if the direction
    /// was known.
    pub tilt_deg: Option<f64>,
}

/// The rotation that makes gravity −z: of the known direction, or else of the images, as photographs are mostly taken with a
/// level horizontal axis (the direction that is most orthogonal to all of these axes, on the side of the images' lower edges).
///
/// # Errors
/// [`MappingError::Alignment`]: the horizontal axes of the images lie on a line, so they do not determine a plane.
pub fn level(model: &MapModel, down: Option<GravityDirection>) -> Result<Level, MappingError> {
    let (down, tilt_deg) = if let Some(down) = down.or(model.down) {
        (Vector3::from(down.in_world()), None)
    } else {
        let axis = |row: usize| {
            model
                .images
                .iter()
                .map(move |image| image.cam_from_world.rotation().matrix().row(row).transpose())
        };
        let scatter: Matrix3<f64> = axis(0).map(|x| x * x.transpose()).sum();
        let eigen = scatter.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
        if eigen.eigenvalues[order[1]] < MIN_SHAPE * eigen.eigenvalues[order[2]] {
            return Err(MappingError::Alignment {
                reason:
                    "all images look in one direction, so they do not determine gravity; give it with --down"
                        .to_owned(),
            });
        }
        let found: Vector3<f64> = eigen.eigenvectors.column(order[0]).into_owned();
        let below: f64 = axis(1).map(|y| y.dot(&found)).sum();
        let down = if below < 0.0 { -found } else { found };
        let tilts = axis(0).map(|x| x.dot(&down).clamp(-1.0, 1.0).asin().to_degrees().abs());
        (down, Some(crate::coordinate_frames::median(tilts.collect())))
    };
    let rotation = UnitQuaternion::rotation_between(&down, &-Vector3::z())
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
    let new_from_map = Similarity3 { rotation: rotation.to_rotation_matrix(), ..Similarity3::identity() };
    Ok(Level { new_from_map, tilt_deg })
}

/// Applies a similarity to a map: its poses, its points and its direction of gravity. The self-test is removed, because it has
/// lengths in the old unit.
///
/// # Errors
/// [`MappingError::Compressed`]: a compressed map, or a region.
pub fn transform(model: &mut MapModel, new_from_map: &Similarity3) -> Result<(), MappingError> {
    refuse_compressed(model)?;
    for image in &mut model.images {
        image.cam_from_world = new_from_map.transform_pose(&image.cam_from_world);
    }
    for point in &mut model.points {
        point.position.coords = new_from_map.transform(&point.position.coords);
    }
    if let Some(down) = model.down {
        let turned = new_from_map.rotation * Vector3::from(down.in_world());
        model.down = GravityDirection::new(turned.into()).ok();
    }
    model.self_test = None;
    Ok(())
}

/// Second over first singular value of positions, below which they lie on a line.
const MIN_SHAPE: f64 = 0.02;
/// Samples of three positions, about.
const MAX_SAMPLES: usize = 2000;

#[cfg(test)]
mod tests {
    use super::*;

    fn other() -> Similarity3 {
        Similarity3 {
            scale: 2.3,
            rotation: Rotation3::from_scaled_axis(Vector3::new(0.1, 1.0, -0.2)),
            translation: Vector3::new(5.0, -3.0, 7.0),
        }
    }

    fn positions(count: usize, wrong: usize, noise: f64) -> Vec<KnownPosition> {
        (0..count)
            .map(|i| {
                let a = i as f64;
                let in_map = Vector3::new(a.sin() * 3.0, (1.7 * a).cos() * 2.0, (0.6 * a).sin());
                let off = if i < wrong {
                    Vector3::new(4.0 + a, -3.0, 2.0)
                } else {
                    noise * Vector3::new((5.0 * a).sin(), (7.0 * a).cos(), (3.0 * a).sin())
                };
                KnownPosition { name: i.to_string(), in_map, known: other().transform(&in_map) + off }
            })
            .collect()
    }

    #[test]
    fn similarity_of_known_positions_is_recovered_despite_wrong_ones() {
        for (count, wrong) in [(3, 0), (4, 0), (6, 1), (20, 8), (200, 80)] {
            let found = align_to_positions(&positions(count, wrong, 0.0)).expect("an alignment");
            assert!((found.new_from_map.scale - 2.3).abs() < 1e-9, "{count} {wrong}: {found:?}");
            assert!((found.new_from_map.translation - other().translation).norm() < 1e-8, "{count} {wrong}");
            assert_eq!(
                found.used.iter().filter(|used| !**used).count(),
                wrong,
                "{count}: {:?}",
                found.residuals
            );
            assert!(found.rms < 1e-8);
        }
        let noisy = align_to_positions(&positions(40, 8, 0.02)).expect("an alignment");
        assert!(
            (noisy.new_from_map.scale - 2.3).abs() < 0.02 && noisy.rms > 0.005 && noisy.rms < 0.05,
            "{noisy:?}"
        );
        assert!(noisy.used[..8].iter().all(|used| !used), "{:?}", noisy.used);
    }

    #[test]
    fn positions_that_determine_nothing_are_refused() {
        assert!(align_to_positions(&positions(2, 0, 0.0)).is_err());
        let line = (0..5).map(|i| {
            let x = Vector3::new(f64::from(i), 0.0, 0.0);
            KnownPosition { name: String::new(), in_map: x, known: x }
        });
        let error = align_to_positions(&line.collect::<Vec<_>>()).expect_err("refused").to_string();
        assert!(error.contains("on a line"), "{error}");
    }
}
