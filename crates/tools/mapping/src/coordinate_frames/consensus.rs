//! Compares given with localized poses of images, and finds the groups whose poses are in another coordinate frame.

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::deviations::{position_sd, rotation_sd_degrees};
use veiloc_geometry::nalgebra::Matrix6;

use super::similarity::{Fit, PosePair, Similarity3, fit};

/// The given and the localized pose of an image.
#[derive(Debug, Clone)]
pub(crate) struct Comparison {
    /// Index of the image.
    pub(crate) image: usize,
    pair: PosePair,
}

impl Comparison {
    /// `None` if a direction of the pose is not determined. `scale`: the typical distance of observed points, map
    /// units.
    pub(crate) fn new(
        image: usize,
        given: CameraFromWorld,
        in_map: CameraFromWorld,
        covariance: &[[f64; 6]; 6],
        scale: f64,
    ) -> Option<Self> {
        let floor = |i: usize| if i < 3 { MIN_ROTATION_SD_DEG.to_radians() } else { MIN_CENTER_SD * scale };
        let covariance: [[f64; 6]; 6] = std::array::from_fn(|i| {
            std::array::from_fn(|j| covariance[i][j] + if i == j { floor(i).powi(2) } else { 0.0 })
        });
        let matrix = Matrix6::from_fn(|i, j| covariance[i][j]);
        if !matrix.iter().all(|c| c.is_finite()) {
            return None;
        }
        let information = matrix.cholesky()?.inverse();
        let (center_sd, rotation_sd) =
            (position_sd(&covariance), rotation_sd_degrees(&covariance).to_radians());
        Some(Self { image, pair: PosePair { given, in_map, center_sd, rotation_sd, information } })
    }

    /// Distance between the localized pose and the transformed given one, in standard deviations.
    fn deviations(&self, map_from_given: &Similarity3) -> f64 {
        self.pair.squared_distance(map_from_given).sqrt()
    }

    /// Whether the given pose differs by much more than the uncertainty and by a relevant amount.
    fn is_relevant(&self, scale: f64) -> bool {
        let angle = self.pair.given.rotation_error_degrees(&self.pair.in_map);
        self.deviations(&Similarity3::identity()) >= MIN_FRAME_DEVIATIONS
            && (self.distance() >= MIN_DISTANCE * scale || angle >= MIN_ANGLE_DEG)
    }

    /// Distance between the centres of the given and the localized pose, map units.
    pub(crate) fn distance(&self) -> f64 {
        self.pair.given.translation_error(&self.pair.in_map)
    }

    fn agrees(&self, map_from_given: &Similarity3) -> bool {
        self.deviations(map_from_given) <= MAX_DEVIATIONS
    }
}

/// Images whose given poses agree on another coordinate frame.
#[derive(Debug, Clone)]
pub(crate) struct FoundCoordinateFrame {
    /// Indices into the comparisons.
    pub(crate) members: Vec<usize>,
    pub(crate) fit: Fit,
    /// Median distance that the similarity moves their centres, map units.
    pub(crate) distance: f64,
    /// Its standard deviation.
    pub(crate) distance_sd: f64,
}

/// Result of comparing the given poses of images with their localized ones.
#[derive(Debug, Clone, Default)]
pub(crate) struct Comparisons {
    /// Images whose poses agree; indices into the comparisons.
    pub(crate) agreeing: Vec<usize>,
    /// Groups in another coordinate frame, the largest first.
    pub(crate) frames: Vec<FoundCoordinateFrame>,
    /// Images that agree on another coordinate frame that is only a little away.
    pub(crate) near: Vec<usize>,
    /// Images whose poses are wrong or localized wrongly, each for itself.
    pub(crate) disagreeing: Vec<usize>,
}

/// Finds the images that agree with the map's coordinate frame, and the groups that agree on another one. `scale`: the typical
/// distance of observed points, map units.
pub(crate) fn compare(comparisons: &[Comparison], scale: f64) -> Comparisons {
    let identity = Similarity3::identity();
    let (agreeing, mut rest): (Vec<usize>, Vec<usize>) =
        (0..comparisons.len()).partition(|i| comparisons[*i].agrees(&identity));
    let mut result = Comparisons { agreeing, ..Comparisons::default() };
    while let Some((found, members)) = largest_consensus(comparisons, &rest) {
        // Two poses cannot agree by chance with each other; one of many may be wrong.
        let enough = members.len() >= MIN_MEMBERS || members.len() == comparisons.len();
        if !enough {
            break;
        }
        rest.retain(|i| !members.contains(i));
        let frame = frame_of(comparisons, members, found);
        if is_other_coordinate_frame(comparisons, &frame, scale) {
            result.frames.push(frame);
        } else {
            result.near.extend(frame.members);
        }
    }
    result.disagreeing.extend(rest.into_iter().filter(|i| comparisons[*i].is_relevant(scale)));
    result.near.sort_unstable();
    result
}

