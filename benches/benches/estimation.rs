//! Whole pose estimation: 2400 matches, 20 % of them right, 1000 hypotheses. The reference is points with `p3p`.
//!
//! ```text
//! cargo bench -p veiloc-benches --bench estimation
//! ```

use divan::Bencher;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, Pencils, Pinhole, Pixel, PixelLine, Point3, Rigid3};
use veiloc_pose::{
    AnchoredSolver, Correspondences, Gravity, PoseOptions, PoseProblem, ScoreKind, estimate_pose,
};

const CAMERA: Pinhole = Pinhole { width: 640, height: 480, focal: [525.0, 525.0], principal: [320.0, 240.0] };

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

/// 2400 matches of which 480 are right, with noise of 0.5 px.
fn problem(scheme: &str, upright: bool) -> PoseProblem {
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
    let dcl = Pencils::paper(640, 480);
    let observations = match scheme {
        "points" => Correspondences::Points { pixels },
        "dcl" => Correspondences::Anchored {
            lines: pixels.iter().map(|p| (dcl.anchor_of(*p), dcl.angle_of(dcl.anchor_of(*p), *p))).collect(),
            pencils: dcl,
        },
        _ => Correspondences::Lines {
            lines: pixels.iter().map(|p| PixelLine::through(*p, rng.random_range(0.0..3.0))).collect(),
        },
    };
    let down = truth.rotation() * Vector3::y();
    let gravity = upright.then(|| Gravity::from_accelerometer(down, Vector3::y()));
    let mut problem = PoseProblem::new(CAMERA, observations, (0..2400).collect(), points);
    problem.gravity = gravity;
    problem
}

#[divan::bench(sample_count = 20, args = [
    "points msac", "points likelihood", "lines msac", "lines likelihood", "dcl msac p6lp", "dcl likelihood p6lp",
    "dcl likelihood dual-radial", "dcl likelihood radial-vote", "points likelihood upright",
    "lines likelihood upright", "dcl likelihood upright",
])]
fn estimate_1000_hypotheses(bencher: Bencher, recipe: &str) {
    let words: Vec<&str> = recipe.split(' ').collect();
    let upright = words.last() == Some(&"upright");
    let problem = problem(words[0], upright);
    let mut options = PoseOptions::default();
    options.score = words[1].parse::<ScoreKind>().ok();
    options.anchored_solver = words.get(2).and_then(|w| w.parse::<AnchoredSolver>().ok());
    options.fixed_hypotheses = Some(1000);
    bencher.bench_local(|| estimate_pose(&problem, &options, &mut ChaCha8Rng::seed_from_u64(3)));
}
