//! Selects the image pairs to match: images of the same scene part from sufficiently different positions.
//!
//! The overlap of two images is estimated with **seeds**, some scene points that an image observes: their projections
//! into another image show the visible share, and the angle. If a model has no points yet, each image is first matched
//! with a few images at various distances, and the points of those matches are the seeds.

use std::collections::BTreeSet;

use rayon::prelude::*;
use veiloc_geometry::nalgebra::Vector3;

use crate::triangulation::view::View;

/// Known points of each image, `[images]`.
pub(crate) type Seeds = Vec<Vec<Vector3<f64>>>;

/// Pairs for the first seeds: each image of `focus` gets near and far partners (ranks 1, 2, 4, 8, ...) by pose
/// difference, among the images with a similar viewing direction.
pub(crate) fn pairs_by_pose(views: &[View], focus: &[u32]) -> Vec<(u32, u32)> {
    let axis = |v: &View| v.ray(&veiloc_geometry::nalgebra::Vector2::zeros()).normalize();
    let axes: Vec<Vector3<f64>> = views.iter().map(axis).collect();
    let typical = typical_distance(views);
    let min_cos = MAX_AXIS_ANGLE_DEG.to_radians().cos();
    let partners = |&i: &u32| -> Vec<(u32, u32)> {
        let own = i as usize;
        let mut ranked: Vec<(f64, u32)> = (0..views.len() as u32)
            .filter(|j| *j != i)
            .filter_map(|j| {
                let other = j as usize;
                let cos = axes[own].dot(&axes[other]);
                (cos >= min_cos).then(|| {
                    let angle = cos.clamp(-1.0, 1.0).acos().to_degrees();
                    let distance = (views[own].center - views[other].center).norm() / typical;
                    (distance + angle / 20.0, j)
                })
            })
            .collect();
        ranked.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
        let ranks = (0..FIRST_PARTNERS).map(|power| (1 << power) - 1);
        ranks.map_while(|rank| ranked.get(rank)).map(|(_, j)| (i.min(*j), i.max(*j))).collect()
    };
    let chosen: Vec<Vec<(u32, u32)>> = focus.par_iter().map(partners).collect();
    deduplicated(chosen)
}

fn deduplicated(chosen: Vec<Vec<(u32, u32)>>) -> Vec<(u32, u32)> {
    chosen.into_iter().flatten().collect::<BTreeSet<_>>().into_iter().collect()
}

/// Returns for each image of `focus` up to `limit` partners: most by overlap, the last third spread over lower ranks,
/// which are farther away or come from another visit.
pub(crate) fn pairs_by_seeds(views: &[View], seeds: &Seeds, focus: &[u32], limit: usize) -> Vec<(u32, u32)> {
    let bounds: Vec<Option<Bounds>> =
        views.par_iter().zip(seeds).map(|(v, own)| Bounds::of(v, own)).collect();
    let overlap_of = |i: usize, j: usize| -> f64 {
        let all = &seeds[i];
        if !bounds[i].is_some_and(|bounds| bounds.may_be_visible_from(&views[j])) {
            return 0.0;
        }
        // Most pairs do not overlap, and a few seeds suffice to detect this: with a useful overlap at least one of them
        // is almost certainly visible.
        let coarse = all.iter().step_by(all.len().div_ceil(FIRST_SEEDS).max(1));
        if !coarse.into_iter().any(|x| views[j].pixel_inside(x).is_some()) {
            return 0.0;
        }
        let step = all.len().div_ceil(MAX_SEEDS).max(1);
        let overlap: f64 = all.iter().step_by(step).map(|x| seed_weight(&views[i], &views[j], x)).sum();
        overlap / all.len().div_ceil(step).max(MIN_SEEDS) as f64
    };
    let chosen: Vec<Vec<(u32, u32)>> = focus
        .par_iter()
        .map(|&i| {
            let mut ranked: Vec<(f64, u32)> = (0..views.len() as u32)
                .filter(|j| *j != i)
                .map(|j| {
                    let (a, b) = (i as usize, j as usize);
                    (f64::midpoint(overlap_of(a, b), overlap_of(b, a)), j)
                })
                .filter(|(overlap, _)| *overlap >= MIN_OVERLAP)
                .collect();
            ranked.sort_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
            choose(ranked.len(), limit).map(|r| (i.min(ranked[r].1), i.max(ranked[r].1))).collect()
        })
        .collect();
    deduplicated(chosen)
}

/// Bounds of the seeds of an image: an image that is too far away to recognize any of them is rejected at once. Without
/// this, pair selection for ten thousand images takes minutes.
#[derive(Debug, Clone, Copy)]
struct Bounds {
    center: Vector3<f64>,
    radius: f64,
    /// Largest size of a pixel at a seed, world units.
    pixel: f64,
}

