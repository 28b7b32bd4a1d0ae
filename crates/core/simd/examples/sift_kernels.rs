//! Runs one kernel of SIFT over rows of noise as long as those of a frame of 1280 × 720, for counters of instructions and
//! clocks (`scripts/phones/measure.py`).
//!
//! `sift_kernels KERNEL BACKEND TIMES` prints a checksum and the nanoseconds of a call. `KERNEL` is `blur-down`,
//! `blur-along`, `double`, `differences`, `peaks`, `directions` or `descriptor`; `BACKEND` is a name of
//! [`Backend::available`].

use std::time::Instant;

use veiloc_simd::Backend;
use veiloc_simd::sift::{
    BlurredImage, Doubling, HalfKernel, LANES, PatchMemory, Patches, blur_along, blur_down, differences,
    double_row, peaks,
};

const WIDTH: usize = 1280;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [kernel, backend, times] = arguments.as_slice() else {
        panic!("sift_kernels KERNEL BACKEND TIMES");
    };
    let backend = Backend::available().into_iter().find(|known| known.name() == backend);
    let backend = backend.expect("a backend of this machine");
    let times: usize = times.parse().expect("a number");

    let mut state = 1_u32;
    let mut noise = |length: usize| -> Vec<f32> {
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 16_777_216.0
        };
        (0..length).map(|_| next()).collect()
    };
    let rows: Vec<Vec<f32>> = (0..24).map(|_| noise(WIDTH)).collect();
    let views: Vec<&[f32]> = rows.iter().map(Vec::as_slice).collect();
    let weights: Vec<f32> = (0..=6).map(|k| 0.2 / (1 + k) as f32).collect();
    let half = HalfKernel::new(&weights);
    let (mut out, mut scratch, mut columns) = (vec![0.0; 2 * WIDTH], Vec::new(), Vec::new());
    let image = noise(128 * 128);
    let view = BlurredImage::new(&image, 128, 128, 128).expect("a whole image");
    let (patches, mut memory) = (Patches::new(backend), PatchMemory::new());
    let padded = noise(WIDTH + 2 * half.radius());

    let mut sum = 0.0_f64;
    let start = Instant::now();
    for time in 0..times {
        let at = [40.0 + (time % 40) as f32, 60.0];
        match kernel.as_str() {
            "blur-down" => {
                blur_down(backend, &half, &views[..20], WIDTH, WIDTH, &mut scratch);
                sum += f64::from(scratch[time % WIDTH]);
            }
            "blur-along" => {
                blur_along(backend, &half, &padded, &mut out[..WIDTH]);
                sum += f64::from(out[time % WIDTH]);
            }
            "double" => {
                let kernels = Doubling { down: &weights, even: &weights, odd: &weights };
                double_row(backend, kernels, &views[..7], WIDTH - LANES, &mut scratch, &mut out);
                sum += f64::from(out[time % WIDTH]);
            }
            "differences" => {
                let levels: &[&[f32]; 6] = views[..6].try_into().expect("six rows");
                scratch.resize(5 * WIDTH, 0.0);
                differences(backend, levels, &mut scratch);
                sum += f64::from(scratch[time % WIDTH]);
            }
            "peaks" => {
                let near = [0, 1, 2].map(|level| [0, 1, 2].map(|row| views[3 * level + row]));
                // As in an image with texture, every vector has a sample farther than this.
                peaks(backend, &near, WIDTH, 0.5, &mut columns);
                sum += columns.len() as f64;
                columns.clear();
            }
            "directions" => sum += f64::from(patches.directions(view, at, 2.0, &mut memory)[time % 36]),
            "descriptor" => sum += f64::from(patches.describe(view, at, 2.0, 0.4, &mut memory)[time % 128]),
            other => panic!("no kernel {other}"),
        }
    }
    let nanoseconds = start.elapsed().as_nanos() as f64 / times as f64;
    #[expect(clippy::print_stdout, reason = "the result of the program")]
    {
        println!("{sum} {nanoseconds:.0} ns");
    }
}
