//! SIFT keypoints with RootSIFT descriptors.
//!
//! Implemented from Lowe, *Distinctive Image Features from Scale-Invariant Keypoints*, IJCV 2004, with the constants of
//! VLFeat and COLMAP; RootSIFT from Arandjelović and Zisserman, *Three things everyone should know to improve object
//! retrieval*, CVPR 2012.
//!
//! ```text
//! image → [doubled] → 6 blurred levels per octave → differences → extrema → refined → ranked, cut
//!         → directions → descriptors
//! ```
//!
//! Three levels of each octave are stored until keypoints are described in them, without the first one of the first octave,
//! whose keypoints are described before there are other octaves.
//!
//! Sample `x` of octave `o` lies at `(x + 0.5) * 0.5` of the image in the doubled first octave, and at `x * 2^o * 0.5 +
//! 0.25` in octave `o`: downsampling keeps every second sample, so the first one does not move.
//!
//! Every sum has one order, and work is divided by rows and keypoints, never by threads: equal images give equal bytes
//! with any number of threads.

mod blur;
mod extrema;
mod octave;
mod options;
mod orientation;
mod plane;
mod rows;
mod strip;

use std::slice;

use rayon::prelude::*;
use veiloc_descriptor::{DescriptorKind, Descriptors};
use veiloc_geometry::{Pixel, Stop};
use veiloc_simd::Backend;
use veiloc_simd::sift::{BlurredImage, DESCRIPTOR, PatchMemory, Patches};

pub use options::{Border, SiftOptions};

use crate::{Features, GrayImage, Keypoint};
use blur::sigma_of_level;
use extrema::{EARLY, Extremum};
use octave::Octave;
use plane::Plane;

/// Radius of a descriptor's window, as a multiple of the keypoint's scale.
pub(crate) const PATCH_RADIUS: f64 = veiloc_simd::sift::PATCH_RADIUS as f64;

/// Finds keypoints and describes them, strongest first.
///
/// An image without structure, or one that is too small, gives none. Memory: about 15 times the samples of `image` in
/// `f32` when it is doubled, a quarter of that when not.
pub fn extract_sift(image: &GrayImage, options: &SiftOptions) -> Features {
    extract_on(Backend::best(), image, options, &Stop::default())
}

/// As [`extract_sift`]; `None` once `stop` is set, after at most a block of rows or of keypoints on each thread.
pub(crate) fn extract_until(image: &GrayImage, options: &SiftOptions, stop: &Stop) -> Option<Features> {
    let features = extract_on(Backend::best(), image, options, stop);
    (!stop.is_set()).then_some(features)
}

/// Once `stop` is set, the features are not all.
fn extract_on(backend: Backend, image: &GrayImage, options: &SiftOptions, stop: &Stop) -> Features {
    let patches = Patches::new(backend);
    let mut octaves = Vec::new();
    let mut found = Vec::new();
    let mut described = Vec::new();
    let mut next = (options.max_octaves > 0).then(|| Octave::first(image, options, backend, stop));
    while let Some((octave, extrema)) = next {
        found.extend(extrema.into_iter().map(|extremum| (strength(&extremum, &octave), extremum)));
        octaves.push(octave);
        if let [first] = octaves.as_mut_slice() {
            // A plane of the first octave is a quarter of all memory. One is not kept: its keypoints are described at once,
            // if they are among the strongest so far. Those that others displace later are described in vain.
            let weakest = weakest(&found, options.max_keypoints);
            let is_early = |(strength, extremum): &(f32, Extremum)| {
                extremum.is_early() && strength.total_cmp(&weakest).is_ge()
            };
            let early: Vec<usize> = (0..found.len()).filter(|&i| is_early(&found[i])).collect();
            described = describe_all(slice::from_ref(first), &found, &early, options, &patches, stop);
            first.drop_level(EARLY);
        }
        let index = octaves.len();
        let is_last = index >= options.max_octaves || stop.is_set();
        next = if is_last { None } else { octaves[index - 1].next(index, options, backend, stop) };
    }

    let strongest = strongest(&found, options.max_keypoints);
    let others: Vec<usize> = strongest.iter().copied().filter(|&i| !found[i].1.is_early()).collect();
    described.extend(describe_all(&octaves, &found, &others, options, &patches, stop));
    drop(octaves);

    let mut rank = vec![usize::MAX; found.len()];
    for (k, &i) in strongest.iter().enumerate() {
        rank[i] = k;
    }
    described.retain(|described| rank[described.extremum] != usize::MAX);
    described.sort_by_key(|described| rank[described.extremum]);
    described.truncate(options.max_keypoints);
    let mut rows = Vec::with_capacity(described.len() * DESCRIPTOR);
    for described in &described {
        rows.extend_from_slice(&described.descriptor);
    }
    Features {
        keypoints: described.iter().map(|described| described.keypoint).collect(),
        descriptors: Descriptors::new(DescriptorKind::ROOT_SIFT, rows).expect("whole rows of 128 bytes"),
        global: None,
    }
}

/// One keypoint.
struct Described {
    /// Index of its extremum, in the order of detection.
    extremum: usize,
    keypoint: Keypoint,
    descriptor: [u8; DESCRIPTOR],
}

/// The keypoints of the extrema `which` of `found`, in their order.
fn describe_all(
    octaves: &[Octave],
    found: &[(f32, Extremum)],
    which: &[usize],
    options: &SiftOptions,
    patches: &Patches,
    stop: &Stop,
) -> Vec<Described> {
    let chunks: Vec<Vec<Described>> = which
        .par_chunks(CHUNK)
        .map_init(Memory::new, |memory, chunk| {
            let mut described = Vec::with_capacity(2 * chunk.len());
            for &i in chunk.iter().take_while(|_| !stop.is_set()) {
                describe(&octaves[found[i].1.octave], i, &found[i], options, patches, memory, &mut described);
            }
            described
        })
        .collect();
    chunks.into_iter().flatten().collect()
}

