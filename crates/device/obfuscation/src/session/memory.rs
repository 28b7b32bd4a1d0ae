//! The rows that a session has sent: a keypoint that is seen again is sent as the same row, or not at all.
//!
//! A camera at rest, or one that turns on the spot, sees a keypoint at the same direction again, up to detector noise.
//! If every frame sent a new angle, the angles would scatter with a spread that is inversely proportional to the
//! distance from the anchor; and a moving camera would carry some keypoints across a sector border to another anchor,
//! whose line crosses the first line in the keypoint. Therefore the device stores each sent row with its direction and
//! descriptor, as a landmark.

use std::collections::{BTreeMap, BTreeSet};

use veiloc_descriptor::{Descriptors, MatchOptions, match_descriptors};
use veiloc_geometry::Anchor;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};

use super::align::DirectionPair;
use super::overlap::is_one_scene;
use crate::rule::RowHistory;
use crate::schemes::dcl::AnchorAngle;

/// Maximum number of landmarks, about 2 MB. Of more, those of the starts with the most are dropped: images of other
/// scenes must not displace a scene, which would then get more starts than it may.
pub(super) const MAX_LANDMARKS: usize = 16384;
/// With fewer landmarks a start would no longer be recognized: the oldest starts are dropped as a whole then.
const MIN_OF_START: usize = 256;
/// A keypoint this near to its landmark's direction has not moved, degrees: two pixels of a camera with a focal length
/// of 500, five times the detector's error.
const SAME_DEG: f64 = 0.25;
/// A keypoint farther than this from its landmark's direction is another scene point that looks similar, degrees.
const NEARBY_DEG: f64 = 20.0;
/// Ratio-test threshold for matches that determine a rotation, and whether two frames show one scene.
const CLEAR_RATIO: f32 = 0.8;
/// Ratio-test threshold for a match to a point that may have been sent before: the one that attackers use too.
const SENT_RATIO: f32 = 0.9;
/// Maximum distance between descriptors of one landmark, relative to their length.
const LANDMARK_DISTANCE: f32 = 0.7;
/// Below this distance, relative to their length, descriptors belong to one keypoint regardless of other neighbours.
const KEYPOINT_DISTANCE: f32 = 0.35;

/// A keypoint for which a row was sent.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Landmark {
    /// Direction in the layout's frame at which it was seen when its row was sent.
    pub(super) direction: Vector3<f64>,
    pub(super) sent: AnchorAngle,
    /// Index of the session start (layout placement) at which the row was sent.
    pub(super) start: u32,
    /// The last frame that showed it.
    pub(super) seen: u32,
}

/// All landmarks of a session.
#[derive(Clone, PartialEq, Default)]
pub(super) struct Memory {
    pub(super) landmarks: Vec<Landmark>,
    /// `[landmarks]`; `None` while there are no landmarks.
    pub(super) descriptors: Option<Descriptors>,
}

/// Keypoints of a frame matched to landmarks.
pub(super) struct LandmarkMatches {
    /// By keypoint: landmark and distance ratio to the second nearest, 0 to 1.
    by_keypoint: Vec<Option<(usize, f32)>>,
    /// Landmarks of the requested start.
    candidates: Vec<usize>,
}

impl Memory {
    /// Matches these descriptors to the landmarks of a start.
    pub(super) fn matched(&self, descriptors: &Descriptors, start: u32) -> LandmarkMatches {
        let candidates: Vec<usize> =
            (0..self.landmarks.len()).filter(|i| self.landmarks[*i].start == start).collect();
        let mut by_keypoint = vec![None; descriptors.len()];
        if let Some(all) = self.descriptors.as_ref().filter(|all| all.kind() == descriptors.kind()) {
            let database = all.select(candidates.iter().copied());
            for m in match_descriptors(descriptors.view(), database.view(), &MatchOptions::default()) {
                by_keypoint[m.query as usize] = Some((candidates[m.database as usize], m.ratio));
            }
        }
        LandmarkMatches { by_keypoint, candidates }
    }

