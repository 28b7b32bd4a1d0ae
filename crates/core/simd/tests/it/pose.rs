//! Pose kernels compared with simple double-precision versions, on every backend, and bit for bit between backends.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_simd::Backend;
use veiloc_simd::pose::{
    Block, CameraRows, Group, Image, LANES, ObservationType, Partition, PoseLanes, RadialBlock, RadialLanes,
    Sectors,
};

const KINDS: [ObservationType; 3] =
    [ObservationType::Points, ObservationType::Lines, ObservationType::Anchored];
const IMAGE: Image = Image { middle: [3.0, -2.0], half: [320.0, 240.0], margin: 6.4 };
const FOCAL: [f32; 2] = [510.0, 525.0];
/// One in the image, one far away.
const ANCHORS: [[f32; 3]; 2] = [[0.0, -240.0, 1.0], [9e4, 4e4, -0.2]];
/// Stripes of about 100 pixels.
const STRIPES: Sectors = Sectors {
    zero: [0.1, 0.0, 500.0],
    quarter: [-0.9, 0.4, 3.0],
    per_radian: 30.0 / 6.283_185_5,
    shift: 0.3,
    margin: 0.06,
};
const PARTITION: Partition = Partition { pencils: 2.0, own: STRIPES, across: None };
/// A checkerboard.
const BOARD: Partition = Partition {
    across: Some(Sectors { quarter: [0.4, 0.9, -7.0], per_radian: 22.0 / 6.283_185_5, ..STRIPES }),
    ..PARTITION
};

struct Problem {
    lanes: PoseLanes,
    /// Group and values `x y z a b c score_offset` of each correspondence.
    all: Vec<(usize, [f64; 7])>,
    partition: Partition,
}

fn problem(rng: &mut ChaCha8Rng, observed: ObservationType, sizes: [usize; 2]) -> Problem {
    let mut all = Vec::new();
    let mut groups = Vec::new();
    for (group, size) in sizes.into_iter().enumerate() {
        let mut blocks = vec![Block::EMPTY; size.div_ceil(LANES)];
        for i in 0..size {
            let depth = if rng.random_bool(0.1) { -2.0 } else { rng.random_range(1.0..6.0) };
            let (u, v): (f32, f32) = (rng.random_range(-330.0..330.0), rng.random_range(-250.0..250.0));
            let angle: f32 = rng.random_range(0.0..6.3);
            let (a, b, c) = if observed == ObservationType::Points {
                (u + rng.random_range(-4.0..4.0), v + rng.random_range(-4.0..4.0), 0.0)
            } else {
                let (a, b) = (angle.cos(), angle.sin());
                (a, b, rng.random_range(-4.0..4.0) - a * u - b * v)
            };
            let score_offset = rng.random_range(-3.0..3.0);
            let (x, y, z) = (u / FOCAL[0] * depth, v / FOCAL[1] * depth, depth);
            let (block, l) = (&mut blocks[i / LANES], i % LANES);
            for (lane, value) in [
                &mut block.x,
                &mut block.y,
                &mut block.z,
                &mut block.a,
                &mut block.b,
                &mut block.c,
                &mut block.score_offset,
            ]
            .into_iter()
            .zip([x, y, z, a, b, c, score_offset])
            {
                lane[l] = value;
            }
            all.push((group, [x, y, z, a, b, c, score_offset].map(f64::from)));
        }
        groups.push(Group::new(blocks, ANCHORS[group], group, 12.0));
    }
    let partition = if rng.random_bool(0.5) { PARTITION } else { BOARD };
    Problem { lanes: PoseLanes::new(observed, groups, IMAGE, Some(partition)), all, partition }
}

/// Whether a pencil can be observed there.
fn admits(partition: &Partition, group: usize, u: f64, v: f64) -> bool {
    let position = |s: &Sectors| {
        let on = |f: &[f32; 3]| f64::from(f[0]) * u + f64::from(f[1]) * v + f64::from(f[2]);
        on(&s.quarter).atan2(on(&s.zero)) * f64::from(s.per_radian) + f64::from(s.shift)
    };
    let ends = |s: &Sectors| [-1.0, 1.0].map(|sign| (position(s) + sign * f64::from(s.margin)).floor());
    let across = partition.across.as_ref().map_or([0.0; 2], ends);
    let of_group = |a: f64, b: f64| (a + b).rem_euclid(2.0) == group as f64;
    ends(&partition.own).iter().any(|a| across.iter().any(|b| of_group(*a, *b)))
}

