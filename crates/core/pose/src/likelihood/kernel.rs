//! Fast score of a pose over all correspondences: the largest part of a search's runtime.
//!
//! Correspondences are laid out for `veiloc-simd`: single precision, world points centred before rounding, pixels
//! relative to the principal point; the loss of accuracy is far below a hundredth of a pixel. The readable reference is
//! [`Matches::log_likelihood_ratio`]; tests compare both.

use veiloc_geometry::nalgebra::{Matrix6, RowVector3, Vector3, Vector6};
use veiloc_geometry::{Anchor, CameraFromWorld, Pencils, Pixel, PlacedSectors};
use veiloc_simd::Backend;
use veiloc_simd::pose::{
    Block, CameraRows, Group, Image, LANES, ObservationType, Partition, PoseLanes, ScaledRows, Sectors,
};

use crate::likelihood::matches::Matches;
use crate::likelihood::problem::Correspondences;
use crate::likelihood::system::System;

/// Local optimisation uses this many correspondences; the search and the final refinement use all.
const COARSE: usize = 1024;

/// Which score, with its scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scale {
    /// Inlier threshold, pixels.
    Msac {
        /// Pixels.
        threshold: f64,
    },
    /// Scale of the noise, pixels.
    Likelihood {
        /// Pixels.
        noise: f64,
    },
}

/// All correspondences, ready to be scored.
#[derive(Debug, Clone)]
pub struct Kernel {
    scale: Scale,
    lanes: PoseLanes,
    /// The most promising correspondences alone, when there are many: enough for local optimisation.
    coarse: Option<PoseLanes>,
    /// Correspondence of each used lane, in the order of the lanes; `None` for the others.
    order: Vec<Option<usize>>,
    center: Vector3<f64>,
    focal: [f64; 2],
    count: usize,
    freedom: f64,
    residuals: usize,
    backend: Backend,
}

impl Kernel {
    /// A kernel of these correspondences; later changes to them have no effect on it.
    pub fn new(matches: &Matches<'_>, scale: Scale) -> Self {
        let camera = &matches.camera;
        let center = median_point(&matches.points);
        let [cx, cy] = camera.principal;
        let (w, h) = (f64::from(camera.width), f64::from(camera.height));
        let margin = matches.margin();
        let blocks = |members: &[usize]| -> Vec<Block> {
            members.chunks(LANES).map(|chunk| block(matches, chunk, &center, &scale)).collect()
        };
        let anchored = |pencils: &Pencils, anchor: Anchor, members: &[usize]| {
            let at = pencils.homogeneous(anchor);
            let from_principal = [at.x - cx * at.z, at.y - cy * at.z, at.z].map(|x| x as f32);
            let extra = match scale {
                Scale::Likelihood { .. } => log_farthest(matches, pencils, anchor),
                Scale::Msac { .. } => 0.0,
            };
            Group::new(blocks(members), from_principal, anchor.index(), extra as f32)
        };
        // Members of each group, the most promising first: then poor poses are rejected sooner.
        let members = |anchor: Option<Anchor>| -> Vec<usize> {
            let of_group = |i: &usize| anchor.is_none_or(|a| matches.anchor[*i] == a);
            promising_first(matches, (0..matches.len()).filter(of_group))
        };
        let all: Vec<Vec<usize>> = match matches.observations {
            Correspondences::Points { .. } | Correspondences::Lines { .. } => vec![members(None)],
            Correspondences::Anchored { pencils, .. } => {
                pencils.anchors().map(|a| members(Some(a))).collect()
            }
        };
        let groups = |share: f64| -> Vec<Group> {
            let first = |members: &Vec<usize>| (members.len() as f64 * share).ceil() as usize;
            match matches.observations {
                Correspondences::Points { .. } | Correspondences::Lines { .. } => {
                    vec![Group::new(blocks(&all[0][..first(&all[0])]), [0.0; 3], 0, 0.0)]
                }
                Correspondences::Anchored { pencils, .. } => pencils
                    .anchors()
                    .zip(&all)
                    .map(|(anchor, members)| anchored(pencils, anchor, &members[..first(members)]))
                    .collect(),
            }
        };
        let observed = match matches.observations {
            Correspondences::Points { .. } => ObservationType::Points,
            Correspondences::Lines { .. } => ObservationType::Lines,
            Correspondences::Anchored { .. } => ObservationType::Anchored,
        };
        let mut order = Vec::new();
        for members in &all {
            order.extend(members.iter().copied().map(Some));
            order.resize(order.len().next_multiple_of(LANES), None);
        }
        let image = Image {
            middle: [(w / 2.0 - cx) as f32, (h / 2.0 - cy) as f32],
            half: [(w / 2.0) as f32, (h / 2.0) as f32],
            margin: margin as f32,
        };
        let partition = match matches.observations {
            Correspondences::Anchored { pencils, .. } => Some(partition(pencils, [cx, cy], margin)),
            Correspondences::Points { .. } | Correspondences::Lines { .. } => None,
        };
        let lanes = |share: f64| PoseLanes::new(observed, groups(share), image, partition);
        Self {
            scale,
            lanes: lanes(1.0),
            coarse: (matches.len() > 2 * COARSE).then(|| lanes(COARSE as f64 / matches.len() as f64)),
            order,
            center,
            focal: camera.focal,
            count: matches.len(),
            freedom: matches.freedom(),
            residuals: matches.residuals(),
            backend: Backend::best(),
        }
    }