    /// Direction pairs of clear matches; `seen` are the directions of the keypoints in the camera, where they have one.
    pub(super) fn pairs(
        &self,
        matched: &LandmarkMatches,
        seen: &[Option<Vector3<f64>>],
    ) -> Vec<DirectionPair> {
        let clear = matched.by_keypoint.iter().zip(seen).filter_map(|(landmark, camera)| {
            let (index, _) = landmark.filter(|(_, ratio)| *ratio <= CLEAR_RATIO)?;
            Some(DirectionPair { layout: self.landmarks[index].direction, camera: (*camera)? })
        });
        clear.collect()
    }

    /// All starts that have landmarks.
    fn starts(&self) -> BTreeSet<u32> {
        self.landmarks.iter().map(|landmark| landmark.start).collect()
    }

    /// Number of remembered starts whose scene these keypoints show; `seen` are their directions in the camera, where
    /// they have one.
    pub(super) fn overlapping(&self, descriptors: &Descriptors, seen: &[Option<Vector3<f64>>]) -> u32 {
        let shows = |start: &u32| is_one_scene(&self.pairs(&self.matched(descriptors, *start), seen));
        self.starts().into_iter().filter(shows).count() as u32
    }

    /// Which of these descriptors were probably sent by an earlier start and not by this one, whose matches are given.
    pub(super) fn sent_before(
        &self,
        descriptors: &Descriptors,
        start: u32,
        matched: &LandmarkMatches,
    ) -> Vec<bool> {
        let mut sent = vec![false; descriptors.len()];
        for earlier in self.starts().into_iter().filter(|s| *s < start) {
            let earlier = self.matched(descriptors, earlier).by_keypoint;
            for ((sent, landmark), own) in sent.iter_mut().zip(earlier).zip(&matched.by_keypoint) {
                let is_clear = |m: Option<(usize, f32)>| m.is_some_and(|(_, ratio)| ratio <= SENT_RATIO);
                // Nearly every descriptor has some nearest neighbour among this start's landmarks: only a clear match
                // counts.
                *sent |= !is_clear(*own) && is_clear(landmark);
            }
        }
        sent
    }

    /// How each keypoint is sent, and the landmark that decides it. `anchor_of`: the anchor of a keypoint by its
    /// position in the image.
    pub(super) fn row_histories(
        &self,
        matched: &LandmarkMatches,
        descriptors: &Descriptors,
        seen: &[Option<Vector3<f64>>],
        cam_from_layout: &Rotation3<f64>,
        anchor_of: impl Fn(usize) -> Option<Anchor>,
    ) -> Vec<(RowHistory, Option<usize>)> {
        let [same, nearby] = [SAME_DEG, NEARBY_DEG].map(|degrees| degrees.to_radians().cos());
        let one = |(i, camera): (usize, &Option<Vector3<f64>>)| {
            let Some(camera) = camera else { return (RowHistory::New, None) };
            let direction = cam_from_layout.inverse() * camera;
            let cosine = |landmark: &usize| self.landmarks[*landmark].direction.dot(&direction);
            let own = matched.by_keypoint[i].filter(|(l, _)| cosine(l) >= nearby);
            // Most ambiguous matches are wrong, and half of the wrong ones have another anchor: they would remove too
            // many rows.
            let ratio_match = own.filter(|(_, ratio)| *ratio <= SENT_RATIO).map(|(landmark, _)| landmark);
            // Another keypoint may have matched its landmark, or it may have matched another's.
            let by_direction = || {
                let near = matched.candidates.iter().copied().filter(|l| cosine(l) >= same);
                near.map(|l| (self.distance(l, descriptors, i), l))
                    .filter(|(distance, _)| *distance < LANDMARK_DISTANCE * descriptors.kind().norm() as f32)
                    .min_by(|a, b| a.0.total_cmp(&b.0))
                    .map(|(_, landmark)| landmark)
            };
            let at_direction =
                own.map(|(landmark, _)| landmark).filter(|l| cosine(l) >= same).or_else(by_direction);
            let what = match (at_direction, ratio_match) {
                (Some(landmark), _) => RowHistory::Repeat(self.landmarks[landmark].sent),
                (None, Some(landmark)) => {
                    let sent = self.landmarks[landmark].sent.anchor;
                    let changes = anchor_of(i).is_some_and(|own| own != sent);
                    if changes { RowHistory::OtherAnchor } else { RowHistory::New }
                }
                (None, None) => RowHistory::New,
            };
            // A keypoint that repeats another one's row is stored as well; otherwise a later start would not recognize
            // it.
            let is_known = |l: &usize| {
                own.is_some_and(|(own, _)| own == *l)
                    || self.distance(*l, descriptors, i)
                        < KEYPOINT_DISTANCE * descriptors.kind().norm() as f32
            };
            (what, at_direction.filter(is_known).or(ratio_match))
        };
        seen.iter().enumerate().map(one).collect()
    }

