//! The loops of SIFT on each instruction set, and a whole extraction, one thread.
//!
//! `cargo bench -p veiloc-benches --bench extraction`. The reference is the portable version of the kernels. All
//! versions are checked to give the same bits before they are timed; the ratios of their best times are printed first.
//! For a comparison with OpenCV see `study features sift-speed`.
#![expect(clippy::print_stdout, reason = "a benchmark prints its results")]

use std::{hint::black_box, sync::LazyLock, time::Instant};

use divan::Bencher;
use veiloc_features::{GrayImage, SiftOptions, extract_sift};
use veiloc_simd::Backend;
use veiloc_simd::sift::{
    BlurredImage, HalfKernel, LANES, PatchMemory, Patches, blur_along, blur_down, differences, peaks,
};

/// A level of the first octave of an image of 640 x 480.
const WIDTH: usize = 1280;
const HEIGHT: usize = 960;
/// An odd number of vectors, as in extractions.
const STRIDE: usize = WIDTH + LANES;
/// The widest blur of an octave.
const RADIUS: usize = 10;
/// Rows blurred at once.
const BLOCK: usize = 8;
const KEYPOINTS: usize = 2048;

static LEVEL: LazyLock<Vec<f32>> = LazyLock::new(|| {
    (0..STRIDE * HEIGHT).map(|k| texture((k % STRIDE) as f32 / 2.0, (k / STRIDE) as f32 / 2.0)).collect()
});

fn texture(x: f32, y: f32) -> f32 {
    let wave = (0.31 * x + 0.07 * y).sin() * (0.11 * x - 0.23 * y).cos() + (0.0021 * x * y).sin();
    0.5 + 0.2 * wave
}

fn row(y: usize) -> &'static [f32] {
    &LEVEL[y.min(HEIGHT - 1) * STRIDE..][..STRIDE]
}

/// Work on one backend; the result must be the same on all backends.
type Work = fn(Backend) -> Vec<u32>;

const WORK: [(&str, Work); 3] =
    [("blur, radius 10", blur), ("differences and peaks", search), ("2048 keypoints", describe)];

fn main() {
    for (name, work) in WORK {
        let expected = work(Backend::PORTABLE);
        let times: Vec<(&str, f64)> = Backend::available()
            .into_iter()
            .map(|backend| {
                assert!(work(backend) == expected, "{name}: {} differs", backend.name());
                (backend.name(), best_ms(|| work(backend)))
            })
            .collect();
        let portable = times[0].1;
        println!("{name}, {WIDTH} x {HEIGHT}, one thread, best of 9:");
        for (backend, ms) in times {
            println!("  {backend:<12} {ms:8.2} ms  {:6.2} of the portable version's time", ms / portable);
        }
    }
    divan::main();
}

fn best_ms<T>(mut work: impl FnMut() -> T) -> f64 {
    let time = |_| {
        let start = Instant::now();
        black_box(work());
        start.elapsed().as_secs_f64() * 1e3
    };
    (0..9).map(time).fold(f64::INFINITY, f64::min)
}

/// Blurs one level; returns the bits of its middle row.
fn blur(backend: Backend) -> Vec<u32> {
    let kernel = HalfKernel::new(&[1.0 / (2 * RADIUS + 1) as f32; RADIUS + 1]);
    let (mut down, mut out) = (Vec::new(), vec![0.0; BLOCK * STRIDE]);
    let mut bits = Vec::new();
    for first in (0..HEIGHT).step_by(BLOCK) {
        let rows: Vec<&[f32]> =
            (first..first + BLOCK + 2 * RADIUS).map(|y| row(y.saturating_sub(RADIUS))).collect();
        blur_down(backend, &kernel, &rows, STRIDE, WIDTH, &mut down);
        let padded = down.chunks_exact(STRIDE + 2 * RADIUS);
        for (padded, out) in padded.zip(out.chunks_exact_mut(STRIDE)) {
            blur_along(backend, &kernel, padded, out);
        }
        if first == HEIGHT / 2 {
            bits.extend(out.iter().map(|sample| sample.to_bits()));
        }
    }
    bits
}

/// The peaks of one level of differences; neighbouring rows serve as neighbouring levels.
fn search(backend: Backend) -> Vec<u32> {
    let mut found = Vec::new();
    let mut ring = [(); 3].map(|()| vec![0.0; 3 * STRIDE]);
    for y in 0..HEIGHT - 3 {
        let rows: [&[f32]; 4] = std::array::from_fn(|level| row(y + level));
        differences(backend, &rows, &mut ring[y % 3]);
        let near: [[&[f32]; 3]; 3] = std::array::from_fn(|level| {
            std::array::from_fn(|k| &ring[(y + 1 + k) % 3][level * STRIDE..][..STRIDE])
        });
        peaks(backend, &near, WIDTH, 0.0032, &mut found);
    }
    found
}

/// Orientations and one descriptor for each keypoint.
fn describe(backend: Backend) -> Vec<u32> {
    let patches = Patches::new(backend);
    let mut memory = PatchMemory::new();
    let view = BlurredImage::new(&LEVEL, STRIDE, WIDTH, HEIGHT).expect("a whole level");
    let mut bits = Vec::new();
    for k in 0..KEYPOINTS {
        let middle = [30.0 + (k * 619 % 1220) as f32, 30.0 + (k * 397 % 900) as f32];
        let bins = patches.directions(view, middle, 2.5, &mut memory);
        let bytes = patches.describe(view, middle, 2.5, k as f32 * 0.01 - 3.0, &mut memory);
        bits.push(bins[k % bins.len()].to_bits());
        bits.push(bytes.iter().map(|&byte| u32::from(byte)).sum());
    }
    bits
}

/// A whole image, with all threads.
#[divan::bench]
fn image_640_480(bencher: Bencher<'_, '_>) {
    let samples = (0..640 * 480).map(|k| texture((k % 640) as f32, (k / 640) as f32)).collect();
    let image = GrayImage::new(640, 480, samples).expect("finite");
    bencher.bench(|| extract_sift(&image, &SiftOptions::default()));
}