/// The coordinate frame on which most of the images agree, however near it is to the map's; `None` unless they are more than half
/// of those that were compared, and three.
pub(crate) fn most_agree(comparisons: &[Comparison]) -> Option<FoundCoordinateFrame> {
    let all: Vec<usize> = (0..comparisons.len()).collect();
    let (found, members) = largest_consensus(comparisons, &all)?;
    let enough = members.len() >= MIN_MEMBERS && 2 * members.len() > comparisons.len();
    enough.then(|| frame_of(comparisons, members, found))
}

/// Whether the frame differs from the map's by much more than the uncertainty and by a relevant amount.
fn is_other_coordinate_frame(comparisons: &[Comparison], frame: &FoundCoordinateFrame, scale: f64) -> bool {
    let identity = Similarity3::identity();
    let deviations = median(frame.members.iter().map(|i| comparisons[*i].deviations(&identity)).collect());
    let found = &frame.fit.map_from_given;
    deviations >= MIN_FRAME_DEVIATIONS
        && (frame.distance >= MIN_DISTANCE * scale || found.angle_deg() >= MIN_ANGLE_DEG)
}

fn frame_of(comparisons: &[Comparison], members: Vec<usize>, found: Fit) -> FoundCoordinateFrame {
    let moved = |i: &usize| {
        let given = &comparisons[*i].pair.given;
        given.translation_error(&found.map_from_given.transform_pose(given))
    };
    // More scatter than the covariances explain makes the mean less certain.
    let squares = members.iter().map(|i| comparisons[*i].deviations(&found.map_from_given).powi(2));
    let scatter = squares.sum::<f64>() / (6 * members.len()) as f64;
    FoundCoordinateFrame {
        distance: median(members.iter().map(moved).collect()),
        distance_sd: found.center_sd * scatter.max(1.0).sqrt(),
        members,
        fit: found,
    }
}

/// The similarity that most of these images agree on, and these images; hypotheses from one and from two images.
fn largest_consensus(comparisons: &[Comparison], among: &[usize]) -> Option<(Fit, Vec<usize>)> {
    let of =
        |members: &[usize]| -> Fit { fit(&members.iter().map(|i| comparisons[*i].pair).collect::<Vec<_>>()) };
    // Single images give rigid hypotheses; pairs also the scale, if single images find no majority.
    let singles = among.iter().map(|i| vec![*i]);
    let pairs = among.iter().enumerate().flat_map(|(k, i)| among[k + 1..].iter().map(|j| vec![*i, *j]));
    let mut best: Option<(Fit, Vec<usize>)> = None;
    for minimal in singles.chain(pairs) {
        let majority = best.as_ref().is_some_and(|(_, members)| 2 * members.len() > among.len());
        if minimal.len() == 2 && majority {
            break;
        }
        let mut members = minimal;
        let mut found = of(&members);
        for round in 0..ROUNDS {
            // A hypothesis from few images is less certain than its refinement.
            let limit = if round == 0 { 3.0 * MAX_DEVIATIONS } else { MAX_DEVIATIONS };
            let now: Vec<usize> = among
                .iter()
                .copied()
                .filter(|i| comparisons[*i].deviations(&found.map_from_given) <= limit)
                .collect();
            if now.is_empty() {
                members = now;
                break;
            }
            let done = now == members && round > 0;
            members = now;
            found = of(&members);
            if done {
                break;
            }
        }
        members.retain(|i| comparisons[*i].agrees(&found.map_from_given));
        if members.len() > best.as_ref().map_or(0, |(_, m)| m.len()) {
            let all = members.len() == among.len();
            best = Some((found, members));
            if all {
                break;
            }
        }
    }
    best
}

/// Upper median; 0 for an empty list.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    veiloc_geometry::statistics::upper_median(&mut values).unwrap_or(0.0)
}

/// Distance up to which a localized pose agrees with a given one: six degrees of freedom, and errors have heavier tails
/// than a normal distribution.
const MAX_DEVIATIONS: f64 = 6.0;
/// Median distance of images in another coordinate frame.
const MIN_FRAME_DEVIATIONS: f64 = 9.0;
/// Distance between two coordinate frames from which images are refused, in units of the typical distance of observed points.
const MIN_DISTANCE: f64 = 0.01;
/// Angle between two coordinate frames from which images are refused, degrees.
const MIN_ANGLE_DEG: f64 = 1.0;
/// Images that must agree on another coordinate frame, unless fewer were localized and all of them agree.
const MIN_MEMBERS: usize = 3;
/// Standard deviation of given orientations, degrees.
const MIN_ROTATION_SD_DEG: f64 = 0.05;
/// Standard deviation of given centres, in units of the typical distance of observed points.
const MIN_CENTER_SD: f64 = 0.001;
/// Rounds of member selection and fit.
const ROUNDS: usize = 4;

#[cfg(test)]
mod tests {
    use super::*;
    use veiloc_geometry::nalgebra::{Rotation3, Vector3};