/// Rows of a small motion `[R | t]`.
fn motion(rng: &mut ChaCha8Rng) -> [[f32; 4]; 3] {
    let w: [f32; 6] = std::array::from_fn(|_| rng.random_range(-0.02..0.02));
    // First order is enough: the kernels do not require an orthonormal matrix.
    [[1.0, -w[2], w[1], w[3]], [w[2], 1.0, -w[0], w[4]], [-w[1], w[0], 1.0, w[5]]]
}

fn scaled(rows: &[[f32; 4]; 3]) -> [[f32; 4]; 3] {
    [rows[0].map(|x| x * FOCAL[0]), rows[1].map(|x| x * FOCAL[1]), rows[2]]
}

struct Observation {
    front: bool,
    visible: bool,
    squared: f64,
    radius: f64,
}

fn observe(
    (observed, partition): (ObservationType, &Partition),
    group: usize,
    c: &[f64; 7],
    rows: &[[f64; 4]; 3],
) -> Observation {
    let p = rows.map(|r| r[0] * c[0] + r[1] * c[1] + r[2] * c[2] + r[3]);
    let (u, v) = (f64::from(FOCAL[0]) * p[0] / p[2], f64::from(FOCAL[1]) * p[1] / p[2]);
    let squared = match observed {
        ObservationType::Points => (u - c[3]).powi(2) + (v - c[4]).powi(2),
        _ => (c[3] * u + c[4] * v + c[5]).powi(2),
    };
    let inside = (u - 3.0).abs() <= 326.4 && (v + 2.0).abs() <= 246.4;
    let (mut radius, mut own) = (1.0, true);
    if observed == ObservationType::Anchored {
        let [x, y, w] = ANCHORS[group].map(f64::from);
        radius = (w * u - x).hypot(w * v - y);
        own = admits(partition, group, u, v);
    }
    Observation { front: p[2] > 0.0, visible: p[2] > 0.0 && inside && own, squared, radius }
}

fn llr(c: &[f64; 7], observation: &Observation, k: f64, shift: f64) -> f64 {
    c[6] + shift + observation.radius.ln() - 3.0 * (1.0 + k * observation.squared).ln()
}

fn wide(rows: &[[f32; 4]; 3]) -> [[f64; 4]; 3] {
    rows.map(|r| r.map(f64::from))
}

#[test]
fn scores_agree_with_the_reference_on_every_backend() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for observed in KINDS {
        for sizes in [[0, 1], [15, 0], [16, 17], [700, 333]] {
            let problem = problem(&mut rng, observed, sizes);
            for _ in 0..10 {
                let rows = motion(&mut rng);
                let observation: Vec<Observation> = problem
                    .all
                    .iter()
                    .map(|(g, c)| observe((observed, &problem.partition), *g, c, &wide(&rows)))
                    .collect();
                let pairs = || problem.all.iter().zip(&observation);
                let likelihood: f64 =
                    pairs().filter(|(_, s)| s.visible).map(|((_, c), s)| llr(c, s, 0.1, 0.3).max(0.0)).sum();
                let truncated: f64 = pairs()
                    .filter(|(_, s)| s.front)
                    .map(|((_, c), s)| (c[6] - 0.2 * s.squared).max(0.0))
                    .sum();
                let portable = (
                    problem.lanes.likelihood(Backend::PORTABLE, &scaled(&rows), 0.1, 0.3, f32::NEG_INFINITY),
                    problem.lanes.truncated(Backend::PORTABLE, &scaled(&rows), 0.2, f32::NEG_INFINITY),
                );
                // A projection exactly on a border may fall on either side of it: a difference of one correspondence.
                for (found, expected) in [(portable.0, likelihood), (portable.1, truncated)] {
                    let error = (f64::from(found) - expected).abs();
                    assert!(error < 1e-3 * (1.0 + expected), "{observed:?} {sizes:?}: {found} {expected}");
                }
                for backend in Backend::available() {
                    let found = (
                        problem.lanes.likelihood(backend, &scaled(&rows), 0.1, 0.3, f32::NEG_INFINITY),
                        problem.lanes.truncated(backend, &scaled(&rows), 0.2, f32::NEG_INFINITY),
                    );
                    assert_eq!(found, portable, "{}", backend.name());
                }
            }
        }
    }
}

