//! Duplicates among the matches: one match that was given many times, and many matches on one spot.
//!
//! A map point is seen at one place of the image. Lists of matches that were joined from several sources contain the
//! same match many times, and an object that was moved, or one patch of repeated texture, gives many matches of nearly
//! one map point at nearly one place. Such matches have one cause: they are right together or wrong together, and a few
//! of them hold nearly all of their information. Counted one by one, 110 wrong ones outvote 140 right ones that are all
//! over the image, because a pose is free to explain any single spot exactly.

use std::collections::HashMap;

use veiloc_geometry::Point3;
use veiloc_geometry::frames::World;

use crate::likelihood::{Correspondences, PoseProblem};

/// Matches that are kept of one map point, and of one spot. A keypoint may be sent as several lines, and SIFT gives up
/// to four orientations to one position.
const MAX_DUPLICATES: usize = 4;

/// Side of a spot in the image, as a share of the width: 8 pixels of 640.
const SPOT: f64 = 1.0 / 80.0;

/// Side of a spot in space, as a share of the region of the matched points: 6 mm of 6 m.
const SPOT_IN_SPACE: f64 = 1e-3;

/// Side of the cells of [`spread`], in spots.
const COARSE: f64 = 5.0;

/// A problem without duplicates.
pub(crate) struct WithoutDuplicates {
    pub(crate) problem: PoseProblem,
    /// For each match of the given problem, `[N]`: the match of [`Self::problem`] that stands for it, if there is one.
    stands_for: Vec<Option<usize>>,
}

impl WithoutDuplicates {
    /// The problem without duplicates; `None` if it has none. The most probable matches are kept, the first ones of equals.
    pub(crate) fn of(problem: &PoseProblem) -> Option<Self> {
        let n = problem.points.len();
        let mut order: Vec<usize> = (0..n).collect();
        if let Some(prior) = &problem.prior {
            order.sort_by(|a, b| prior[*b].total_cmp(&prior[*a]));
        }
        let point = |i: usize| -> Group {
            let [x, y, z] = bits(&problem.points[i]);
            [x, y, z, 0, 0, 0, 0]
        };
        let pair = |i: usize| -> Group {
            let ([x, y, z], [kind, a, b, c]) =
                (bits(&problem.points[i]), observation(&problem.observations, i));
            [x, y, z, kind, a, b, c]
        };
        let mut kept = at_most(1, order, pair);
        let distinct = kept.len();
        kept = at_most(MAX_DUPLICATES, kept, point);
        if let Some(fine) = SpatialCells::of(problem) {
            // A spot on the border of a grid's cells lies inside the cells of a grid shifted by half of them.
            for shift in [0.0, 0.5] {
                kept = at_most(MAX_DUPLICATES, kept, |i| fine.cell(i, shift));
            }
        }
        if kept.len() == n {
            return None;
        }
        kept.sort_unstable();
        let mut stands_for = vec![None; n];
        kept.iter().enumerate().for_each(|(k, &i)| stands_for[i] = Some(k));
        if distinct < n {
            let places: HashMap<Group, usize> = kept.iter().enumerate().map(|(k, &i)| (pair(i), k)).collect();
            for (i, place) in stands_for.iter_mut().enumerate() {
                *place = place.or_else(|| places.get(&pair(i)).copied());
            }
        }
        Some(Self { problem: problem.subset(&kept), stands_for })
    }

    /// Flags of the given problem's matches, `[N]`, from those of the problem without duplicates. Of more than
    /// [`MAX_DUPLICATES`] different matches on one spot, those that were left out have no flag.
    pub(crate) fn expand(&self, flags: &[bool]) -> Vec<bool> {
        self.stands_for.iter().map(|kept| kept.is_some_and(|k| flags[k])).collect()
    }
}