impl Bounds {
    /// Returns `None` without seeds.
    fn of(from: &View, seeds: &[Vector3<f64>]) -> Option<Self> {
        if seeds.is_empty() {
            return None;
        }
        let center = seeds.iter().sum::<Vector3<f64>>() / seeds.len() as f64;
        let farthest = |from: &Vector3<f64>| seeds.iter().map(|x| (x - from).norm()).fold(0.0, f64::max);
        Some(Self { center, radius: farthest(&center), pixel: pixel_at(from, farthest(&from.center)) })
    }

    /// Returns false only if [`seed_weight`] is 0 for all seeds.
    fn may_be_visible_from(&self, to: &View) -> bool {
        let nearest = (self.center - to.center).norm() - self.radius;
        pixel_at(to, nearest) <= MAX_ZOOM * self.pixel * (1.0 + 1e-9)
    }
}

/// Size of a pixel at a distance, world units.
fn pixel_at(view: &View, distance: f64) -> f64 {
    distance / view.mean_focal()
}

/// Ranks: the first two thirds of `limit`, then evenly spaced ones.
fn choose(count: usize, limit: usize) -> impl Iterator<Item = usize> {
    let best = if count <= limit { count } else { limit - limit / 3 };
    let rest = limit.min(count) - best;
    (0..best).chain((1..=rest).map(move |k| best - 1 + k * (count - best) / rest.max(1)))
}

/// 1 for a seed that both images see under a good angle; less for angles with poor triangulation or poor descriptor
/// similarity; 0 if the other image does not see it.
fn seed_weight(from: &View, to: &View, seed: &Vector3<f64>) -> f64 {
    let (a, b) = (from.center - seed, to.center - seed);
    let zoom = pixel_at(to, b.norm()) / pixel_at(from, a.norm());
    if zoom > MAX_ZOOM || to.pixel_inside(seed).is_none() {
        return 0.0;
    }
    let cos = a.normalize().dot(&b.normalize());
    match cos.clamp(-1.0, 1.0).acos().to_degrees() {
        angle if angle < 2.0 => 0.3 + 0.35 * angle,
        angle if angle < 25.0 => 1.0,
        angle if angle < 60.0 => 1.0 - (angle - 25.0) / 35.0 * 0.9,
        _ => 0.0,
    }
}

/// Median distance of each image to its nearest neighbour, or 1 if all are at the same position.
fn typical_distance(views: &[View]) -> f64 {
    let nearest = |i: usize| {
        let others = views.iter().enumerate().filter(|(j, _)| *j != i);
        others.map(|(_, v)| (v.center - views[i].center).norm()).fold(f64::INFINITY, f64::min)
    };
    let mut all: Vec<f64> = (0..views.len()).into_par_iter().map(nearest).collect();
    all.sort_by(f64::total_cmp);
    // The nearest neighbours in a burst of images are not representative: use five times the median.
    all.get(all.len() / 2).map(|m| 5.0 * m).filter(|m| m.is_finite() && *m > 0.0).unwrap_or(1.0)
}

/// Maximum scale difference at which a point is recognized, twice the tolerance of the features: beyond it, a
/// keypoint's neighbourhood is only one or two pixels.
const MAX_ZOOM: f64 = 8.0;
/// Maximum angle between optical axes of pairs without seeds.
const MAX_AXIS_ANGLE_DEG: f64 = 60.0;
/// Partners of each image in the first round: ranks 1, 2, 4, 8, 16, 32.
const FIRST_PARTNERS: usize = 6;
/// Maximum number of projected seeds per image; more do not make the overlap more precise.
const MAX_SEEDS: usize = 200;
/// Number of seeds that are projected first.
const FIRST_SEEDS: usize = 30;
/// Minimum denominator of the overlap: an image with fewer seeds is not overrated.
pub(crate) const MIN_SEEDS: usize = 20;
/// Minimum overlap of a matched pair.
const MIN_OVERLAP: f64 = 0.05;

#[cfg(test)]
mod tests {
    use super::*;

    use veiloc_geometry::nalgebra::Rotation3;
    use veiloc_geometry::{CameraFromWorld, Intrinsics};

    fn view(center: Vector3<f64>, target: Vector3<f64>) -> View {
        let camera: Intrinsics = "SIMPLE_PINHOLE,640,480,500,320,240".parse().unwrap();
        let look = Rotation3::look_at_lh(&(target - center), &Vector3::y());
        View::new(camera, CameraFromWorld::new(look, -(look * center)), &[], 3.0, 3.0)
    }