    /// Cost of a pose, lower is better: MSAC in units of whole outliers, between 0 and `N`, or minus the sum of the
    /// positive log likelihood ratios. A value not below `best` may be a partial sum.
    pub fn cost(&self, pose: &CameraFromWorld, best: f64) -> f64 {
        let rows = self.scaled_rows(pose);
        match self.scale {
            Scale::Msac { threshold } => {
                let all = self.count as f64;
                let k = (threshold * threshold).recip() as f32;
                all - f64::from(self.lanes.truncated(self.backend, &rows, k, (all - best) as f32))
            }
            Scale::Likelihood { noise } => {
                let (k, shift) = self.at_noise(noise);
                -f64::from(self.lanes.likelihood(self.backend, &rows, k, shift, -best as f32))
            }
        }
    }

    /// Cost under the likelihood at a given noise, pixels.
    pub fn cost_at(&self, pose: &CameraFromWorld, noise: f64) -> f64 {
        let (k, shift) = self.at_noise(noise);
        let rows = self.scaled_rows(pose);
        -f64::from(self.lanes.likelihood(self.backend, &rows, k, shift, f32::NEG_INFINITY))
    }

    /// Log likelihood ratio of each correspondence at this noise, `[N]`; `−∞` where the point cannot be visible.
    pub fn likelihoods(&self, pose: &CameraFromWorld, noise: f64) -> Vec<f64> {
        let (k, shift) = self.at_noise(noise);
        let mut lanes = Vec::with_capacity(self.order.len());
        self.lanes.each_likelihood(self.backend, &self.scaled_rows(pose), k, shift, &mut lanes);
        let mut all = vec![f64::NEG_INFINITY; self.count];
        for (i, llr) in self.order.iter().zip(lanes) {
            if let Some(i) = i {
                all[*i] = f64::from(llr);
            }
        }
        all
    }

    /// The soft likelihood at this noise with its derivatives, and the noise that the correspondences show.
    pub fn linearize(&self, pose: &CameraFromWorld, noise: f64) -> (System, f64) {
        self.linearize_on(&self.lanes, pose, noise)
    }

    /// The same for the most promising correspondences alone.
    pub fn linearize_coarsely(&self, pose: &CameraFromWorld, noise: f64) -> System {
        self.linearize_on(self.coarse.as_ref().unwrap_or(&self.lanes), pose, noise).0
    }

    fn linearize_on(&self, lanes: &PoseLanes, pose: &CameraFromWorld, noise: f64) -> (System, f64) {
        let (k, shift) = self.at_noise(noise);
        let [r0, r1, r2] = self.rows(pose, [1.0; 3]);
        let camera = CameraRows { rows: [r0, r1, r2], focal: self.focal.map(|f| f as f32) };
        let found = lanes.normal_equations(self.backend, &camera, k, shift);
        // One step of expectation maximisation for the scale of a Student t distribution.
        let shown = (found.spread / (self.freedom * self.residuals as f64 * found.agreeing)).sqrt();
        let system = System {
            loss: found.loss,
            gradient: Vector6::from(found.gradient),
            hessian: Matrix6::from_fn(|i, j| found.hessian[i][j]),
        };
        (system, if shown.is_finite() { shown } else { noise })
    }

    /// `k` and `shift` of the likelihood at a noise: `score_offset` contains the part for unit noise.
    fn at_noise(&self, noise: f64) -> (f32, f32) {
        let base = match self.scale {
            Scale::Likelihood { noise } => noise,
            Scale::Msac { .. } => 1.0,
        };
        let shift = -(self.residuals as f64) * (noise / base).ln();
        ((self.freedom * noise * noise).recip() as f32, shift as f32)
    }