    /// Distance between a landmark's descriptor and a descriptor of a frame.
    fn distance(&self, landmark: usize, descriptors: &Descriptors, row: usize) -> f32 {
        let Some(own) = self.descriptors.as_ref() else { return f32::INFINITY };
        let pairs = own.row(landmark).iter().zip(descriptors.row(row));
        let sum: u32 = pairs.map(|(a, b)| u32::from(a.abs_diff(*b)).pow(2)).sum();
        (sum as f32).sqrt()
    }

    /// Stores what was sent. `rows`: index among `descriptors`, its landmark, its direction in the layout's frame, and
    /// the row that was sent.
    pub(super) fn remember(
        &mut self,
        rows: impl Iterator<Item = (usize, Option<usize>, Vector3<f64>, AnchorAngle)>,
        descriptors: &Descriptors,
        (start, frame): (u32, u32),
    ) {
        let all = self.descriptors.take().filter(|all| all.kind() == descriptors.kind());
        let mut all = all.unwrap_or_else(|| Descriptors::empty(descriptors.kind()));
        self.landmarks.truncate(all.len());
        let mut moved = BTreeSet::new();
        for (row, known, direction, sent) in rows {
            match known {
                // The first direction stays; updating it would let it drift in small steps.
                Some(landmark) if self.landmarks[landmark].sent == sent => {
                    self.landmarks[landmark].seen = frame;
                }
                _ => {
                    all.push(descriptors.row(row)).expect("of one kind");
                    self.landmarks.push(Landmark { direction, sent, start, seen: frame });
                    moved.extend(known);
                }
            }
        }
        let mut keep: Vec<usize> = (0..self.landmarks.len()).filter(|i| !moved.contains(i)).collect();
        if keep.len() > MAX_LANDMARKS {
            keep = self.spread_over_starts(keep);
        }
        self.descriptors = Some(all.select(keep.iter().copied()));
        self.landmarks = keep.iter().map(|i| self.landmarks[*i].clone()).collect();
    }