    /// Two rows of cameras back to back, each in front of its own wall.
    fn two_walls() -> (Vec<View>, Seeds) {
        let mut views = Vec::new();
        let mut seeds = Vec::new();
        for wall in [-4.0, 4.0] {
            for i in 0..10 {
                let x = 0.3 * f64::from(i);
                views.push(view(Vector3::new(x, 0.0, 0.0), Vector3::new(x, 0.0, wall)));
                let point =
                    |k: i32| Vector3::new(x + 0.05 * f64::from(k % 17 - 8), 0.1 * f64::from(k % 5), wall);
                seeds.push((0..100).map(point).collect());
            }
        }
        (views, seeds)
    }

    #[test]
    fn partners_see_the_same_wall_up_to_the_limit() {
        let (views, seeds) = two_walls();
        let all: Vec<u32> = (0..20).collect();
        for pairs in [pairs_by_pose(&views, &all), pairs_by_seeds(&views, &seeds, &all, 4)] {
            assert!(pairs.iter().all(|(a, b)| a < b && (a / 10 == b / 10)), "{pairs:?}");
            assert!(pairs.is_sorted_by(|a, b| a < b));
            assert!(all.iter().all(|i| pairs.iter().any(|(a, b)| a == i || b == i)), "{pairs:?}");
        }
        for limit in 1..12 {
            let own = pairs_by_seeds(&views, &seeds, &[7], limit);
            assert_eq!(own.len(), limit.min(9));
            assert!(own.iter().all(|(a, b)| *a == 7 || *b == 7));
        }
    }

    /// A street of rooms, all visible to a camera far behind them.
    #[test]
    fn distant_images_are_rejected_by_bounds() {
        let room = |x: f64| {
            (0..60).map(move |k| Vector3::new(x + 0.02 * f64::from(k % 8), 0.1 * f64::from(k % 5), 3.0))
        };
        let mut views = Vec::new();
        let mut seeds: Seeds = Vec::new();
        for n in 0..4 {
            let x = 0.3 * f64::from(n);
            views.push(view(Vector3::new(x, 0.0, 0.0), Vector3::new(0.3, 0.0, 3.0)));
            seeds.push(room(0.3).collect());
        }
        // 23 m from points that the others see from 3 m: small, but recognized; 60 m: not recognized.
        for z in [-20.0, -57.0] {
            views.push(view(Vector3::new(0.3, 0.0, z), Vector3::new(0.3, 0.0, 3.0)));
            seeds.push((0..60).map(|k| Vector3::new(0.1 * f64::from(k), 0.0, z + 3.0)).collect());
        }
        let all: Vec<u32> = (0..6).collect();
        let pairs = pairs_by_seeds(&views, &seeds, &all, 10);
        assert!(pairs.contains(&(0, 4)), "{pairs:?}");
        assert!(pairs.iter().all(|(_, b)| *b != 5), "{pairs:?}");
        let overlap = |from: usize, to: usize| -> f64 {
            seeds[from].iter().map(|x| seed_weight(&views[from], &views[to], x)).sum()
        };
        for from in 0..6 {
            let bounds = Bounds::of(&views[from], &seeds[from]).unwrap();
            for to in 0..6 {
                assert!(bounds.may_be_visible_from(&views[to]) || overlap(from, to) == 0.0, "{from} {to}");
            }
        }
        assert!(!Bounds::of(&views[0], &seeds[0]).unwrap().may_be_visible_from(&views[5]));
        assert!(Bounds::of(&views[0], &[]).is_none());
    }

    #[test]
    fn degenerate_view_sets_do_not_panic() {
        let here = view(Vector3::zeros(), Vector3::z());
        assert!(pairs_by_pose(&[], &[]).is_empty());
        assert!(pairs_by_pose(std::slice::from_ref(&here), &[0]).is_empty());
        assert_eq!(pairs_by_pose(&[here.clone(), here.clone()], &[0, 1]), [(0, 1)]);
        assert!(pairs_by_seeds(&[here.clone(), here], &vec![Vec::new(); 2], &[0, 1], 5).is_empty());
    }

    #[test]
    fn ranks_are_distinct_and_within_limits() {
        for count in 0..60 {
            for limit in 1..30 {
                let ranks: Vec<usize> = choose(count, limit).collect();
                assert_eq!(ranks.len(), count.min(limit), "{count} {limit}");
                assert!(ranks.is_sorted_by(|a, b| a < b), "{count} {limit}: {ranks:?}");
                assert!(ranks.iter().all(|r| *r < count));
            }
        }
    }
}
