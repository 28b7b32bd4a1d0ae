//! Aligns a map to another world frame: metres, north, gravity, or the coordinate frame of another map.
//!
//! - [`align_to_positions`]: the similarity that fits known positions of images or points; robust against wrong ones, with its
//!   accuracy and with what speaks against it.
//! - [`read_positions`]: such positions from a file. [`gps_positions`]: from GPS in the EXIF of the images.
//! - [`align_to_map`]: the similarity to another map of the same place, by localizing this map's images in it.
//! - [`up_of_images`]: the up direction that the images show. [`level`]: the rotation that makes it `z`.
//! - [`transform`]: applies a similarity to a map. [`carry_anchors`]: the same for its content anchors; [`anchors_by_images`] and
//!   [`anchors_by_localizing`] find it for a map that replaces theirs.

mod anchors;
mod fault;
mod fit;
mod gps;
mod known;
mod level;
mod positions;

use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::rotation_to_z;
use veiloc_map::{AlignmentAccuracy, GravityDirection, MapModel};

pub use self::anchors::{AnchorTransform, anchors_by_images, anchors_by_localizing, carry_anchors};
use self::fault::Judge;
pub use self::fault::{AlignmentFault, implausible_metres};
use self::fit::{Errors, Fit, Pair, fit, residual};
pub use self::gps::gps_positions;
use self::known::counted;
pub use self::known::{KnownPosition, KnownPositions};
pub use self::level::{ImagesUp, MapUp, up_of_images};
pub use self::positions::read_positions;
use crate::compress::refuse_compressed;
use crate::coordinate_frames::OtherCoordinateFrame;
use crate::coordinate_frames::{MAX_TESTED, Similarity3, common_coordinate_frame, median};
use crate::error::MappingError;
use crate::progress::Progress;

/// The fit of a similarity to known positions.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Alignment {
    /// `x_new = s R x_map + t`.
    pub new_from_map: Similarity3,
    /// Distance between the transformed and the known position, new units, in the order of the input; without a height, along
    /// the ground.
    pub residuals: Vec<f64>,
    /// Whether the position was used: it repeats no other, and its distance is not far above the usual one.
    pub used: Vec<bool>,
    /// How many positions repeat others.
    pub repeated: usize,
    /// Root mean square of the distances that were used, new units.
    pub rms: f64,
    /// How well the new coordinate frame is known.
    pub accuracy: AlignmentAccuracy,
    /// Whether heights of the new coordinate frame are known.
    pub has_heights: bool,
    /// What speaks against the fit.
    pub faults: Vec<AlignmentFault>,
}

/// Least correlation of the errors of GPS fixes that follow each other.
const GPS_CORRELATION: f64 = 0.4;