/// Keypoints that a thread describes before it asks for more.
const CHUNK: usize = 32;

/// Memory for the description of keypoints, one after another.
struct Memory {
    patch: Box<PatchMemory>,
    /// The surroundings of a keypoint at the border.
    mirrored: Plane,
    columns: Vec<usize>,
    /// Peaks of the directions.
    peaks: Vec<(f32, f32)>,
}

impl Memory {
    fn new() -> Self {
        Self { patch: PatchMemory::new(), mirrored: Plane::default(), columns: Vec::new(), peaks: Vec::new() }
    }
}

/// The strength of an extremum: the peak difference of Gaussians times the scale in pixels of the image.
///
/// Large keypoints are robust to a change of distance, high peaks to noise, but the largest keypoints have position
/// errors of a good part of a pixel: docs/decisions/0005-keypoints-are-ranked-by-peak-times-scale.md weighs recall
/// against precision of poses.
fn strength(extremum: &Extremum, octave: &Octave) -> f32 {
    let scale = sigma_of_level(f64::from(extremum.level)) * octave.step;
    extremum.response * scale as f32
}

/// The strength of the last of the `count` strongest extrema; none is too weak when there are fewer.
fn weakest(found: &[(f32, Extremum)], count: usize) -> f32 {
    if found.len() <= count {
        return f32::NEG_INFINITY;
    }
    let Some(last) = count.checked_sub(1) else { return f32::INFINITY };
    let mut strengths: Vec<f32> = found.iter().map(|(strength, _)| *strength).collect();
    *strengths.select_nth_unstable_by(last, |a, b| b.total_cmp(a)).1
}

/// At most `count` extrema, as indices, strongest first; equal ones in the order of detection.
fn strongest(found: &[(f32, Extremum)], count: usize) -> Vec<usize> {
    let mut ranked: Vec<usize> = (0..found.len()).collect();
    ranked.sort_by(|&a, &b| found[b].0.total_cmp(&found[a].0));
    ranked.truncate(count);
    ranked
}

/// Whether gradients of the descriptor window lie outside of the image, or have no neighbour on one side.
fn over_border(extremum: &Extremum, octave: &Octave) -> bool {
    let reach = veiloc_simd::sift::PATCH_RADIUS * sigma_of_level(f64::from(extremum.level)) as f32;
    let over = |at: f32, size: usize| at - reach < 1.0 || at + reach > size as f32 - 2.0;
    over(extremum.x, octave.width()) || over(extremum.y, octave.height())
}

/// Appends one keypoint per dominant direction of the extremum with index `index`.
fn describe(
    octave: &Octave,
    index: usize,
    (strength, extremum): &(f32, Extremum),
    options: &SiftOptions,
    patches: &Patches,
    memory: &mut Memory,
    described: &mut Vec<Described>,
) {
    let Memory { patch, mirrored, columns, peaks } = memory;
    let mut plane = octave.level(extremum.plane());
    let sigma = sigma_of_level(f64::from(extremum.level));
    let mut centre = [extremum.x, extremum.y];
    if options.border == Border::Mirrored && over_border(extremum, octave) {
        // The patch plus one sample around it, for gradients at its border.
        let reach = (veiloc_simd::sift::PATCH_RADIUS * sigma as f32).ceil() as usize + 2;
        let corner = centre.map(|c| c.floor() as isize - reach as isize);
        plane.mirrored(corner, [2 * reach + 2; 2], mirrored, columns);
        plane = mirrored;
        centre = [centre[0] - corner[0] as f32, centre[1] - corner[1] as f32];
    }
    let Some(view) = BlurredImage::new(&plane.data, plane.stride, plane.width, plane.height) else {
        return;
    };
    let bins = patches.directions(view, centre, sigma as f32, patch);
    let to_image = |sample: f32| f64::from(sample) * octave.step + octave.offset;
    for orientation in orientation::dominant(&bins, options.max_orientations, peaks) {
        let keypoint = Keypoint {
            pixel: Pixel::new(to_image(extremum.x), to_image(extremum.y)),
            scale: (sigma * octave.step) as f32,
            orientation,
            response: *strength,
        };
        let descriptor = patches.describe(view, centre, sigma as f32, orientation, patch);
        described.push(Described { extremum: index, keypoint, descriptor });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same features in a browser and on other platforms.
    #[test]
    fn every_backend_gives_the_same_features() {
        let (width, height) = (173, 141);
        let value = |x: u32, y: u32| {
            let (x, y) = (x as f32, y as f32);
            0.5 + 0.2 * ((0.31 * x + 0.07 * y).sin() * (0.11 * x - 0.23 * y).cos() + (0.0021 * x * y).sin())
        };
        let samples = (0..height).flat_map(|y| (0..width).map(move |x| value(x, y))).collect();
        let image = GrayImage::new(width, height, samples).expect("finite");
        for border in [Border::Cut, Border::Mirrored] {
            let options = SiftOptions { border, ..SiftOptions::default() };
            let stop = Stop::default();
            let expected = extract_on(Backend::PORTABLE, &image, &options, &stop);
            assert!(expected.keypoints.len() > 100, "{}", expected.keypoints.len());
            for backend in Backend::available() {
                assert!(extract_on(backend, &image, &options, &stop) == expected, "{}", backend.name());
            }
        }
    }
}
