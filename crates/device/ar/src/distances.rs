//! Distances between cameras in the map against those in the AR world.
//!
//! A framework with inertial sensors measures distances to a few percent. When the map's are longer or shorter by a
//! common factor, the map's unit is not what the app takes it for; when the answers of a calibrated camera come from a
//! wrong focal length, they are too near or too far as well.

use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::statistics::upper_median;

/// Where the camera was when it took one frame.
#[derive(Debug, Clone)]
pub(crate) struct Place {
    /// By the answer, metres.
    pub(crate) in_map: Vector3<f64>,
    /// By the AR framework, metres.
    pub(crate) in_ar: Vector3<f64>,
    /// Standard deviation of `in_map` in its least certain direction.
    pub(crate) sd: f64,
    /// Path of the camera until then, metres.
    pub(crate) path: f64,
}

/// Distances in the map, divided by those in the AR world.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct DistanceRatio {
    /// The median over all pairs of answers that are far enough apart to measure it.
    pub median: f64,
    /// Spread of the ratios: 1.4826 times their median deviation from the median.
    pub spread: f64,
    /// Pairs.
    pub pairs: usize,
    /// Answers in them.
    pub answers: usize,
}

/// What a [`DistanceRatio`] says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DistanceVerdict {
    /// Too few answers, or too near to each other: walk on.
    Unknown,
    /// The ratio is 1 within 5 %.
    Agrees,
    /// It is not: check the unit of the map and the focal length.
    Differs,
}

impl DistanceVerdict {
    /// The name in text form.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Agrees => "agrees",
            Self::Differs => "differs",
        }
    }
}

impl DistanceRatio {
    /// Whether distances agree.
    pub fn verdict(&self) -> DistanceVerdict {
        let error = self.spread / (self.answers as f64).sqrt();
        if self.answers < MIN_ANSWERS || error > TOLERANCE {
            DistanceVerdict::Unknown
        } else if (self.median - 1.0).abs() <= TOLERANCE + error {
            DistanceVerdict::Agrees
        } else {
            DistanceVerdict::Differs
        }
    }
}

/// Answers that a verdict needs: with three, one wrong answer decides two of three pairs.
const MIN_ANSWERS: usize = 4;
/// Difference from 1 that the drift of the framework may explain.
const TOLERANCE: f64 = 0.05;
/// Smallest distance, metres, and in standard deviations of the positions.
const MIN_DISTANCE: f64 = 0.3;
const MIN_SDS: f64 = 5.0;

/// The ratio over all pairs that are far enough apart; `None` when there are none.
pub(crate) fn ratio(places: &[&Place], drift: f64) -> Option<DistanceRatio> {
    let mut ratios = Vec::new();
    let mut in_pairs = vec![false; places.len()];
    for (i, a) in places.iter().enumerate() {
        for (j, b) in places.iter().enumerate().take(i) {
            let distance = (a.in_ar - b.in_ar).norm();
            let sd = a.sd.hypot(b.sd).hypot(drift * (a.path - b.path));
            if distance >= MIN_DISTANCE && distance >= MIN_SDS * sd {
                ratios.push((a.in_map - b.in_map).norm() / distance);
                (in_pairs[i], in_pairs[j]) = (true, true);
            }
        }
    }
    let answers = in_pairs.iter().filter(|is_in| **is_in).count();
    let middle = upper_median(&mut ratios)?;
    let mut deviations: Vec<f64> = ratios.iter().map(|ratio| (ratio - middle).abs()).collect();
    let spread = 1.4826 * upper_median(&mut deviations)?;
    Some(DistanceRatio { median: middle, spread, pairs: ratios.len(), answers })
}
