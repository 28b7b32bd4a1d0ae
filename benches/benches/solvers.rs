//! Minimal solvers on random samples, and whole pose estimation: 2400 matches, one in five right, 1000 hypotheses.
//!
//! ```text
//! cargo bench -p veiloc-benches --bench solvers
//! ```
//!
//! A solver's time is per sample; each iteration solves a fresh one out of 256, so that branches stay unpredictable.

use divan::Bencher;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Rotation3, Vector2, Vector3};
use veiloc_geometry::{
    Anchor, CameraFromWorld, DualAnchors, Pinhole, Pixel, PixelLine, PlaneLine, Point3, Rigid3,
};
use veiloc_robust::{AnchoredSolver, Correspondences, PoseOptions, PoseProblem, ScoreKind, estimate_pose};
use veiloc_solvers::{ArrayVec, p3p, p5lp_radial, p6lp};

const CAMERA: Pinhole = Pinhole { width: 640, height: 480, focal: [525.0, 525.0], principal: [320.0, 240.0] };
const SAMPLES: usize = 256;

fn main() {
    divan::main();
}

fn pose(rng: &mut ChaCha8Rng) -> CameraFromWorld {
    let mut angle = || rng.random_range(-1.5..1.5);
    let turn = Rotation3::from_euler_angles(angle(), angle(), angle());
    Rigid3::new(turn, Vector3::from_fn(|_, _| rng.random_range(-3.0..3.0)))
}

fn pixel(rng: &mut ChaCha8Rng) -> Pixel {
    Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0))
}

fn lift(rng: &mut ChaCha8Rng, pose: &CameraFromWorld, pixel: Pixel) -> Point3<World> {
    let depth = rng.random_range(1.0..8.0);
    pose.inverse().transform(&Point3::from_vector(CAMERA.unproject(pixel).homogeneous() * depth))
}

/// Solves the samples in turn.
fn each<S>(bencher: Bencher, sample: impl Fn(&mut ChaCha8Rng) -> S, mut solve: impl FnMut(&S) -> usize) {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let samples: Vec<S> = (0..SAMPLES).map(|_| sample(&mut rng)).collect();
    let mut next = 0;
    bencher.bench_local(|| {
        next = (next + 1) % SAMPLES;
        solve(&samples[next])
    });
}

#[divan::bench]
fn p3p_sample(bencher: Bencher) {
    let sample = |rng: &mut ChaCha8Rng| {
        let pose = pose(rng);
        let pixels: [Pixel; 3] = std::array::from_fn(|_| pixel(rng));
        (pixels.map(|p| CAMERA.unproject(p).bearing()), pixels.map(|p| lift(rng, &pose, p)))
    };
    each(bencher, sample, |(bearings, points)| p3p(bearings, points, &mut ArrayVec::new()));
}

#[divan::bench(args = ["random lines", "dcl"])]
fn p6lp_sample(bencher: Bencher, lines: &str) {
    let dcl = DualAnchors::vertical(640, 480);
    let line = |rng: &mut ChaCha8Rng, p: Pixel| -> PlaneLine {
        if lines == "dcl" {
            let anchor = dcl.anchor_of(p);
            dcl.line(anchor, dcl.angle_of(anchor, p)).back_project(&CAMERA)
        } else {
            PixelLine::through(p, rng.random_range(0.0..3.0)).back_project(&CAMERA)
        }
    };
    let sample = |rng: &mut ChaCha8Rng| {
        let pose = pose(rng);
        let pixels: [Pixel; 6] = std::array::from_fn(|_| pixel(rng));
        (pixels.map(|p| line(rng, p)), pixels.map(|p| lift(rng, &pose, p)))
    };
    each(bencher, sample, |(lines, points)| p6lp(lines, points, &mut ArrayVec::new()));
}

#[divan::bench]
fn p5lp_radial_sample(bencher: Bencher) {
    let dcl = DualAnchors::vertical(640, 480);
    let ray = CAMERA.unproject(dcl.position(Anchor::First)).bearing();
    let turn = Rotation3::rotation_between(&ray, &Vector3::z()).expect("not opposite");
    let sample = |rng: &mut ChaCha8Rng| -> ([Vector2<f64>; 5], [Point3<World>; 5]) {
        let pose = pose(rng);
        let pixels: [Pixel; 5] = std::array::from_fn(|_| {
            let p = pixel(rng);
            Pixel::new(p.u / 2.0, p.v)
        });
        let seen = pixels.map(|p| (turn * CAMERA.unproject(p).bearing()).xy());
        (seen, pixels.map(|p| lift(rng, &pose, p)))
    };
    each(bencher, sample, |(directions, points)| p5lp_radial(directions, points, &mut ArrayVec::new()));
}

/// 2400 matches of which 480 are right, half a pixel of noise.
fn problem(scheme: &str) -> PoseProblem {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let rng = &mut rng;
    let truth = pose(rng);
    let (mut pixels, mut points) = (Vec::new(), Vec::new());
    for i in 0..2400 {
        let p = pixel(rng);
        let seen = if i < 480 { p } else { pixel(rng) };
        points.push(lift(rng, &truth, seen));
        pixels.push(Pixel::new(p.u + rng.random_range(-0.9..0.9), p.v + rng.random_range(-0.9..0.9)));
    }
    let dcl = DualAnchors::vertical(640, 480);
    let observations = match scheme {
        "points" => Correspondences::Points { pixels },
        "dcl" => Correspondences::Anchored {
            anchors: dcl,
            lines: pixels.iter().map(|p| (dcl.anchor_of(*p), dcl.angle_of(dcl.anchor_of(*p), *p))).collect(),
        },
        _ => Correspondences::Lines {
            lines: pixels.iter().map(|p| PixelLine::through(*p, rng.random_range(0.0..3.0))).collect(),
        },
    };
    PoseProblem { camera: CAMERA, observations, points, prior: None, gravity: None }
}

#[divan::bench(sample_count = 20, args = [
    "points msac", "points likelihood", "lines msac", "lines likelihood", "dcl msac p6lp", "dcl likelihood p6lp",
    "dcl likelihood radial-vote",
])]
fn estimate_1000_hypotheses(bencher: Bencher, recipe: &str) {
    let mut words = recipe.split(' ');
    let problem = problem(words.next().unwrap_or_default());
    let mut options = PoseOptions::default();
    options.score = words.next().and_then(|w| w.parse::<ScoreKind>().ok());
    options.anchored_solver = words.next().and_then(|w| w.parse::<AnchoredSolver>().ok());
    options.fixed_hypotheses = Some(1000);
    bencher.bench_local(|| estimate_pose(&problem, &options, &mut ChaCha8Rng::seed_from_u64(3)));
}