/// The first [`MAX_DUPLICATES`] of these matches in each cell of a grid whose cells are five times as large as spots: matches
/// that support a second pose must be spread, because a pose is free to explain any single spot exactly.
pub(crate) fn spread(problem: &PoseProblem, matches: Vec<usize>) -> Vec<usize> {
    let Some(fine) = SpatialCells::of(problem) else { return matches };
    let cells = SpatialCells { scale: COARSE, side: COARSE * fine.side, ..fine };
    [0.0, 0.5]
        .into_iter()
        .fold(matches, |kept, shift| at_most(MAX_DUPLICATES, kept, |i| cells.cell(i, shift)))
}

/// A group of matches: equal numbers for matches of one group.
type Group = [u64; 7];

/// The first `most` matches of each group, in their order.
fn at_most(most: usize, mut matches: Vec<usize>, group: impl Fn(usize) -> Group) -> Vec<usize> {
    // Nearly all groups are small, and a table of counts shows it: only where it holds more is the group itself looked up.
    let mask = (4 * matches.len()).next_power_of_two() - 1;
    let bucket = |i: usize| {
        let mixed =
            |hash: u64, number: u64| (hash.rotate_left(5) ^ number).wrapping_mul(0x517c_c1b7_2722_0a95);
        (group(i).into_iter().fold(0, mixed) >> 20) as usize & mask
    };
    let mut counts = vec![0_u32; mask + 1];
    let buckets: Vec<usize> = matches.iter().map(|&i| bucket(i)).collect();
    for &bucket in &buckets {
        counts[bucket] += 1;
    }
    let mut of_group: HashMap<Group, usize> = HashMap::new();
    let mut buckets = buckets.into_iter();
    matches.retain(|&i| {
        let is_small = buckets.next().is_some_and(|bucket| counts[bucket] as usize <= most);
        is_small || {
            let count = of_group.entry(group(i)).or_insert(0);
            *count += 1;
            *count <= most
        }
    });
    matches
}

fn bits(point: &Point3<World>) -> [u64; 3] {
    [point.coords.x, point.coords.y, point.coords.z].map(f64::to_bits)
}

/// Numbers that are equal for equal observations.
fn observation(of: &Correspondences, i: usize) -> [u64; 4] {
    match of {
        Correspondences::Points { pixels } => [0, pixels[i].u.to_bits(), pixels[i].v.to_bits(), 0],
        Correspondences::Lines { lines } => {
            let line = lines[i].coefficients();
            [0, line.x.to_bits(), line.y.to_bits(), line.z.to_bits()]
        }
        Correspondences::Anchored { lines, .. } => [lines[i].0.index() as u64, lines[i].1.to_bits(), 0, 0],
    }
}

/// Cells of a grid in the image and in space.
struct SpatialCells<'a> {
    problem: &'a PoseProblem,
    /// Side of a cell in the image, in spots.
    scale: f64,
    /// Side of a cell in space, map units.
    side: f64,
}

impl<'a> SpatialCells<'a> {
    /// `None` when the points have no extent.
    fn of(problem: &'a PoseProblem) -> Option<Self> {
        let extent = |axis: usize| {
            let mut values: Vec<f64> = problem.points.iter().map(|p| p.coords[axis]).collect();
            let last = values.len().checked_sub(1)?;
            let mut at = |rank: usize| *values.select_nth_unstable_by(rank, f64::total_cmp).1;
            Some(at(last - last / 20) - at(last / 20))
        };
        let side = (0..3).filter_map(extent).fold(0.0, f64::max) * SPOT_IN_SPACE;
        (side > 0.0 && side.is_finite()).then_some(Self { problem, scale: 1.0, side })
    }

