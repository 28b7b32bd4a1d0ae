//! What a session has told already: so that a keypoint seen again is told by the very same row, or not at all.
//!
//! A camera at rest, or one that turns on the spot, sees a keypoint at its direction again, give or take the detector's noise. Told
//! anew each time, its angles would scatter as one over the distance from its anchor, and a camera that moved would carry some
//! over a border of sectors to another anchor, whose line crosses the first one in the keypoint. So the device remembers what it
//! told of what, in landmarks.

use std::collections::BTreeSet;

use veiloc_descriptor::{Descriptors, MatchOptions, match_descriptors};
use veiloc_geometry::Anchor;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};

use super::align::Pair;
use crate::rule::Recalled;
use crate::schemes::dcl::Told;

/// Landmarks kept at most: the oldest go. About a megabyte and a half.
pub(super) const MOST: usize = 8192;
/// What is seen this near to where it was told is at its place, degrees: two pixels of a camera with a focal length of 500,
/// five times what a detector errs by.
const SAME_DEG: f64 = 0.25;
/// What is seen farther from where it was told than this is something else that looks alike, degrees.
const NEARBY_DEG: f64 = 20.0;
/// A match this unambiguous tells a turn, and whether two frames show one place.
const CLEAR_RATIO: f32 = 0.8;
/// One no more ambiguous than this may be of something that was told: what attackers match by, too.
const TOLD_RATIO: f32 = 0.9;
/// So many clear matches are of one place.
const OVERLAP: usize = 15;
/// Descriptors of one landmark are nearer than this share of their length.
const ALIKE: f32 = 0.7;
/// Nearer than this share of their length they are of one keypoint, whatever else is near.
const ITSELF: f32 = 0.35;

/// A keypoint that was told.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Landmark {
    /// Direction in the layout's frame in which it was seen when it was told.
    pub(super) direction: Vector3<f64>,
    pub(super) told: Told,
    /// As the so manieth the layout was put where it was told.
    pub(super) start: u32,
    /// The frame that last showed it.
    pub(super) seen: u32,
}

/// All landmarks of a session.
#[derive(Clone, PartialEq, Default)]
pub(super) struct Memory {
    pub(super) landmarks: Vec<Landmark>,
    /// `[landmarks]`; of no kind while there are none.
    pub(super) descriptors: Option<Descriptors>,
}

/// Keypoints of a frame and the landmarks they are.
pub(super) struct Matched {
    /// By keypoint: landmark, and how near it is beside the second nearest, 0 to 1.
    by_keypoint: Vec<Option<(usize, f32)>>,
    /// Landmarks of the start that was asked for.
    candidates: Vec<usize>,
}

impl Memory {
    /// Which landmarks of a start these descriptors are.
    pub(super) fn matched(&self, descriptors: &Descriptors, start: u32) -> Matched {
        let candidates: Vec<usize> =
            (0..self.landmarks.len()).filter(|i| self.landmarks[*i].start == start).collect();
        let mut by_keypoint = vec![None; descriptors.len()];
        if let Some(all) = self.descriptors.as_ref().filter(|all| all.kind() == descriptors.kind()) {
            let database = all.select(candidates.iter().copied());
            for m in match_descriptors(descriptors.view(), database.view(), &MatchOptions::default()) {
                by_keypoint[m.query as usize] = Some((candidates[m.database as usize], m.ratio));
            }
        }
        Matched { by_keypoint, candidates }
    }

    /// Directions of clear matches; `seen` are those of the keypoints in the camera, as far as they have one.
    pub(super) fn pairs(&self, matched: &Matched, seen: &[Option<Vector3<f64>>]) -> Vec<Pair> {
        let clear = matched.by_keypoint.iter().zip(seen).filter_map(|(landmark, camera)| {
            let (index, _) = landmark.filter(|(_, ratio)| *ratio <= CLEAR_RATIO)?;
            Some(Pair { layout: self.landmarks[index].direction, camera: (*camera)? })
        });
        clear.collect()
    }

    /// All starts that something is remembered of.
    fn starts(&self) -> BTreeSet<u32> {
        self.landmarks.iter().map(|landmark| landmark.start).collect()
    }

    /// How many of the starts that are remembered show what these descriptors are of.
    pub(super) fn overlapping(&self, descriptors: &Descriptors) -> u32 {
        let shows = |start: &u32| {
            let matched = self.matched(descriptors, *start).by_keypoint;
            matched.iter().flatten().filter(|(_, ratio)| *ratio <= CLEAR_RATIO).count() >= OVERLAP
        };
        self.starts().into_iter().filter(shows).count() as u32
    }

    /// Which of these descriptors are likely of something that was told by a start before this one, and not by this one, whose
    /// matches are given.
    pub(super) fn told_before(&self, descriptors: &Descriptors, start: u32, matched: &Matched) -> Vec<bool> {
        let mut told = vec![false; descriptors.len()];
        for earlier in self.starts().into_iter().filter(|s| *s < start) {
            let earlier = self.matched(descriptors, earlier).by_keypoint;
            for ((told, landmark), own) in told.iter_mut().zip(earlier).zip(&matched.by_keypoint) {
                let is_clear = |m: Option<(usize, f32)>| m.is_some_and(|(_, ratio)| ratio <= TOLD_RATIO);
                // Nearly everything has some nearest neighbour among what this start told: only a clear one says it is it.
                *told |= !is_clear(*own) && is_clear(landmark);
            }
        }
        told
    }

