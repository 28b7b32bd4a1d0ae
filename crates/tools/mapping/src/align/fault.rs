//! What speaks against a fit to known positions.

use std::fmt;

use veiloc_geometry::nalgebra::Vector3;
use veiloc_map::MapModel;

use super::fit::{Errors, Fit, Pair, fit, residual};
use super::known::{KnownPositions, spread};
use super::level::MapUp;
use crate::coordinate_frames::{Similarity3, median};

/// A reason not to believe an alignment.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum AlignmentFault {
    /// The scale is hardly known.
    Scale {
        /// Relative standard deviation.
        sd: f64,
    },
    /// Up by the positions is not up by the map: its gravity, or the horizon of its images.
    Up {
        /// Angle between them, degrees.
        angle_deg: f64,
    },
    /// Two maps that are fitted to each other know different directions of gravity.
    Gravity {
        /// Angle between them, degrees.
        angle_deg: f64,
    },
    /// Most positions repeat others.
    Repeated {
        /// How many do.
        repeated: usize,
        /// Of how many.
        all: usize,
    },
    /// Less than half of the positions agree.
    FewAgree {
        /// How many do.
        used: usize,
        /// Of how many.
        all: usize,
    },
    /// The positions that agree are in one part of the map.
    Part {
        /// Their spread, of that of all.
        share: f64,
    },
    /// The distances are large for the extent of the positions.
    Distances {
        /// Root mean square distance, new units.
        rms: f64,
        /// Extent of the positions that were used, new units.
        extent: f64,
    },
    /// The list of positions fits better when it is shifted against its names.
    Shifted {
        /// By how many lines.
        lines: isize,
        /// Root mean square distance then, of the present one.
        share: f64,
    },
    /// The mirrored positions fit better.
    Mirrored {
        /// Root mean square distance then, of the present one.
        share: f64,
    },
    /// Heights are of two kinds.
    Heights {
        /// Distance of their middles, new units.
        apart: f64,
    },
    /// An anchor would be in a place that is hardly known.
    Anchor {
        /// Its ±, the root mean square distance, map units.
        sd: f64,
        /// How far away what the images see is, map units.
        scale: f64,
    },
    /// What the images see is at a distance at which nothing can be seen, if the new unit is the metre.
    Metres {
        /// Median distance, metres.
        distance: f64,
    },
}

impl AlignmentFault {
    /// Of the relative standard deviation of a scale.
    pub(super) fn of_scale(sd: f64) -> Option<Self> {
        (sd.is_nan() || sd > MAX_SCALE_SD).then_some(Self::Scale { sd })
    }

    /// Of the angle between the directions of gravity of two maps.
    pub(super) fn of_gravity(angle_deg: f64) -> Option<Self> {
        (angle_deg > MAX_UP_DEG).then_some(Self::Gravity { angle_deg })
    }
}

impl fmt::Display for AlignmentFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Scale { sd } => write!(
                f,
                "the scale is known to ± {:.0} % only: too inaccurate for a place of this size",
                100.0 * sd
            ),
            Self::Gravity { angle_deg } => write!(
                f,
                "the directions of gravity that the two maps know are {angle_deg:.0}° apart after the fit; correct the wrong one \
                 with `map build --down` or `map align --level --down`"
            ),
            Self::Up { angle_deg } => write!(
                f,
                "up by the positions is {angle_deg:.0}° from up by the images; check heights, axes and the order of the \
                 numbers (--known-down names another direction of gravity in the axes of the positions)"
            ),
            Self::Repeated { repeated, all } => write!(
                f,
                "{repeated} of {all} positions repeat others although the images are apart: the receiver had no new fix"
            ),
            Self::FewAgree { used, all } => write!(f, "only {used} of {all} positions agree"),
            Self::Part { share } => write!(
                f,
                "the positions that agree span only {:.0} % of what all images with positions span",
                100.0 * share
            ),
            Self::Distances { rms, extent } => write!(
                f,
                "the distances are {rms:.3} in the root mean square, and all positions are within {extent:.3}"
            ),
            Self::Shifted { lines, share } => write!(
                f,
                "the list fits better when it is shifted by {lines} lines against its names: the distances are then {:.0} % \
                 of the present ones",
                100.0 * share
            ),
            Self::Mirrored { share } => write!(
                f,
                "the mirrored positions fit better, with {:.0} % of the distances: their axes are left-handed; swap two, or \
                 change the sign of one",
                100.0 * share
            ),
            Self::Heights { apart } => write!(
                f,
                "the heights are of two kinds, {apart:.1} apart, such as over the sea and over the ground; give one kind"
            ),
            Self::Anchor { sd, scale } => write!(
                f,
                "an anchor would be known to ± {sd:.3} only, and what the images see is {scale:.3} away"
            ),
            Self::Metres { distance } if *distance < 1.0 => write!(
                f,
                "what the images see would be {distance:.2e} metres away; are the positions degrees, or not in metres?"
            ),
            Self::Metres { distance } => write!(
                f,
                "what the images see would be {distance:.0} metres away; are the positions in millimetres?"
            ),
        }
    }
}

/// A fit and what it is judged by.
pub(super) struct Judge<'a> {
    pub(super) known: &'a KnownPositions,
    pub(super) pairs: &'a [Pair],
    pub(super) found: &'a Fit,
    pub(super) up: Option<MapUp>,
    pub(super) errors: Errors,
}

impl Judge<'_> {
    pub(super) fn faults(&self) -> Vec<AlignmentFault> {
        let Self { known, pairs, found, .. } = self;
        let mut faults = Vec::new();
        let all = known.positions.len();
        let repeated = all - pairs.len();
        if 2 * repeated > all {
            faults.push(AlignmentFault::Repeated { repeated, all });
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
        faults.extend(AlignmentFault::of_scale(found.covariance[(0, 0)].sqrt()));
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
        let alone = fit(self.pairs, None, self.errors)?;
        let tilt = |similarity: &Similarity3| (similarity.rotation * up.direction).angle(&Vector3::z());
        let sd = (alone.covariance[(1, 1)] + alone.covariance[(2, 2)] + 2.0 * up.sd_deg.to_radians().powi(2))
            .sqrt();
        let own = tilt(&alone.similarity);
        let angle = if own < UP_SDS * sd { tilt(&self.found.similarity) } else { own };
        let angle_deg = angle.to_degrees();
        (angle_deg > MAX_UP_DEG).then_some(AlignmentFault::Up { angle_deg })
    }

    /// Two groups of heights that one offset does not explain.
    fn heights(&self) -> Option<AlignmentFault> {
        let with_height = self.pairs.iter().filter(|pair| pair.has_height);
        let mut left: Vec<f64> = with_height.map(|pair| residual(pair, &self.found.similarity).z).collect();
        if !self.errors.has_vertical || left.len() < MIN_HEIGHTS {
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

    /// Spread of the positions.
    fn size(&self) -> f64 {
        spread(self.pairs.iter().map(|pair| self.found.similarity.transform(&pair.x)))
    }

    /// Whether other pairs fit much better: with at least as many, at smaller distances.
    fn better(&self, pairs: &[Pair], up: Option<MapUp>) -> Option<f64> {
        let other = fit(pairs, up, self.errors)?;
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
    let distance = scale * crate::calibration::run::scale(model);
    (distance > 0.0 && !METRES_SEEN.contains(&distance)).then_some(AlignmentFault::Metres { distance })
}

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