/// Fits a similarity to known positions, and judges it.
///
/// `up` is the direction in the map; it is used if gravity is known in the new coordinate frame, too. Then two positions that do
/// not lie above each other are enough, and heights may be missing; otherwise three that are not on a line. Of many samples,
/// the similarity with the least median distance selects the positions whose distance is at most 2.5 standard deviations; least
/// squares fit these. Up to half of the positions may be wrong, if there are five or more.
///
/// # Errors
/// [`MappingError::Alignment`]: the positions determine no similarity. A fit that is not to be believed is no error here:
/// [`Alignment::faults`].
pub fn align_to_positions(known: &KnownPositions, up: Option<MapUp>) -> Result<Alignment, MappingError> {
    let positions = &known.positions;
    let refuse = |reason: String| Err(MappingError::Alignment { reason });
    let up_in_new = known.down.map(|down| -Vector3::from(down.in_world()));
    let both = up.filter(|_| up_in_new.is_some());
    let needed = if both.is_some() { 2 } else { 3 };
    let level = up_in_new.map_or_else(Rotation3::identity, |up| rotation_to_z(&up));
    let pair = |p: &KnownPosition| Pair {
        x: p.in_map,
        y: level * p.known,
        has_height: p.has_height,
        least_sd: p.sd.max(known.grid / 12.0_f64.sqrt()),
    };
    let all: Vec<Pair> = positions.iter().map(pair).collect();
    let has_vertical = up_in_new.is_some();
    let counted = counted(&all, has_vertical);
    let kept: Vec<usize> = (0..all.len()).filter(|&i| counted[i]).collect();
    if kept.len() < needed {
        let found = if kept.len() < all.len() {
            format!("{} of {} positions are different", kept.len(), all.len())
        } else {
            format!("{} are known", all.len())
        };
        return refuse(format!(
            "{needed} different known positions are needed, and more are better; {found}"
        ));
    }
    let pairs: Vec<Pair> = kept.iter().map(|&i| all[i]).collect();
    // Of GPS it is known before that the errors of fixes taken one after another are alike.
    let least_correlation = if known.origin.is_some() { GPS_CORRELATION } else { 0.0 };
    let errors = Errors { has_vertical, least_correlation };
    let Some(found) = fit(&pairs, both, errors) else {
        return refuse(if both.is_some() {
            "the known positions lie above each other, so the direction of north is not determined; add a position beside \
             them"
                .to_owned()
        } else {
            "the known positions lie on a line, so the rotation about it is not determined; add a position beside it, or \
             give the direction of gravity in the map with --down"
                .to_owned()
        });
    };
    let faults = Judge { known, pairs: &pairs, found: &found, up: both, errors }.faults();
    let back = level.inverse();
    let new_from_map = Similarity3 {
        scale: found.similarity.scale,
        rotation: back * found.similarity.rotation,
        translation: back * found.similarity.translation,
    };
    let mut used = vec![false; all.len()];
    kept.iter().zip(&found.used).for_each(|(&i, is_used)| used[i] = *is_used);
    Ok(Alignment {
        residuals: all.iter().map(|pair| residual(pair, &found.similarity).norm()).collect(),
        repeated: all.len() - kept.len(),
        rms: found.rms,
        accuracy: accuracy(known, &pairs, &found, &new_from_map),
        has_heights: known.has_heights
            && pairs.iter().zip(&found.used).any(|(pair, used)| *used && pair.has_height),
        new_from_map,
        used,
        faults,
    })
}

