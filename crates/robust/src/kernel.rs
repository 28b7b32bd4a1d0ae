//! The score of a pose over all correspondences, fast: single precision, sixteen lanes at a time, no branches.
//!
//! Coordinates are kept in blocks of sixteen per quantity, so that the compiler turns the loop over lanes into vector
//! instructions without help. World points are centred before they are rounded to single precision, and pixels are
//! relative to the principal point; what is left is far below a hundredth of a pixel. The readable twin is
//! [`Matches::log_likelihood_ratio`], which the tests hold this against.
//!
//! Both scores are sums of gains that are never negative, so a pose whose gain so far plus the most that the rest can
//! bring stays under the best known one is dropped early, without any loss. NaN gains nothing.

use veiloc_geometry::nalgebra::{RowVector3, Vector3};
use veiloc_geometry::{Anchor, CameraFromWorld};

use crate::log::ln_approx;
use crate::matches::{Kind, Matches};

const LANES: usize = 16;

/// Blocks between two looks at whether the pose can still win.
const BLOCKS_PER_LOOK: usize = 8;

/// What a lane holds that belongs to no correspondence: it gains nothing.
const NEVER: f32 = -1e30;

type Lanes = [f32; LANES];

#[derive(Debug, Clone)]
struct Block {
    x: Lanes,
    y: Lanes,
    z: Lanes,
    /// Line coefficients, or the pixel in `a` and `b`.
    a: Lanes,
    b: Lanes,
    c: Lanes,
    /// MSAC: 1; likelihood: all of the log ratio that does not depend on the pose.
    worth: Lanes,
}

/// Blocks of one anchor, or all of them.
#[derive(Debug, Clone)]
struct Group {
    blocks: Vec<Block>,
    /// Most that the blocks from here on can gain.
    most: Vec<f32>,
    /// Anchor relative to the principal point.
    anchor: [f32; 2],
    /// Distance from the dividing line, positive on the own side: `side · (u, v, 1)`.
    side: [f32; 3],
}

/// Which score, with its scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Scale {
    /// Inlier threshold, pixels.
    Msac { threshold: f64 },
    /// Standard deviation, pixels.
    Likelihood { noise: f64 },
}

/// All correspondences, ready to be scored.
#[derive(Debug, Clone)]
pub(crate) struct Kernel {
    scale: Scale,
    kind: Kind,
    groups: Vec<Group>,
    center: Vector3<f64>,
    focal: [f64; 2],
    /// Middle of the picture relative to the principal point, and half its size with the margin.
    picture: [f32; 4],
    margin: f32,
    count: usize,
}

/// A pose in the kernel's coordinates: rows of `diag(fx, fy, 1) [R | t]`.
type Rows = [[f32; 4]; 3];

impl Kernel {
    pub(crate) fn new(matches: &Matches, scale: Scale) -> Self {
        let camera = &matches.camera;
        let center = median_point(&matches.points);
        let members = |anchor: Option<Anchor>| -> Vec<usize> {
            let mut members: Vec<usize> =
                (0..matches.len()).filter(|&i| anchor.is_none_or(|a| matches.anchor[i] == a)).collect();
            // The most promising first: then poor poses are dropped sooner. Equal ones keep their order.
            members.sort_by(|&i, &j| matches.worth[j].total_cmp(&matches.worth[i]));
            members
        };
        let [cx, cy] = camera.principal;
        let (w, h) = (f64::from(camera.width), f64::from(camera.height));
        let margin = matches.margin();
        let build = |members: Vec<usize>, anchor: [f64; 2], side: [f64; 3]| {
            let reach =
                [0.0, w].into_iter().flat_map(|u| [0.0, h].map(|v| (u - anchor[0]).hypot(v - anchor[1])));
            let farthest = (reach.fold(0.0_f64, f64::max) + 2.0 * margin).ln();
            let blocks: Vec<Block> =
                members.chunks(LANES).map(|chunk| Block::new(matches, chunk, &center, &scale)).collect();
            let mut most = vec![0.0_f32; blocks.len() + 1];
            for (k, block) in blocks.iter().enumerate().rev() {
                let extra = if matches!((scale, matches.kind), (Scale::Likelihood { .. }, Kind::Anchored(_)))
                {
                    farthest as f32
                } else {
                    0.0
                };
                most[k] = most[k + 1] + block.worth.iter().map(|w| (w + extra).max(0.0)).sum::<f32>();
            }
            Group {
                blocks,
                most,
                anchor: [(anchor[0] - cx) as f32, (anchor[1] - cy) as f32],
                side: [side[0] as f32, side[1] as f32, (side[2] + side[0] * cx + side[1] * cy) as f32],
            }
        };
        let groups = match matches.kind {
            Kind::Points | Kind::Lines => vec![build(members(None), [0.0; 2], [0.0; 3])],
            Kind::Anchored(anchors) => Anchor::BOTH
                .into_iter()
                .map(|a| {
                    let at = anchors.position(a);
                    let origin = anchors.signed_side(veiloc_geometry::Pixel::new(0.0, 0.0));
                    let slope = [
                        anchors.signed_side(veiloc_geometry::Pixel::new(1.0, 0.0)) - origin,
                        anchors.signed_side(veiloc_geometry::Pixel::new(0.0, 1.0)) - origin,
                    ];
                    let sign = if a == Anchor::First { 1.0 } else { -1.0 };
                    build(members(Some(a)), [at.u, at.v], [sign * slope[0], sign * slope[1], sign * origin])
                })
                .collect(),
        };
        Self {
            scale,
            kind: matches.kind,
            groups,
            center,
            focal: camera.focal,
            picture: [
                (w / 2.0 - cx) as f32,
                (h / 2.0 - cy) as f32,
                (w / 2.0 + margin) as f32,
                (h / 2.0 + margin) as f32,
            ],
            margin: margin as f32,
            count: matches.len(),
        }
    }