#[test]
fn likelihoods_sum_to_the_score() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for observed in KINDS {
        let problem = problem(&mut rng, observed, [37, 100]);
        let rows = scaled(&motion(&mut rng));
        let mut each = vec![1.0];
        for backend in Backend::available() {
            problem.lanes.each_likelihood(backend, &rows, 0.1, 0.0, &mut each);
            assert_eq!(each.len(), 48 + 112);
            let sum: f32 = each.iter().map(|llr| llr.max(0.0)).sum();
            let score = problem.lanes.likelihood(backend, &rows, 0.1, 0.0, f32::NEG_INFINITY);
            assert!((sum - score).abs() < 1e-3 * score, "{sum} {score}");
            // Unused lanes add nothing.
            assert!(each[37..48].iter().chain(&each[148..]).all(|llr| *llr < -1e9));
        }
    }
}

#[test]
fn early_stop_is_lossless() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for observed in KINDS {
        let problem = problem(&mut rng, observed, [400, 500]);
        for _ in 0..50 {
            let rows = scaled(&motion(&mut rng));
            for backend in Backend::available() {
                let full = problem.lanes.likelihood(backend, &rows, 0.1, 0.0, f32::NEG_INFINITY);
                let won = problem.lanes.likelihood(backend, &rows, 0.1, 0.0, 0.99 * full);
                let lost = problem.lanes.likelihood(backend, &rows, 0.1, 0.0, 1.01 * full + 0.1);
                assert_eq!(won, full);
                assert!(lost <= full);
            }
        }
    }
}

#[test]
fn normal_equations_agree_with_finite_differences() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let (k, shift) = (0.1, 0.2);
    for observed in KINDS {
        let problem = problem(&mut rng, observed, [120, 90]);
        let rows = motion(&mut rng);
        let loss = |rows: &[[f64; 4]; 3]| -> f64 {
            let of = |(g, c): &(usize, [f64; 7])| {
                let observation = observe((observed, &problem.partition), *g, c, rows);
                if observation.visible { -llr(c, &observation, k, shift).exp().ln_1p() } else { 0.0 }
            };
            problem.all.iter().map(of).sum()
        };
        let moved = |step: usize, h: f64| -> [[f64; 4]; 3] {
            // p + ω × p + v for p = rows · x.
            let r = wide(&rows);
            let mut out = r;
            if step < 3 {
                let (i, j) = ((step + 1) % 3, (step + 2) % 3);
                for c in 0..4 {
                    out[i][c] -= h * r[j][c];
                    out[j][c] += h * r[i][c];
                }
            } else {
                out[step - 3][3] += h;
            }
            out
        };
        let camera = CameraRows { rows, focal: FOCAL };
        let found = problem.lanes.normal_equations(Backend::PORTABLE, &camera, k as f32, shift as f32);
        let expected = loss(&wide(&rows));
        assert!((found.loss - expected).abs() < 1e-3 * expected.abs(), "{} {expected}", found.loss);
        for step in 0..6 {
            let h = 1e-6;
            let numeric = (loss(&moved(step, h)) - loss(&moved(step, -h))) / (2.0 * h);
            let scale = found.gradient.iter().fold(1.0_f64, |m, g| m.max(g.abs()));
            assert!((numeric - found.gradient[step]).abs() < 2e-3 * scale, "{observed:?} {step}");
        }
        for backend in Backend::available() {
            assert_eq!(
                problem.lanes.normal_equations(backend, &camera, k as f32, shift as f32),
                found,
                "{}",
                backend.name()
            );
        }
        for i in 0..6 {
            assert!(found.hessian[i][i] > 0.0);
            assert!((0..6).all(|j| found.hessian[i][j] == found.hessian[j][i]));
        }
    }
}