    /// The cell of a match in the grid that is shifted by this share of a cell.
    fn cell(&self, i: usize, shift: f64) -> Group {
        let index = |value: f64, side: f64| (value / side + shift).floor() as i64 as u64;
        let size = self.scale * SPOT * f64::from(self.problem.camera.width);
        let (kind, u, v) = match &self.problem.observations {
            Correspondences::Points { pixels } => (0, index(pixels[i].u, size), index(pixels[i].v, size)),
            Correspondences::Anchored { lines, .. } => {
                // The width of a cell at half of the image's height from the anchor.
                let angle = size / (0.5 * f64::from(self.problem.camera.height));
                (lines[i].0.index() as u64, index(lines[i].1, angle), 0)
            }
            // A line of any direction says nothing about the place along it: each is a spot of its own.
            Correspondences::Lines { .. } => (0, i as u64, 0),
        };
        let point = self.problem.points[i].coords;
        [kind, u, v, 0, index(point.x, self.side), index(point.y, self.side), index(point.z, self.side)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use veiloc_geometry::{Pinhole, Pixel};

    const CAMERA: Pinhole =
        Pinhole { width: 640, height: 480, focal: [525.0, 525.0], principal: [320.0, 240.0] };

    fn problem(pixels: Vec<Pixel>, points: Vec<[f64; 3]>) -> PoseProblem {
        let points = points.into_iter().map(|[x, y, z]| Point3::from_vector([x, y, z].into())).collect();
        let keypoints = (0..pixels.len()).collect();
        PoseProblem::new(CAMERA, Correspondences::Points { pixels }, keypoints, points)
    }

    /// Matches all over the image and the scene.
    fn spread() -> (Vec<Pixel>, Vec<[f64; 3]>) {
        let pixels = (0..60).map(|i| Pixel::new(10.0 * f64::from(i), 5.0 + 7.0 * f64::from(i)));
        let points = (0..60).map(|i| [0.1 * f64::from(i), f64::from(i % 7), f64::from(i % 5)]);
        (pixels.collect(), points.collect())
    }

    #[test]
    fn matches_all_over_the_image_are_kept() {
        let (pixels, points) = spread();
        assert!(WithoutDuplicates::of(&problem(pixels, points)).is_none());
    }

    #[test]
    fn equal_matches_are_one_and_share_their_flag() {
        let (mut pixels, mut points) = spread();
        for _ in 0..9 {
            pixels.push(pixels[3]);
            points.push(points[3]);
        }
        let mut given = problem(pixels, points);
        let mut prior = vec![0.5; 69];
        prior[65] = 0.9;
        given.prior = Some(prior);
        let without = WithoutDuplicates::of(&given).expect("duplicates");
        assert_eq!(without.problem.points.len(), 60);
        assert_eq!(
            without.problem.prior.as_ref().expect("kept")[59],
            0.9,
            "the most probable duplicate is kept"
        );
        let mut flags = vec![false; 60];
        flags[59] = true;
        let expanded = without.expand(&flags);
        let flagged: Vec<usize> = (0..69).filter(|&i| expanded[i]).collect();
        assert_eq!(flagged, [vec![3], (60..69).collect()].concat());
    }

    #[test]
    fn few_matches_are_kept_of_one_point_and_of_one_spot() {
        let (pixels, points) = spread();
        let (mut one_point, mut places) = (points.clone(), pixels.clone());
        let (mut one_spot, mut spot) = (points, pixels);
        for i in 0..50 {
            places.push(Pixel::new(12.0 * f64::from(i), 470.0 - 9.0 * f64::from(i)));
            one_point.push([2.0, 3.0, 1.0]);
            // On the corner of a cell.
            spot.push(Pixel::new(
                320.0 + 0.02 * f64::from(i % 7) - 0.06,
                240.0 + 0.02 * f64::from(i % 5) - 0.04,
            ));
            one_spot.push([3.0 + 1e-5 * f64::from(i), 3.0, 1.0]);
        }
        let kept =
            |pixels, points| WithoutDuplicates::of(&problem(pixels, points)).map(|w| w.problem.points.len());
        assert_eq!(kept(places, one_point), Some(64));
        assert!(kept(spot, one_spot).is_some_and(|n| n <= 60 + 2 * MAX_DUPLICATES));
    }

    #[test]
    fn points_without_extent_are_limited_too() {
        let pixels: Vec<Pixel> = (0..30).map(|i| Pixel::new(20.0 * f64::from(i), 9.0)).collect();
        let without = WithoutDuplicates::of(&problem(pixels, vec![[1.0; 3]; 30])).expect("duplicates");
        assert_eq!(without.problem.points.len(), MAX_DUPLICATES);
    }
}
