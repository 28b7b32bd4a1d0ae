//! Aligns a map to another world frame: metres, north, gravity, or the coordinate frame of another map.
//!
//! - [`align_to_positions`]: the similarity that fits known positions of images or points; robust against wrong ones, with its
//!   accuracy and with what speaks against it.
//! - [`read_positions`]: such positions from a file. [`gps_positions`]: from GPS in the EXIF of the images.
//! - [`align_to_map`]: the similarity to another map of the same place, by localizing this map's images in it.
//! - [`up_of_images`]: the up direction that the images show. [`level`]: the rotation that makes it `z`.
//! - [`transform`]: applies a similarity to a map.

mod fault;
mod fit;
mod gps;
mod known;
mod level;
mod positions;

use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_map::{AlignmentAccuracy, GravityDirection, MapModel};

pub use self::fault::AlignmentFault;
use self::fit::{Fit, KnownUp, Pair, fit, rotation_to_z};
pub use self::gps::gps_positions;
pub use self::known::{KnownPosition, KnownPositions};
use self::known::{counted, spread};
pub use self::level::{ImagesUp, up_of_images};
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

/// The up direction of a map, from its gravity or from its images.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapUp {
    /// Unit vector in the map.
    pub direction: Vector3<f64>,
    /// Standard deviation of each of its two angles, degrees.
    pub sd_deg: f64,
}