#[test]
fn gauss_newton_matrix_is_a_sum_of_outer_products() {
    // One correspondence, far from any other pose: weight times the outer product of its Jacobian.
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for observed in [ObservationType::Points, ObservationType::Lines] {
        let problem = problem(&mut rng, observed, [1, 0]);
        let camera = CameraRows { rows: motion(&mut rng), focal: FOCAL };
        let rows = wide(&camera.rows);
        let (_, c) = problem.all[0];
        if !observe((observed, &problem.partition), 0, &c, &rows).visible {
            continue;
        }
        let residuals = |rows: &[[f64; 4]; 3]| -> [f64; 2] {
            let p = rows.map(|r| r[0] * c[0] + r[1] * c[1] + r[2] * c[2] + r[3]);
            let (u, v) = (f64::from(FOCAL[0]) * p[0] / p[2], f64::from(FOCAL[1]) * p[1] / p[2]);
            if observed == ObservationType::Points {
                [u - c[3], v - c[4]]
            } else {
                [c[3] * u + c[4] * v + c[5], 0.0]
            }
        };
        let h = 1e-6;
        let slope = |axis: usize| {
            let at = |h: f64| {
                let mut moved = rows;
                moved[axis][3] += h;
                residuals(&moved)
            };
            let (plus, minus) = (at(h), at(-h));
            [0, 1].map(|i| (plus[i] - minus[i]) / (2.0 * h))
        };
        let observation = observe((observed, &problem.partition), 0, &c, &rows);
        let right = 1.0 / (1.0 + (-llr(&c, &observation, 0.1, 0.0)).exp());
        let weight = right * 6.0 * 0.1 / (1.0 + 0.1 * observation.squared);
        let found = problem.lanes.normal_equations(Backend::best(), &camera, 0.1, 0.0);
        for i in 0..3 {
            for j in 0..3 {
                let (a, b) = (slope(i), slope(j));
                let expected = weight * (a[0] * b[0] + a[1] * b[1]);
                let scale = found.hessian[3][3].max(found.hessian[4][4]).max(1.0);
                assert!(
                    (found.hessian[3 + i][3 + j] - expected).abs() < 1e-3 * scale,
                    "{observed:?} {i} {j}"
                );
            }
        }
        assert!((found.agreeing - right).abs() < 1e-4);
    }
}

#[test]
fn radial_scores_agree_with_the_reference() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for size in [1, 16, 333] {
        let mut blocks = vec![RadialBlock::EMPTY; usize::div_ceil(size, LANES)];
        let mut all = Vec::new();
        for i in 0..size {
            let angle: f32 = rng.random_range(0.0..6.3);
            let p: [f32; 3] = std::array::from_fn(|_| rng.random_range(-2.0..2.0));
            let values = [p[0], p[1], p[2], angle.cos(), angle.sin(), rng.random_range(-1.0..4.0)];
            let (block, l) = (&mut blocks[i / LANES], i % LANES);
            for (lane, value) in [
                &mut block.x,
                &mut block.y,
                &mut block.z,
                &mut block.u,
                &mut block.v,
                &mut block.score_offset,
            ]
            .into_iter()
            .zip(values)
            {
                lane[l] = value;
            }
            all.push(values.map(f64::from));
        }
        let lanes = RadialLanes::new(blocks);
        for _ in 0..20 {
            let rows: [[f32; 4]; 2] =
                std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
            let expected: f64 = all
                .iter()
                .map(|c| {
                    let [x, y] = rows.map(|r| {
                        f64::from(r[0]) * c[0]
                            + f64::from(r[1]) * c[1]
                            + f64::from(r[2]) * c[2]
                            + f64::from(r[3])
                    });
                    let across = c[3] * y - c[4] * x;
                    let llr = c[5] - 3.0 * (1.0 + 5.0 * across * across / (x * x + y * y)).ln();
                    if c[3] * x + c[4] * y > 0.0 { llr.max(0.0) } else { 0.0 }
                })
                .sum();
            let found = lanes.score(Backend::PORTABLE, &rows, 5.0, f32::NEG_INFINITY);
            assert!((f64::from(found) - expected).abs() < 1e-3 * (1.0 + expected), "{found} {expected}");
            for backend in Backend::available() {
                assert_eq!(lanes.score(backend, &rows, 5.0, f32::NEG_INFINITY), found);
                assert!(lanes.score(backend, &rows, 5.0, found + 1.0) <= found);
            }
        }
    }
}

#[test]
fn non_finite_values_are_ignored() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for observed in KINDS {
        let problem = problem(&mut rng, observed, [50, 50]);
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut rows = motion(&mut rng);
            rows[2][3] = bad;
            for backend in Backend::available() {
                assert_eq!(problem.lanes.likelihood(backend, &rows, 0.1, 0.0, f32::NEG_INFINITY), 0.0);
                let found =
                    problem.lanes.normal_equations(backend, &CameraRows { rows, focal: FOCAL }, 0.1, 0.0);
                let sums = found.gradient.iter().chain(found.hessian.iter().flatten());
                assert!(sums.chain([&found.loss]).all(|x| x.is_finite()), "{bad}");
            }
        }
    }
}