    /// At most [`MAX_LANDMARKS`] of these landmarks, in order: as many of each start, and all of starts with fewer. Of a
    /// start those that were seen last, the strongest of a frame first.
    fn spread_over_starts(&self, landmarks: Vec<usize>) -> Vec<usize> {
        let mut by_start: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
        for landmark in landmarks {
            by_start.entry(self.landmarks[landmark].start).or_default().push(landmark);
        }
        while by_start.len() > MAX_LANDMARKS / MIN_OF_START {
            by_start.pop_first();
        }
        let mut sizes: Vec<usize> = by_start.values().map(Vec::len).collect();
        sizes.sort_unstable();
        let (mut left, mut most) = (MAX_LANDMARKS, usize::MAX);
        for (i, size) in sizes.iter().enumerate() {
            let equal = left / (sizes.len() - i);
            if *size > equal {
                most = equal;
                break;
            }
            left -= size;
        }
        let mut keep = Vec::new();
        for mut of_start in by_start.into_values() {
            of_start.sort_by_key(|landmark| std::cmp::Reverse(self.landmarks[*landmark].seen));
            of_start.truncate(most);
            keep.extend(of_start);
        }
        keep.sort_unstable();
        keep
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use veiloc_descriptor::DescriptorKind;

    use super::*;

    const ROWS: usize = 1024;

    /// An image of this scene: descriptors, and directions in the camera.
    fn image(scene: u64) -> (Descriptors, Vec<Vector3<f64>>) {
        let mut rng = ChaCha8Rng::seed_from_u64(scene);
        let bytes = (0..ROWS * 128).map(|_| rng.random_range(0..=90)).collect();
        let mut any = |most: f64| most * rng.random_range(-1.0..=1.0);
        let directions = (0..ROWS).map(|_| Vector3::new(any(0.6), any(0.45), 1.0).normalize()).collect();
        (Descriptors::new(DescriptorKind::ROOT_SIFT, bytes).expect("whole rows"), directions)
    }

    fn remember(memory: &mut Memory, scene: u64, start: u32) {
        let (descriptors, directions) = image(scene);
        let sent = AnchorAngle { anchor: Anchor::FIRST, angle: 1.0 };
        let rows = directions.into_iter().enumerate().map(|(row, direction)| (row, None, direction, sent));
        memory.remember(rows, &descriptors, (start, start));
    }

    /// A scene that was sealed first is recognized after images of many others.
    #[test]
    fn other_scenes_displace_no_scene() {
        let mut memory = Memory::default();
        for start in 1..=40 {
            remember(&mut memory, u64::from(start), start);
            assert!(memory.landmarks.len() <= MAX_LANDMARKS);
        }
        assert_eq!(memory.starts().len(), 40);
        for scene in [1, 2, 39, 40] {
            let (descriptors, directions) = image(scene);
            let seen: Vec<_> = directions.into_iter().map(Some).collect();
            assert_eq!(memory.overlapping(&descriptors, &seen), 1, "scene {scene}");
        }
        let (descriptors, directions) = image(77);
        let seen: Vec<_> = directions.into_iter().map(Some).collect();
        assert_eq!(memory.overlapping(&descriptors, &seen), 0, "never sealed");
    }

    #[test]
    fn landmarks_are_shared_by_starts_and_the_strongest_stay() {
        let mut memory = Memory::default();
        // Two starts with few landmarks keep them all.
        let sizes = [100, 20_000, 9_000, 1];
        let sent = AnchorAngle { anchor: Anchor::FIRST, angle: 1.0 };
        let landmark =
            |start: usize| Landmark { direction: Vector3::z(), sent, start: start as u32, seen: 1 };
        for (start, size) in sizes.iter().enumerate() {
            memory.landmarks.extend((0..*size).map(|_| landmark(start)));
        }
        let kept = memory.spread_over_starts((0..memory.landmarks.len()).collect());
        assert!(kept.windows(2).all(|pair| pair[0] < pair[1]), "in order");
        let of = |start: u32| -> Vec<usize> {
            kept.iter().copied().filter(|i| memory.landmarks[*i].start == start).collect()
        };
        let equal = (MAX_LANDMARKS - 101) / 2;
        assert_eq!([0, 1, 2, 3].map(|start| of(start).len()), [100, equal, equal, 1]);
        assert_eq!(of(1), (100..100 + equal).collect::<Vec<_>>(), "the first, strongest ones");
        // Too many starts: the oldest are forgotten.
        let most = MAX_LANDMARKS / MIN_OF_START;
        memory.landmarks = (0..(most + 3) * 300).map(|i| landmark(i / 300)).collect();
        let kept = memory.spread_over_starts((0..memory.landmarks.len()).collect());
        assert_eq!(kept.len(), MAX_LANDMARKS);
        assert!(kept.iter().all(|i| memory.landmarks[*i].start >= 3));
    }
}