    /// What is to become of each keypoint, and the landmark that says so. `anchor_of`: whose it would be by its place in the image.
    pub(super) fn recall(
        &self,
        matched: &Matched,
        descriptors: &Descriptors,
        seen: &[Option<Vector3<f64>>],
        cam_from_layout: &Rotation3<f64>,
        anchor_of: impl Fn(usize) -> Option<Anchor>,
    ) -> Vec<(Recalled, Option<usize>)> {
        let [same, nearby] = [SAME_DEG, NEARBY_DEG].map(|degrees| degrees.to_radians().cos());
        let one = |(i, camera): (usize, &Option<Vector3<f64>>)| {
            let Some(camera) = camera else { return (Recalled::New, None) };
            let direction = cam_from_layout.inverse() * camera;
            let cosine = |landmark: &usize| self.landmarks[*landmark].direction.dot(&direction);
            let own = matched.by_keypoint[i].filter(|(l, _)| cosine(l) >= nearby);
            // Of ambiguous matches most are wrong, and half of those of another anchor: they would empty a query.
            let its_own = own.filter(|(_, ratio)| *ratio <= TOLD_RATIO).map(|(landmark, _)| landmark);
            // Another one may have taken its landmark, or it another's.
            let alike = || {
                let near = matched.candidates.iter().copied().filter(|l| cosine(l) >= same);
                near.map(|l| (self.distance(l, descriptors, i), l))
                    .filter(|(distance, _)| *distance < ALIKE * descriptors.kind().norm() as f32)
                    .min_by(|a, b| a.0.total_cmp(&b.0))
                    .map(|(_, landmark)| landmark)
            };
            let at_its_place = own.map(|(landmark, _)| landmark).filter(|l| cosine(l) >= same).or_else(alike);
            let what = match (at_its_place, its_own) {
                (Some(landmark), _) => Recalled::Same(self.landmarks[landmark].told),
                (None, Some(landmark)) => {
                    let told = self.landmarks[landmark].told.anchor;
                    let changes = anchor_of(i).is_some_and(|own| own != told);
                    if changes { Recalled::Crossed } else { Recalled::New }
                }
                (None, None) => Recalled::New,
            };
            // What took another's row is remembered for itself, or a later start would not know it.
            let is_known = |l: &usize| {
                own.is_some_and(|(own, _)| own == *l)
                    || self.distance(*l, descriptors, i) < ITSELF * descriptors.kind().norm() as f32
            };
            (what, at_its_place.filter(is_known).or(its_own))
        };
        seen.iter().enumerate().map(one).collect()
    }

    /// Between a landmark's descriptor and one of a frame.
    fn distance(&self, landmark: usize, descriptors: &Descriptors, row: usize) -> f32 {
        let Some(own) = self.descriptors.as_ref() else { return f32::INFINITY };
        let pairs = own.row(landmark).iter().zip(descriptors.row(row));
        let sum: u32 = pairs.map(|(a, b)| u32::from(a.abs_diff(*b)).pow(2)).sum();
        (sum as f32).sqrt()
    }

    /// Remembers what was sent. `rows`: index among `descriptors`, the landmark it is, its direction in the layout's frame, and what
    /// was told.
    pub(super) fn remember(
        &mut self,
        rows: impl Iterator<Item = (usize, Option<usize>, Vector3<f64>, Told)>,
        descriptors: &Descriptors,
        (start, frame): (u32, u32),
    ) {
        let all = self.descriptors.take().filter(|all| all.kind() == descriptors.kind());
        let mut all = all.unwrap_or_else(|| Descriptors::empty(descriptors.kind()));
        self.landmarks.truncate(all.len());
        let mut moved = BTreeSet::new();
        for (row, known, direction, told) in rows {
            match known {
                // Where it was told first stays, or it would wander away in small steps.
                Some(landmark) if self.landmarks[landmark].told == told => {
                    self.landmarks[landmark].seen = frame;
                }
                _ => {
                    all.push(descriptors.row(row)).expect("of one kind");
                    self.landmarks.push(Landmark { direction, told, start, seen: frame });
                    moved.extend(known);
                }
            }
        }
        let mut keep: Vec<usize> = (0..self.landmarks.len()).filter(|i| !moved.contains(i)).collect();
        if keep.len() > MOST {
            keep.sort_by_key(|i| std::cmp::Reverse(self.landmarks[*i].seen));
            keep.truncate(MOST);
            keep.sort_unstable();
        }
        self.descriptors = Some(all.select(keep.iter().copied()));
        self.landmarks = keep.iter().map(|i| self.landmarks[*i].clone()).collect();
    }
}