    fn scaled_rows(&self, pose: &CameraFromWorld) -> ScaledRows {
        self.rows(pose, [self.focal[0], self.focal[1], 1.0])
    }

    /// Rows of `diag(scales) [R | t]` for the centred points.
    fn rows(&self, pose: &CameraFromWorld, scales: [f64; 3]) -> ScaledRows {
        let r = pose.rotation().matrix();
        let t = pose.rotation() * self.center + pose.translation();
        std::array::from_fn(|i| {
            let row: RowVector3<f64> = r.row(i) * scales[i];
            [row[0] as f32, row[1] as f32, row[2] as f32, (t[i] * scales[i]) as f32]
        })
    }
}

/// The members by falling `log_likelihood_const`. Equal ones are in an order independent of their index, so that every
/// prefix of the list is a fair sample.
pub fn promising_first(matches: &Matches<'_>, members: impl Iterator<Item = usize>) -> Vec<usize> {
    let mixed = |i: usize| (i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(23);
    // Keys beside the members: looking them up in each comparison takes longer.
    let mut keyed: Vec<(f64, u64, usize)> =
        members.map(|i| (matches.log_likelihood_const[i], mixed(i), i)).collect();
    keyed.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    keyed.into_iter().map(|(_, _, i)| i).collect()
}

fn block(matches: &Matches<'_>, members: &[usize], center: &Vector3<f64>, scale: &Scale) -> Block {
    let mut block = Block::EMPTY;
    let [cx, cy] = matches.camera.principal;
    for (l, &i) in members.iter().enumerate() {
        let p = matches.points[i] - center;
        (block.x[l], block.y[l], block.z[l]) = (p.x as f32, p.y as f32, p.z as f32);
        let o = &matches.observed[i];
        let (a, b, c) = match matches.observations {
            Correspondences::Points { .. } => (o.x - cx, o.y - cy, 0.0),
            Correspondences::Lines { .. } | Correspondences::Anchored { .. } => {
                (o.x, o.y, o.z + o.x * cx + o.y * cy)
            }
        };
        (block.a[l], block.b[l], block.c[l]) = (a as f32, b as f32, c as f32);
        block.score_offset[l] = match scale {
            Scale::Msac { .. } => 1.0,
            Scale::Likelihood { noise } => {
                (matches.log_likelihood_const[i] + matches.noise_term(*noise)) as f32
            }
        };
    }
    block
}

/// Logarithm of the largest distance from an anchor at which a projection may count.
pub fn log_farthest(matches: &Matches<'_>, pencils: &Pencils, anchor: Anchor) -> f64 {
    let (w, h) = (f64::from(matches.camera.width), f64::from(matches.camera.height));
    let corners =
        [[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]].map(|[u, v]| pencils.distance(anchor, Pixel::new(u, v)));
    (corners.into_iter().fold(0.0, f64::max) + 2.0 * matches.margin()).ln()
}

/// The sectors for pixels relative to the principal point.
fn partition(pencils: &Pencils, principal: [f64; 2], margin: f64) -> Partition {
    let sectors = |sectors: &PlacedSectors| {
        let moved =
            |f: &Vector3<f64>| [f.x, f.y, f.z + f.x * principal[0] + f.y * principal[1]].map(|x| x as f32);
        Sectors {
            zero: moved(&sectors.zero),
            quarter: moved(&sectors.quarter),
            per_radian: (sectors.count / std::f64::consts::TAU) as f32,
            shift: sectors.shift as f32,
            margin: pencils.in_sectors(sectors, margin) as f32,
        }
    };
    let (own, across) = pencils.sectors();
    Partition { pencils: pencils.len() as f32, own: sectors(own), across: across.map(sectors) }
}

/// Median of each coordinate, which is robust to outlier map points.
pub fn median_point(points: &[Vector3<f64>]) -> Vector3<f64> {
    Vector3::from_fn(|k, _| {
        let mut values: Vec<f64> = points.iter().map(|p| p[k]).collect();
        let middle = values.len() / 2;
        if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::likelihood::problem::PoseProblem;
    use crate::likelihood::test_data::observe;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use veiloc_geometry::nalgebra::Rotation3;
    use veiloc_geometry::{AnchorPosition, Layout, Pinhole, Pixel, Point3, Rigid3};

    fn problem(rng: &mut ChaCha8Rng, kind: usize, n: usize) -> PoseProblem {
        let camera = Pinhole { width: 640, height: 480, focal: [500.0, 510.0], principal: [310.0, 250.0] };
        // The paper's layout, and a checkerboard with an anchor far away.
        let board = |axis, shift| veiloc_geometry::Sectors { axis, count: 30, shift };
        let at = [AnchorPosition::At([0.2, -0.4]), AnchorPosition::Toward(0.3)];
        let layout = if rng.random_bool(0.5) {
            Layout::halves(1.2, 1.0)
        } else {
            Layout::new(&at, board(0.9, 0.4), Some(board(-0.6, 0.0)))
        };
        let pencils = Pencils::of_image([640, 480], &layout.expect("it closes"));
        let pixels: Vec<Pixel> =
            (0..n).map(|_| Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0))).collect();
        let points = pixels
            .iter()
            .map(|p| {
                let noisy = Pixel::new(p.u + rng.random_range(-3.0..3.0), p.v + rng.random_range(-3.0..3.0));
                let depth = if rng.random_bool(0.1) { -2.0 } else { rng.random_range(1.0..8.0) };
                Point3::from_vector(camera.unproject(noisy).homogeneous() * depth)
            })
            .collect();
        let observations = observe(kind, pixels, &pencils, || rng.random_range(0.0..3.0));
        let prior = Some((0..n).map(|_| rng.random_range(0.0..1.0)).collect());
        PoseProblem { prior, ..PoseProblem::new(camera, observations, (0..n).collect(), points) }
    }

    fn near_identity(rng: &mut ChaCha8Rng) -> CameraFromWorld {
        let mut r = || rng.random_range(-0.03..0.03);
        Rigid3::new(Rotation3::from_euler_angles(r(), r(), r()), Vector3::new(r(), r(), r()))
    }

    #[test]
    fn kernel_agrees_with_reference() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for kind in 0..3 {
            for n in [1, 15, 16, 17, 700] {
                let problem = problem(&mut rng, kind, n);
                let matches = Matches::new(&problem, 0.2);
                for _ in 0..20 {
                    let pose = near_identity(&mut rng);
                    let likelihood = Kernel::new(&matches, Scale::Likelihood { noise: 1.5 });
                    let expected: f64 = (0..n)
                        .filter_map(|i| matches.log_likelihood_ratio(i, &pose, 1.5))
                        .map(|llr| -llr.max(0.0))
                        .sum();
                    let found = likelihood.cost(&pose, f64::INFINITY);
                    // A projection exactly on a gate may fall on either side of it: a difference of one correspondence.
                    assert!(
                        (found - expected).abs() < 1e-3 * (1.0 + expected.abs()),
                        "{kind} {n}: {found} {expected}"
                    );

                    let msac = Kernel::new(&matches, Scale::Msac { threshold: 3.0 });
                    let expected: f64 = (0..n)
                        .map(|i| matches.squared_error(i, &pose).map_or(1.0, |e2| (e2 / 9.0).min(1.0)))
                        .sum();
                    let found = msac.cost(&pose, f64::INFINITY);
                    assert!(
                        (found - expected).abs() < 1e-3 * (1.0 + expected.abs()),
                        "{kind} {n}: {found} {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn early_exit_never_drops_a_better_pose() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for kind in 0..3 {
            let problem = problem(&mut rng, kind, 900);
            let matches = Matches::new(&problem, 0.2);
            for scale in [Scale::Msac { threshold: 3.0 }, Scale::Likelihood { noise: 1.5 }] {
                let kernel = Kernel::new(&matches, scale);
                let costs: Vec<(CameraFromWorld, f64)> = (0..100)
                    .map(|_| near_identity(&mut rng))
                    .map(|pose| (pose, kernel.cost(&pose, f64::INFINITY)))
                    .collect();
                let mut best = f64::INFINITY;
                for (pose, full) in costs {
                    let found = kernel.cost(&pose, best);
                    if full < best - 0.1 {
                        assert_eq!(found, full);
                        best = full;
                    } else if full > best + 0.1 {
                        assert!(found >= best);
                    }
                }
            }
        }
    }

    #[test]
    fn non_finite_poses_gain_nothing() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for kind in 0..3 {
            let problem = problem(&mut rng, kind, 50);
            let matches = Matches::new(&problem, 0.2);
            let pose = Rigid3::new(Rotation3::identity(), Vector3::repeat(f64::NAN));
            assert_eq!(
                Kernel::new(&matches, Scale::Msac { threshold: 3.0 }).cost(&pose, f64::INFINITY),
                50.0
            );
            assert_eq!(
                Kernel::new(&matches, Scale::Likelihood { noise: 1.5 }).cost(&pose, f64::INFINITY),
                0.0
            );
        }
    }
}