    /// Cost of a pose, lower is better; see [`crate::PoseEstimate::score`]. Any value not below `best` may be a
    /// value at which the sum was given up.
    pub(crate) fn cost(&self, pose: &CameraFromWorld, best: f64) -> f64 {
        match self.scale {
            Scale::Msac { .. } => {
                let all = self.count as f64;
                all - f64::from(self.gain(pose, (all - best) as f32))
            }
            Scale::Likelihood { .. } => -f64::from(self.gain(pose, -best as f32)),
        }
    }

    #[expect(clippy::needless_bitwise_bool, reason = "`&&` is a branch, and branches stop vectorization")]
    fn gain(&self, pose: &CameraFromWorld, to_beat: f32) -> f32 {
        let rows = self.rows(pose);
        match (self.scale, self.kind) {
            (Scale::Msac { threshold }, Kind::Points) => {
                let k = (1.0 / (threshold * threshold)) as f32;
                self.sum(&rows, to_beat, |_, block, l, x, y, z| {
                    let (du, dv) = (x / z - block.a[l], y / z - block.b[l]);
                    let gain = block.worth[l] - k * (du * du + dv * dv);
                    if z > 0.0 && gain > 0.0 { gain } else { 0.0 }
                })
            }
            (Scale::Msac { threshold }, Kind::Lines | Kind::Anchored(_)) => {
                let k = (1.0 / (threshold * threshold)) as f32;
                self.sum(&rows, to_beat, |_, block, l, x, y, z| {
                    let e = (block.a[l] * x + block.b[l] * y) / z + block.c[l];
                    let gain = block.worth[l] - k * e * e;
                    if z > 0.0 && gain > 0.0 { gain } else { 0.0 }
                })
            }
            (Scale::Likelihood { noise }, Kind::Points) => {
                let k = (0.5 / (noise * noise)) as f32;
                self.sum(&rows, to_beat, |_, block, l, x, y, z| {
                    let (u, v) = (x / z, y / z);
                    let (du, dv) = (u - block.a[l], v - block.b[l]);
                    let gain = block.worth[l] - k * (du * du + dv * dv);
                    if (z > 0.0) & (gain > 0.0) & self.inside(u, v) { gain } else { 0.0 }
                })
            }
            (Scale::Likelihood { noise }, Kind::Lines) => {
                let k = (0.5 / (noise * noise)) as f32;
                self.sum(&rows, to_beat, |_, block, l, x, y, z| {
                    let (u, v) = (x / z, y / z);
                    let e = block.a[l] * u + block.b[l] * v + block.c[l];
                    let gain = block.worth[l] - k * e * e;
                    if (z > 0.0) & (gain > 0.0) & self.inside(u, v) { gain } else { 0.0 }
                })
            }
            (Scale::Likelihood { noise }, Kind::Anchored(_)) => {
                let k = (0.5 / (noise * noise)) as f32;
                self.sum(&rows, to_beat, |group, block, l, x, y, z| {
                    let (u, v) = (x / z, y / z);
                    let e = block.a[l] * u + block.b[l] * v + block.c[l];
                    let (du, dv) = (u - group.anchor[0], v - group.anchor[1]);
                    let side = group.side[0] * u + group.side[1] * v + group.side[2];
                    let gain = block.worth[l] + 0.5 * ln_approx(du * du + dv * dv) - k * e * e;
                    let visible = (z > 0.0) & (side >= -self.margin) & self.inside(u, v);
                    if visible & (gain > 0.0) { gain } else { 0.0 }
                })
            }
        }
    }

    #[inline(always)]
    fn inside(&self, u: f32, v: f32) -> bool {
        let [u0, v0, half_w, half_h] = self.picture;
        ((u - u0).abs() <= half_w) & ((v - v0).abs() <= half_h)
    }

