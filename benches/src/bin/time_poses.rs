//! Times `estimate_pose` in Rust on the problems of a file, for `study poses python-calls`.
//!
//! ```text
//! cargo run --release -p veiloc-benches --bin time_poses -- PROBLEMS.f64 CORRESPONDENCES
//! ```
//!
//! The file holds the problems one after the other, each correspondence as a pixel and a map point: `u v x y z`. Prints
//! the milliseconds of each problem, one on each line. The time includes the conversion from plain numbers, as in
//! Python.
#![expect(clippy::print_stdout, reason = "a program whose output is its result")]

use std::hint::black_box;
use std::time::Instant;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_geometry::{Intrinsics, Pixel, Point3};
use veiloc_pose::{Correspondences, PoseError, PoseEstimate, PoseOptions, PoseProblem, estimate_pose};

const CAMERA: &str = "PINHOLE,640,480,525,525,320,240";
const NUMBERS: usize = 5;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [file, count] = words.as_slice() else {
        return Err("time_poses PROBLEMS.f64 CORRESPONDENCES".into());
    };
    let numbers: Vec<f64> = (std::fs::read(file)?.chunks_exact(8))
        .map(|bytes| Ok(f64::from_le_bytes(bytes.try_into()?)))
        .collect::<Result<_, std::array::TryFromSliceError>>()?;
    let camera: Intrinsics = CAMERA.parse()?;
    for problem in numbers.chunks_exact(NUMBERS * count.parse::<usize>()?.max(1)) {
        let began = Instant::now();
        black_box(solve(&camera, black_box(problem))?);
        println!("{}", began.elapsed().as_secs_f64() * 1e3);
    }
    Ok(())
}

fn solve(camera: &Intrinsics, problem: &[f64]) -> Result<PoseEstimate, PoseError> {
    let rows = || problem.chunks_exact(NUMBERS);
    let pixels: Vec<Pixel> =
        rows().filter_map(|row| camera.undistort_pixel(Pixel::new(row[0], row[1]))).collect();
    let points: Vec<_> = rows().map(|row| Point3::new(row[2], row[3], row[4])).collect();
    let keypoints = (0..points.len()).collect();
    let observations = Correspondences::Points { pixels };
    let problem = PoseProblem::new(camera.pinhole(), observations, keypoints, points);
    estimate_pose(&problem, &PoseOptions::default(), &mut ChaCha8Rng::seed_from_u64(0))
}