/// The covariance of a fit as standard deviations. Errors of fixes that are taken one after another are alike, so the mean of many
/// is no better than what their source says of one.
fn accuracy(
    known: &KnownPositions,
    pairs: &[Pair],
    found: &Fit,
    new_from_map: &Similarity3,
) -> AlignmentAccuracy {
    let variance = |k: usize| found.covariance[(k, k)];
    let said = median(pairs.iter().map(|pair| pair.least_sd).collect());
    let common = if known.origin.is_some() { said.max(found.rms / 3.0_f64.sqrt()) } else { said };
    let has_heights = pairs.iter().zip(&found.used).any(|(pair, used)| *used && pair.has_height);
    let axes = if has_heights { 4..7 } else { 4..6 };
    let position = axes.map(|k| variance(k) + common * common).sum::<f64>();
    AlignmentAccuracy {
        scale: variance(0).sqrt(),
        tilt_deg: (variance(1) + variance(2)).sqrt().to_degrees(),
        heading_deg: variance(3).sqrt().to_degrees(),
        position: position.sqrt(),
        center: new_from_map.transform(&found.center).into(),
    }
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

/// How well the coordinate frame of a map is known that was aligned to another map: by the fit, and by what is known of the other.
pub fn accuracy_in_map(
    model: &MapModel,
    frame: &OtherCoordinateFrame,
    reference: Option<AlignmentAccuracy>,
) -> AlignmentAccuracy {
    let count = model.images.len().max(1) as f64;
    let centers = model.images.iter().map(|image| image.cam_from_world.center().coords);
    let own = AlignmentAccuracy {
        // Without one, all of the scale is guessed.
        scale: frame.scale_sd.map_or(1.0, |sd| sd / frame.map_from_given.scale),
        tilt_deg: frame.angle_sd_deg * (2.0_f64 / 3.0).sqrt(),
        heading_deg: frame.angle_sd_deg / 3.0_f64.sqrt(),
        position: frame.distance_sd * 3.0_f64.sqrt(),
        center: frame.map_from_given.transform(&(centers.sum::<Vector3<f64>>() / count)).into(),
    };
    reference.map_or(own, |reference| own.and(reference))
}

/// What speaks against a fit to another map.
pub fn faults_in_map(
    model: &MapModel,
    frame: &OtherCoordinateFrame,
    reference: &MapModel,
) -> Vec<AlignmentFault> {
    let scale = AlignmentFault::of_scale(accuracy_in_map(model, frame, None).scale);
    let up = model.down.zip(reference.down).and_then(|(own, other)| {
        let rotated = frame.map_from_given.rotation * Vector3::from(own.in_world());
        AlignmentFault::of_gravity(rotated.angle(&Vector3::from(other.in_world())).to_degrees())
    });
    scale.into_iter().chain(up).collect()
}

/// The rotation that makes an up direction `z`.
pub fn level(up: &Vector3<f64>) -> Similarity3 {
    Similarity3 { rotation: rotation_to_z(up), ..Similarity3::identity() }
}

/// Applies a similarity to a map: its poses, its points and its direction of gravity. The self-test and the accuracy of the alignment
/// are removed, because they are those of the old frame.
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
    (model.self_test, model.alignment) = (None, None);
    Ok(())
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn other() -> Similarity3 {
        Similarity3 {
            scale: 2.3,
            rotation: Rotation3::from_scaled_axis(Vector3::new(0.1, 1.0, -0.2)),
            translation: Vector3::new(5.0, -3.0, 7.0),
        }
    }

    /// In a frame of which no axis is up.
    fn known(count: usize, wrong: usize, noise: f64) -> KnownPositions {
        let of = |i: usize| {
            let a = i as f64;
            let in_map = Vector3::new(a.sin() * 3.0, (1.7 * a).cos() * 2.0, (0.6 * a).sin());
            let off = if i < wrong {
                Vector3::new(4.0 + a, -3.0, 2.0)
            } else {
                noise * Vector3::new((5.0 * a).sin(), (7.0 * a).cos(), (3.0 * a).sin())
            };
            let known = other().transform(&in_map) + off;
            KnownPosition { name: i.to_string(), in_map, known, has_height: true, sd: 0.0 }
        };
        KnownPositions { positions: (0..count).map(of).collect(), ..KnownPositions::default() }
    }

    #[test]
    fn similarity_of_known_positions_is_recovered_despite_wrong_ones() {
        for (count, wrong) in [(3, 0), (4, 0), (6, 1), (20, 8), (200, 80)] {
            let found = align_to_positions(&known(count, wrong, 0.0), None).expect("an alignment");
            assert!((found.new_from_map.scale - 2.3).abs() < 1e-9, "{count} {wrong}: {found:?}");
            assert!((found.new_from_map.translation - other().translation).norm() < 1e-8, "{count} {wrong}");
            assert_eq!(
                found.used.iter().filter(|used| !**used).count(),
                wrong,
                "{count}: {:?}",
                found.residuals
            );
            assert!(found.rms < 1e-8 && found.faults.is_empty(), "{found:?}");
        }
        let noisy = align_to_positions(&known(40, 8, 0.02), None).expect("an alignment");
        assert!(
            (noisy.new_from_map.scale - 2.3).abs() < 0.02 && noisy.rms > 0.005 && noisy.rms < 0.05,
            "{noisy:?}"
        );
        assert!(noisy.used[..8].iter().all(|used| !used), "{:?}", noisy.used);
    }

    #[test]
    fn positions_that_determine_nothing_are_refused() {
        assert!(align_to_positions(&known(2, 0, 0.0), None).is_err());
        let on_line = |i: i32| {
            let x = Vector3::new(f64::from(i), 0.0, 0.0);
            KnownPosition { name: String::new(), in_map: x, known: x, has_height: true, sd: 0.0 }
        };
        let line = KnownPositions { positions: (0..5).map(on_line).collect(), ..KnownPositions::default() };
        let error = align_to_positions(&line, None).expect_err("refused").to_string();
        assert!(error.contains("on a line"), "{error}");
        // With gravity on both sides they are enough.
        let level = KnownPositions { down: Some(GravityDirection::MINUS_Z), ..line };
        let up = MapUp { direction: Vector3::z(), sd_deg: 1.0 };
        let found = align_to_positions(&level, Some(up)).expect("an alignment");
        assert!((found.new_from_map.scale - 1.0).abs() < 1e-9 && found.faults.is_empty(), "{found:?}");
    }

    /// A walk of about this length, a loop through rooms, seen by level cameras; GPS about it.
    struct Walk {
        size: f64,
        rng: ChaCha8Rng,
    }

    impl Walk {
        fn normal(&mut self) -> f64 {
            (0..12).map(|_| self.rng.random_range(-0.5..0.5)).sum()
        }

        /// Positions with noise, of which a share repeats an earlier one, each time a little beside it.
        fn known(&mut self, noise: f64, frozen: f64, jitter: f64) -> KnownPositions {
            self.drifting(noise, 0.0, frozen, jitter)
        }

        /// The same with errors that are correlated with those of the position before.
        fn drifting(&mut self, noise: f64, correlation: f64, frozen: f64, jitter: f64) -> KnownPositions {
            let count = 54;
            let mut off = Vector3::from_fn(|_, _| noise * self.normal());
            let mut positions: Vec<KnownPosition> = Vec::new();
            let mut fixed = None;
            for i in 0..count {
                let a = f64::from(i) / f64::from(count) * 6.0;
                let in_map = Vector3::new(
                    3.0 * a.cos(),
                    4.0 * a.sin() + 0.6 * (3.0 * a).sin(),
                    0.05 * (5.0 * a).sin(),
                );
                let fresh = noise * (1.0 - correlation * correlation).sqrt();
                off = correlation * off + Vector3::from_fn(|_, _| fresh * self.normal());
                let mut known = self.truth().transform(&in_map) + off;
                if self.rng.random_bool(frozen) {
                    let fixed: Vector3<f64> = *fixed.get_or_insert(known);
                    known = fixed + Vector3::from_fn(|_, _| jitter * self.normal());
                }
                positions.push(KnownPosition {
                    name: i.to_string(),
                    in_map,
                    known,
                    has_height: true,
                    sd: 0.0,
                });
            }
            KnownPositions {
                positions,
                down: Some(GravityDirection::MINUS_Z),
                has_heights: true,
                is_metric: true,
                origin: Some(veiloc_geometry::Geodetic { latitude: 47.0, longitude: 8.0, altitude: 400.0 }),
                ..KnownPositions::default()
            }
        }

        fn truth(&self) -> Similarity3 {
            let rotation = Rotation3::from_axis_angle(&Vector3::z_axis(), 0.7);
            Similarity3 { scale: self.size / 8.6, rotation, translation: Vector3::new(12.0, -3.0, 400.0) }
        }
    }

    /// The largest of the errors of scale, up and position over twice what an alignment states; `None` if it is refused.
    fn beyond(walk: &Walk, known: &KnownPositions) -> Option<f64> {
        let up = Some(MapUp { direction: Vector3::new(0.01, -0.008, 1.0).normalize(), sd_deg: 1.2 });
        let found = align_to_positions(known, up).ok().filter(|found| found.faults.is_empty())?;
        let truth = walk.truth();
        let Similarity3 { scale, rotation, translation } = found.new_from_map;
        let tilt = (rotation * Vector3::z()).angle(&Vector3::z()).to_degrees();
        let center = Vector3::from(found.accuracy.center);
        let in_map = rotation.inverse() * (center - translation) / scale;
        let off = (truth.transform(&in_map) - center).norm();
        let AlignmentAccuracy { scale: s, tilt_deg, position, .. } = found.accuracy;
        let errors = [(scale / truth.scale).ln().abs() / s, tilt / tilt_deg, off / position];
        Some(0.5 * errors.into_iter().fold(0.0, f64::max))
    }

    /// What a user must be able to rely on: refused, or within twice what it states.
    #[test]
    fn gps_is_refused_or_within_what_it_states() {
        let (mut kept, mut worse, mut worst) = (0, 0, 0.0_f64);
        for size in [2.0, 9.0, 26.0, 86.0] {
            for noise in [0.5, 2.0, 4.0] {
                for (frozen, jitter) in
                    [(0.0, 0.0), (0.3, 0.0), (0.3, 0.3), (0.6, 0.03), (0.6, 0.3), (1.0, 0.03)]
                {
                    for seed in 0..20 {
                        let mut walk = Walk { size, rng: ChaCha8Rng::seed_from_u64(seed) };
                        let known = walk.known(noise, frozen, jitter);
                        let Some(beyond) = beyond(&walk, &known) else { continue };
                        kept += 1;
                        worse += usize::from(beyond > 1.0);
                        worst = worst.max(beyond);
                    }
                }
            }
        }
        assert!(kept > 100 && worse * 100 <= kept && worst < 1.3, "{worse} of {kept}, {worst}");
        // The horizon of the images, which is a little wrong, does not move an exact fit.
        let mut walk = Walk { size: 26.0, rng: ChaCha8Rng::seed_from_u64(98) };
        let up = Some(MapUp { direction: Vector3::new(0.02, -0.01, 1.0).normalize(), sd_deg: 1.2 });
        let exact = align_to_positions(&walk.known(1e-4, 0.0, 0.0), up).expect("an alignment");
        assert!(exact.rms < 1e-3, "{}", exact.rms);
        // A large place is not refused.
        let mut walk = Walk { size: 86.0, rng: ChaCha8Rng::seed_from_u64(99) };
        let known = walk.known(1.0, 0.2, 0.0);
        assert!(beyond(&walk, &known).is_some());
    }

    /// Errors of fixes that follow each other are alike.
    #[test]
    fn drifting_gps_is_refused_or_about_within_what_it_states() {
        for correlation in [0.6, 0.8, 0.94] {
            let (mut kept, mut worse) = (0, 0);
            for seed in 0..60 {
                let mut walk = Walk { size: 86.0, rng: ChaCha8Rng::seed_from_u64(seed) };
                let known = walk.drifting(1.0, correlation, 0.0, 0.0);
                let Some(beyond) = beyond(&walk, &known) else { continue };
                kept += 1;
                worse += usize::from(beyond > 1.0);
            }
            assert!(kept > 30 && worse * 8 <= kept, "{correlation}: {worse} of {kept}");
        }
    }

    #[test]
    fn faults_of_lists_are_named() {
        let up = Some(MapUp { direction: Vector3::z(), sd_deg: 1.0 });
        let mut walk = Walk { size: 86.0, rng: ChaCha8Rng::seed_from_u64(3) };
        let right = KnownPositions { is_list: true, ..walk.known(0.05, 0.0, 0.0) };
        let faults = |change: &dyn Fn(usize, &mut KnownPosition)| {
            let mut changed = right.clone();
            changed.positions.iter_mut().enumerate().for_each(|(i, position)| change(i, position));
            align_to_positions(&changed, up).expect("an alignment").faults
        };
        assert_eq!(faults(&|_, _| ()), []);
        let mirrored = faults(&|_, p| p.known.y = -p.known.y);
        assert!(mirrored.iter().any(|f| matches!(f, AlignmentFault::Mirrored { .. })), "{mirrored:?}");
        let upside_down = faults(&|_, p| (p.known.y, p.known.z) = (-p.known.y, -p.known.z));
        assert!(
            upside_down
                .iter()
                .any(|f| matches!(f, AlignmentFault::Up { .. } | AlignmentFault::Mirrored { .. }))
        );
        let kinds = faults(&|i, p| p.known.z -= if i % 3 == 0 { 380.0 } else { 0.0 });
        assert!(kinds.iter().any(|f| matches!(f, AlignmentFault::Heights { .. })), "{kinds:?}");
        let mut shifted = right.clone();
        let all: Vec<Vector3<f64>> = right.positions.iter().map(|p| p.known).collect();
        shifted.positions.iter_mut().zip(&all[1..]).for_each(|(p, next)| p.known = *next);
        let found = align_to_positions(&shifted, up).expect("an alignment").faults;
        assert!(found.iter().any(|f| matches!(f, AlignmentFault::Shifted { .. })), "{found:?}");
    }

    #[test]
    fn missing_heights_are_not_heights_of_zero() {
        let up = Some(MapUp { direction: Vector3::z(), sd_deg: 1.0 });
        for without in [2, 1] {
            let mut walk = Walk { size: 86.0, rng: ChaCha8Rng::seed_from_u64(4) };
            let mut known = walk.known(0.5, 0.0, 0.0);
            for position in known.positions.iter_mut().step_by(without) {
                (position.known.z, position.has_height) = (0.0, false);
            }
            let found = align_to_positions(&known, up).expect("an alignment");
            let tilt = (found.new_from_map.rotation * Vector3::z()).angle(&Vector3::z()).to_degrees();
            assert!(
                found.faults.is_empty() && tilt < 1.0 && found.has_heights == (without == 2),
                "{found:?}"
            );
        }
    }
}