    #[inline(always)]
    fn sum(
        &self,
        rows: &Rows,
        to_beat: f32,
        gain: impl Fn(&Group, &Block, usize, f32, f32, f32) -> f32,
    ) -> f32 {
        let mut total = 0.0_f32;
        let mut rest: f32 = self.groups.iter().map(|g| g.most[0]).sum();
        for group in &self.groups {
            rest -= group.most[0];
            for (look, blocks) in group.blocks.chunks(BLOCKS_PER_LOOK).enumerate() {
                let mut sums = [0.0_f32; LANES];
                for block in blocks {
                    for l in 0..LANES {
                        let (px, py, pz) = (block.x[l], block.y[l], block.z[l]);
                        let x = rows[0][0] * px + rows[0][1] * py + rows[0][2] * pz + rows[0][3];
                        let y = rows[1][0] * px + rows[1][1] * py + rows[1][2] * pz + rows[1][3];
                        let z = rows[2][0] * px + rows[2][1] * py + rows[2][2] * pz + rows[2][3];
                        sums[l] += gain(group, block, l, x, y, z);
                    }
                }
                total += sums.iter().sum::<f32>();
                let done = look * BLOCKS_PER_LOOK + blocks.len();
                if total + group.most[done] + rest < to_beat {
                    return total;
                }
            }
        }
        total
    }

    fn rows(&self, pose: &CameraFromWorld) -> Rows {
        let r = pose.rotation().matrix();
        let t = pose.rotation() * self.center + pose.translation();
        let scales = [self.focal[0], self.focal[1], 1.0];
        std::array::from_fn(|i| {
            let row: RowVector3<f64> = r.row(i) * scales[i];
            [row[0] as f32, row[1] as f32, row[2] as f32, (t[i] * scales[i]) as f32]
        })
    }
}

impl Block {
    fn new(matches: &Matches, members: &[usize], center: &Vector3<f64>, scale: &Scale) -> Self {
        let mut block = Self {
            x: [0.0; LANES],
            y: [0.0; LANES],
            z: [0.0; LANES],
            a: [0.0; LANES],
            b: [0.0; LANES],
            c: [0.0; LANES],
            worth: [NEVER; LANES],
        };
        let [cx, cy] = matches.camera.principal;
        for (l, &i) in members.iter().enumerate() {
            let p = matches.points[i] - center;
            (block.x[l], block.y[l], block.z[l]) = (p.x as f32, p.y as f32, p.z as f32);
            let o = &matches.observed[i];
            let (a, b, c) = match matches.kind {
                Kind::Points => (o.x - cx, o.y - cy, 0.0),
                Kind::Lines | Kind::Anchored(_) => (o.x, o.y, o.z + o.x * cx + o.y * cy),
            };
            (block.a[l], block.b[l], block.c[l]) = (a as f32, b as f32, c as f32);
            block.worth[l] = match scale {
                Scale::Msac { .. } => 1.0,
                Scale::Likelihood { noise } => (matches.worth[i] + matches.noise_term(*noise)) as f32,
            };
        }
        block
    }
}

/// Median of each coordinate: a few wild map points do not move it.
fn median_point(points: &[Vector3<f64>]) -> Vector3<f64> {
    Vector3::from_fn(|k, _| {
        let mut values: Vec<f64> = points.iter().map(|p| p[k]).collect();
        let middle = values.len() / 2;
        if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::problem::PoseProblem;
    use crate::test_data::observe;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use veiloc_geometry::nalgebra::Rotation3;
    use veiloc_geometry::{DualAnchors, Pinhole, Pixel, Point3, Rigid3};

    fn problem(rng: &mut ChaCha8Rng, kind: usize, n: usize) -> PoseProblem {
        let camera = Pinhole { width: 640, height: 480, focal: [500.0, 510.0], principal: [310.0, 250.0] };
        let anchors = DualAnchors::new(640, 480, 1.2, 1.0).expect("finite");
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
        let observations = observe(kind, pixels, anchors, || rng.random_range(0.0..3.0));
        let prior = Some((0..n).map(|_| rng.random_range(0.0..1.0)).collect());
        PoseProblem { camera, observations, points, prior, gravity: None }
    }

    fn near_identity(rng: &mut ChaCha8Rng) -> CameraFromWorld {
        let mut r = || rng.random_range(-0.03..0.03);
        Rigid3::new(Rotation3::from_euler_angles(r(), r(), r()), Vector3::new(r(), r(), r()))
    }

    #[test]
    fn agrees_with_its_readable_twin() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for kind in 0..3 {
            for n in [1, 15, 16, 17, 700] {
                let matches = Matches::new(&problem(&mut rng, kind, n), 0.2);
                for _ in 0..20 {
                    let pose = near_identity(&mut rng);
                    let likelihood = Kernel::new(&matches, Scale::Likelihood { noise: 1.5 });
                    let expected: f64 = (0..n)
                        .filter_map(|i| matches.log_likelihood_ratio(i, &pose, 1.5))
                        .map(|llr| -llr.max(0.0))
                        .sum();
                    let found = likelihood.cost(&pose, f64::INFINITY);
                    // A projection exactly on a gate may fall on either side of it: worth one correspondence.
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
    fn giving_up_early_never_drops_a_better_pose() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for kind in 0..3 {
            let matches = Matches::new(&problem(&mut rng, kind, 900), 0.2);
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
    fn poses_that_are_not_finite_gain_nothing() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for kind in 0..3 {
            let matches = Matches::new(&problem(&mut rng, kind, 50), 0.2);
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