    const CENTER_SD: f64 = 0.004;

    /// Poses of a walk, given in a frame from which `map_from_given` leads to the map, and localized with an error of
    /// one standard deviation.
    fn walk(range: std::ops::Range<usize>, map_from_given: &Similarity3) -> Vec<Comparison> {
        let covariance: [[f64; 6]; 6] = std::array::from_fn(|i| {
            std::array::from_fn(|j| match (i == j, i < 3) {
                (false, _) => 0.0,
                (true, true) => 0.1_f64.to_radians().powi(2),
                (true, false) => CENTER_SD.powi(2),
            })
        });
        let comparison = |i: usize| {
            let a = i as f64;
            let turn = Rotation3::from_scaled_axis(Vector3::new(0.1 * a.sin(), 0.2 * a, 0.1));
            let given = CameraFromWorld::new(turn, Vector3::new(0.2 * a, 0.3 * a.cos(), (0.7 * a).sin()));
            let signs = [1.0, -1.0, 1.0, -1.0, -1.0, 1.0];
            let step: [f64; 6] = std::array::from_fn(|k| signs[(k + i) % 6] * covariance[k][k].sqrt());
            let in_map = map_from_given.transform_pose(&given).perturbed(&step);
            Comparison::new(i, given, in_map, &covariance, 2.0).unwrap()
        };
        range.map(comparison).collect()
    }

    fn moved(x: f64) -> Similarity3 {
        Similarity3 { translation: Vector3::new(x, 0.0, 0.0), ..Similarity3::identity() }
    }

    fn other_gauge() -> Similarity3 {
        Similarity3 {
            scale: 2.3,
            rotation: Rotation3::from_scaled_axis(Vector3::new(0.0, 1.0, 0.0)),
            translation: Vector3::new(5.0, -3.0, 7.0),
        }
    }

    #[test]
    fn poses_in_the_frame_of_the_map_agree() {
        // Also a small common shift, inside of the uncertainty.
        for map_from_given in [Similarity3::identity(), moved(CENTER_SD)] {
            let found = compare(&walk(0..10, &map_from_given), 2.0);
            assert_eq!((found.agreeing.len(), found.frames.len(), found.disagreeing.len()), (10, 0, 0));
        }
        assert!(compare(&[], 2.0).frames.is_empty());
    }

    #[test]
    fn other_frames_are_found_with_their_distance() {
        for count in [1, 2, 6] {
            for shift in [0.1, 0.3, 1.0] {
                let found = compare(&walk(0..count, &moved(shift)), 2.0);
                let [frame] = found.frames.as_slice() else { panic!("{found:?}") };
                assert_eq!(frame.members.len(), count);
                assert!((frame.distance - shift).abs() < 3.0 * frame.distance_sd, "{frame:?}");
                assert_eq!(frame.fit.map_from_given.scale, 1.0);
                assert_eq!(frame.fit.scale_sd.is_some(), count > 1, "{frame:?}");
            }
        }
        for map_from_given in [other_gauge(), Similarity3 { scale: 0.5, ..Similarity3::identity() }] {
            let found = compare(&walk(0..6, &map_from_given), 2.0);
            let [frame] = found.frames.as_slice() else { panic!("{found:?}") };
            let sd = frame.fit.scale_sd.expect("a walk determines the scale");
            assert!((frame.fit.map_from_given.scale - map_from_given.scale).abs() < 3.0 * sd, "{frame:?}");
        }
    }

    #[test]
    fn groups_are_found_beside_each_other() {
        let all =
            [walk(0..10, &Similarity3::identity()), walk(10..16, &moved(0.3)), walk(16..20, &other_gauge())];
        let found = compare(&all.concat(), 2.0);
        assert_eq!(found.agreeing, (0..10).collect::<Vec<_>>());
        let members: Vec<&[usize]> = found.frames.iter().map(|f| f.members.as_slice()).collect();
        assert_eq!(members, [&[10, 11, 12, 13, 14, 15][..], &[16, 17, 18, 19]]);
        assert!(found.disagreeing.is_empty());
    }

    #[test]
    fn single_wrong_poses_are_no_frame() {
        let wrong = [walk(10..11, &moved(0.3)), walk(11..12, &moved(-0.5)), walk(12..13, &other_gauge())];
        let found = compare(&[walk(0..10, &Similarity3::identity()), wrong.concat()].concat(), 2.0);
        assert_eq!((found.agreeing.len(), found.frames.len()), (10, 0));
        assert_eq!(found.disagreeing, [10, 11, 12]);
    }

    /// More than the uncertainty explains, but too little to refuse.
    #[test]
    fn small_common_shift_is_a_disagreement() {
        let found = compare(&walk(0..6, &moved(0.03)), 10.0);
        assert!(found.frames.is_empty() && found.disagreeing.is_empty(), "{found:?}");
        assert!(found.near.len() >= 4, "{found:?}");
    }
}