impl MapUp {
    /// The opposite of the direction of gravity that a map has, or, for lack of it, of the images; `None` if they do not show
    /// it.
    pub fn of(model: &MapModel) -> Option<Self> {
        if let Some(down) = model.down {
            return Some(Self { direction: -Vector3::from(down.in_world()), sd_deg: KNOWN_DOWN_SD_DEG });
        }
        let found = up_of_images(model).ok()?;
        Some(Self { direction: found.direction, sd_deg: found.sd_deg })
    }
}

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
    let both = up.zip(up_in_new).map(|(up, _)| KnownUp { in_map: up.direction, sd: up.sd_deg.to_radians() });
    let needed = if both.is_some() { 2 } else { 3 };
    let counted = counted(positions);
    let count = counted.iter().filter(|counted| **counted).count();
    if count < needed {
        let all = positions.len();
        let found = if count < all {
            format!("{count} of {all} positions are different")
        } else {
            format!("{all} are known")
        };
        return refuse(format!(
            "{needed} different known positions are needed, and more are better; {found}"
        ));
    }
    let level = up_in_new.map_or_else(Rotation3::identity, |up| rotation_to_z(&up));
    let pair = |p: &KnownPosition| Pair {
        x: p.in_map,
        y: level * p.known,
        has_height: p.has_height,
        least_sd: p.sd.max(known.grid / 12.0_f64.sqrt()),
    };
    let kept: Vec<usize> = (0..positions.len()).filter(|&i| counted[i]).collect();
    let pairs: Vec<Pair> = kept.iter().map(|&i| pair(&positions[i])).collect();
    let has_vertical = up_in_new.is_some();
    let Some(found) = fit(&pairs, both, has_vertical) else {
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
    let faults =
        Judge { known, pairs: &pairs, found: &found, up: both, has_vertical, all: positions.len() }.faults();
    let back = level.inverse();
    let new_from_map = Similarity3 {
        scale: found.similarity.scale,
        rotation: back * found.similarity.rotation,
        translation: back * found.similarity.translation,
    };
    let distance = |p: &KnownPosition| {
        let mut left = level * (p.known - new_from_map.transform(&p.in_map));
        if !p.has_height {
            left.z = 0.0;
        }
        left.norm()
    };
    let mut used = vec![false; positions.len()];
    kept.iter().zip(&found.used).for_each(|(&i, is_used)| used[i] = *is_used);
    Ok(Alignment {
        residuals: positions.iter().map(distance).collect(),
        repeated: positions.len() - count,
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

/// A fit and what it is judged by.
struct Judge<'a> {
    known: &'a KnownPositions,
    pairs: &'a [Pair],
    found: &'a Fit,
    up: Option<KnownUp>,
    has_vertical: bool,
    /// Number of positions, with those that repeat others.
    all: usize,
}

impl Judge<'_> {
    fn faults(&self) -> Vec<AlignmentFault> {
        let Self { pairs, found, all, .. } = self;
        let mut faults = Vec::new();
        let repeated = all - pairs.len();
        if 2 * repeated > *all {
            faults.push(AlignmentFault::Repeated { repeated, all: *all });
        }
        let used = || pairs.iter().zip(&found.used).filter(|(_, used)| **used).map(|(pair, _)| pair);
        let count = used().count();
        if 2 * count < pairs.len() {
            faults.push(AlignmentFault::FewAgree { used: count, all: pairs.len() });
        }
        let share = spread(used().map(|pair| pair.x)) / spread(pairs.iter().map(|pair| pair.x));
        if share < MIN_PART {
            faults.push(AlignmentFault::Part { share });
        }
        let extent =
            2.0 * used().map(|pair| pair.y).fold(0.0, |most: f64, y| most.max((y - self.middle()).norm()));
        if found.rms > MAX_DISTANCES * extent {
            faults.push(AlignmentFault::Distances { rms: found.rms, extent });
        }
        let sd = found.covariance[(0, 0)].sqrt();
        if sd.is_nan() || sd > MAX_SCALE_SD {
            faults.push(AlignmentFault::Scale { sd });
        }
        faults.extend(self.heights());
        faults.extend(self.up());
        faults.extend(self.mirrored());
        faults.extend(self.shifted());
        faults
    }

    fn middle(&self) -> Vector3<f64> {
        self.found.similarity.transform(&self.found.center)
    }

    /// Whether the positions by themselves have another up direction than the map.
    fn up(&self) -> Option<AlignmentFault> {
        let up = self.up?;
        let alone = fit(self.pairs, None, self.has_vertical)?;
        let tilt = |similarity: &Similarity3| (similarity.rotation * up.in_map).angle(&Vector3::z());
        let sd = (alone.covariance[(1, 1)] + alone.covariance[(2, 2)] + 2.0 * up.sd * up.sd).sqrt();
        let own = tilt(&alone.similarity);
        let angle = if own < UP_SDS * sd { tilt(&self.found.similarity) } else { own };
        let angle_deg = angle.to_degrees();
        (angle_deg > MAX_UP_DEG).then_some(AlignmentFault::Up { angle_deg })
    }

    /// Two groups of heights that one offset does not explain.
    fn heights(&self) -> Option<AlignmentFault> {
        let similarity = &self.found.similarity;
        let mut left: Vec<f64> = (self.pairs.iter().filter(|pair| pair.has_height))
            .map(|pair| pair.y.z - similarity.transform(&pair.x).z)
            .collect();
        if !self.has_vertical || left.len() < MIN_HEIGHTS {
            return None;
        }
        left.sort_by(f64::total_cmp);
        let least = (MIN_GROUP * left.len() as f64).ceil() as usize;
        let gap = |at: &usize| left[*at] - left[at - 1];
        let at = (least..=left.len() - least).max_by(|a, b| gap(a).total_cmp(&gap(b)))?;
        let middle_and_sd = |group: &[f64]| {
            let middle = group[group.len() / 2];
            (middle, 1.4826 * median(group.iter().map(|x| (x - middle).abs()).collect()))
        };
        let [(low, low_sd), (high, high_sd)] = [middle_and_sd(&left[..at]), middle_and_sd(&left[at..])];
        let apart = high - low;
        (gap(&at) > KIND_SDS * low_sd.max(high_sd) && apart > MIN_KINDS_APART * self.size())
            .then_some(AlignmentFault::Heights { apart })
    }

    /// Spread of the used positions.
    fn size(&self) -> f64 {
        spread(self.pairs.iter().map(|pair| self.found.similarity.transform(&pair.x)))
    }

    /// Whether other pairs fit much better: with at least as many, at smaller distances.
    fn better(&self, pairs: &[Pair], up: Option<KnownUp>) -> Option<f64> {
        let other = fit(pairs, up, self.has_vertical)?;
        let count = |fit: &Fit| fit.used.iter().filter(|used| **used).count() as f64 / fit.used.len() as f64;
        let share = (other.rms / other.similarity.scale) / (self.found.rms / self.found.similarity.scale);
        (share < MUCH_BETTER && count(&other) >= 0.9 * count(self.found)).then_some(share)
    }

    fn mirrored(&self) -> Option<AlignmentFault> {
        let mirror = |pair: &Pair| Pair { y: Vector3::new(pair.y.x, -pair.y.y, pair.y.z), ..*pair };
        let mirrored: Vec<Pair> = self.pairs.iter().map(mirror).collect();
        Some(AlignmentFault::Mirrored { share: self.better(&mirrored, self.up)? })
    }

    fn shifted(&self) -> Option<AlignmentFault> {
        if !self.known.is_list || self.pairs.len() < MIN_SHIFTED {
            return None;
        }
        let by = |lines: isize| {
            let place = |(i, pair): (usize, &Pair)| {
                let other = self.pairs.get(i.checked_add_signed(lines)?)?;
                Some(Pair { y: other.y, has_height: other.has_height, ..*pair })
            };
            let shifted: Vec<Pair> = self.pairs.iter().enumerate().filter_map(place).collect();
            Some(AlignmentFault::Shifted { lines, share: self.better(&shifted, self.up)? })
        };
        [1, -1, 2, -2].into_iter().find_map(by)
    }
}

/// What speaks against metres: the median distance of what the images see, in the new unit.
pub fn implausible_metres(model: &MapModel, scale: f64) -> Option<AlignmentFault> {
    let centers: Vec<Vector3<f64>> =
        model.images.iter().map(|image| image.cam_from_world.center().coords).collect();
    let step = model.points.len().div_ceil(MAX_POINTS).max(1);
    let distances: Vec<f64> = (model.points.iter().step_by(step))
        .filter_map(|point| {
            Some((centers.get(point.track.first()?.image as usize)? - point.position.coords).norm())
        })
        .collect();
    if distances.is_empty() {
        return None;
    }
    let distance = scale * median(distances);
    (!METRES_SEEN.contains(&distance)).then_some(AlignmentFault::Metres { distance })
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

/// Standard deviation of a direction of gravity that a map has: of an AR capture, or of who gave it. Degrees.
const KNOWN_DOWN_SD_DEG: f64 = 1.0;
/// Relative standard deviation of the scale from which on it is not to be believed.
const MAX_SCALE_SD: f64 = 0.05;
/// Angle between two up directions from which on one of them is wrong, degrees, if it is also this many standard deviations.
const MAX_UP_DEG: f64 = 10.0;
const UP_SDS: f64 = 3.0;
/// Spread of the positions that agree, of that of all.
const MIN_PART: f64 = 1.0 / 3.0;
/// Root mean square distance, of the extent.
const MAX_DISTANCES: f64 = 0.05;
/// Share of the distances of a fit that is much better.
const MUCH_BETTER: f64 = 0.5;
/// Fewest positions of a list that may be shifted.
const MIN_SHIFTED: usize = 8;
/// Heights of two kinds: fewest heights, smallest group, gap in standard deviations, and distance in spreads of the positions.
const MIN_HEIGHTS: usize = 8;
const MIN_GROUP: f64 = 0.2;
const KIND_SDS: f64 = 4.0;
const MIN_KINDS_APART: f64 = 0.5;
/// Median distances, metres, at which images show something: from a table top to a valley seen from a drone.
const METRES_SEEN: std::ops::RangeInclusive<f64> = 0.05..=500.0;
/// Points whose distances are looked at.
const MAX_POINTS: usize = 5000;

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

    /// In a frame whose axes are those of nobody.
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
        let level = KnownPositions { down: GravityDirection::new([0.0, 0.0, -1.0]).ok(), ..line };
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
            let count = 54;
            let mut positions: Vec<KnownPosition> = Vec::new();
            let mut fixed = None;
            for i in 0..count {
                let a = f64::from(i) / f64::from(count) * 6.0;
                let in_map = Vector3::new(
                    3.0 * a.cos(),
                    4.0 * a.sin() + 0.6 * (3.0 * a).sin(),
                    0.05 * (5.0 * a).sin(),
                );
                let off = Vector3::from_fn(|_, _| noise * self.normal());
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
                down: GravityDirection::new([0.0, 0.0, -1.0]).ok(),
                has_heights: true,
                is_metric: true,
                ..KnownPositions::default()
            }
        }

        fn truth(&self) -> Similarity3 {
            let rotation = Rotation3::from_axis_angle(&Vector3::z_axis(), 0.7);
            Similarity3 { scale: self.size / 8.6, rotation, translation: Vector3::new(12.0, -3.0, 400.0) }
        }
    }

    /// What a user must be able to rely on: refused, or within twice what it states.
    #[test]
    fn gps_is_refused_or_within_what_it_states() {
        let up = Some(MapUp { direction: Vector3::new(0.01, -0.008, 1.0).normalize(), sd_deg: 1.2 });
        let (mut all, mut kept, mut beyond) = (0, 0, 0);
        for size in [2.0, 9.0, 26.0, 86.0] {
            for noise in [0.5, 2.0, 4.0] {
                for (frozen, jitter) in
                    [(0.0, 0.0), (0.3, 0.0), (0.3, 0.3), (0.6, 0.03), (0.6, 0.3), (1.0, 0.03)]
                {
                    for seed in 0..20 {
                        let mut walk = Walk { size, rng: ChaCha8Rng::seed_from_u64(seed) };
                        let known = walk.known(noise, frozen, jitter);
                        all += 1;
                        let Ok(found) = align_to_positions(&known, up) else { continue };
                        if !found.faults.is_empty() {
                            continue;
                        }
                        kept += 1;
                        let truth = walk.truth();
                        let Similarity3 { scale, rotation, translation } = found.new_from_map;
                        let tilt = (rotation * Vector3::z()).angle(&Vector3::z()).to_degrees();
                        let center = Vector3::from(found.accuracy.center);
                        let in_map = rotation.inverse() * (center - translation) / scale;
                        let off = (truth.transform(&in_map) - center).norm();
                        let scale = (scale / truth.scale).ln().abs();
                        let AlignmentAccuracy { scale: s, tilt_deg, position, .. } = found.accuracy;
                        let is_within = scale < 2.0 * s && tilt < 2.0 * tilt_deg && off < 2.0 * position;
                        beyond += usize::from(!is_within);
                        assert!(
                            scale < 4.0 * s && tilt < 4.0 * tilt_deg && off < 4.0 * position,
                            "{size} m, noise {noise}, frozen {frozen} {jitter}, seed {seed}: {scale} {tilt} {off} {found:?}"
                        );
                    }
                }
            }
        }
        // Two standard deviations of three quantities.
        assert!(beyond * 20 <= kept, "{beyond} of {kept} of {all}");
        // A large place is not refused.
        let mut walk = Walk { size: 86.0, rng: ChaCha8Rng::seed_from_u64(99) };
        let known = walk.known(1.0, 0.2, 0.0);
        assert_eq!(align_to_positions(&known, up).expect("an alignment").faults, []);
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
