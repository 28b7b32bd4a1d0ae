//! SIFT keypoints with RootSIFT descriptors.
//!
//! Written from Lowe, *Distinctive Image Features from Scale-Invariant Keypoints*, IJCV 2004, with the constants that
//! VLFeat and COLMAP chose; RootSIFT from Arandjelović and Zisserman, *Three things everyone should know to improve
//! object retrieval*, CVPR 2012.
//!
//! ```text
//! image → [doubled] → 6 blurred levels per octave → differences → extrema → refined → ranked, cut
//!         → directions → descriptors
//! ```
//!
//! Sample `x` of octave `o` lies at `(x + 0.5) * 0.5` of the image in the doubled first octave, and at
//! `x * 2^o * 0.5 + 0.25` in octave `o`: halving keeps every second sample, so the first one stays where it is.
//!
//! Every sum has one order and work is cut by rows and keypoints, never by threads: equal images give equal bytes
//! with any number of threads.

mod blur;
mod descriptor;
mod extrema;
mod gradient;
mod octave;
mod options;
mod orientation;
mod plane;

use rayon::prelude::*;
use veiloc_descriptor::{DescriptorKind, Descriptors};
use veiloc_geometry::Pixel;

pub use options::{Border, SiftOptions};

use crate::{Features, GrayImage, Keypoint};
use extrema::Extremum;
use gradient::GradientRow;
use octave::{Octave, SCALES, sigma_of_level};

/// How far from a keypoint its descriptor looks, as a multiple of the keypoint's scale.
pub(crate) const REACH: f64 = descriptor::REACH as f64;

/// Finds keypoints and describes them, strongest first.
///
/// An image without structure, or too small for any, gives none. Memory: about 25 times the samples of `image` in
/// `f32` when it is doubled, a quarter of that when not.
pub fn extract_sift(image: &GrayImage, options: &SiftOptions) -> Features {
    let (octaves, mut extrema) = scale_space(image, options);
    rank(&mut extrema, &octaves);
    extrema.truncate(options.max_keypoints);

    let described: Vec<(Keypoint, [u8; descriptor::DIM])> = extrema
        .par_iter()
        .map_init(GradientRow::default, |gradients, extremum| {
            describe(&octaves[extremum.octave], extremum, options, gradients)
        })
        .flatten_iter()
        .collect();
    let kept = &described[..described.len().min(options.max_keypoints)];
    let rows = kept.iter().flat_map(|(_, row)| *row).collect();
    Features {
        keypoints: kept.iter().map(|(keypoint, _)| *keypoint).collect(),
        descriptors: Descriptors::new(DescriptorKind::ROOT_SIFT, rows).expect("whole rows of 128 bytes"),
    }
}

/// All octaves, of each the levels where keypoints are described, and the extrema found in them.
fn scale_space(image: &GrayImage, options: &SiftOptions) -> (Vec<Octave>, Vec<Extremum>) {
    let mut octaves = Vec::new();
    let mut extrema = Vec::new();
    let mut next = (options.max_octaves > 0).then(|| Octave::first(image, options.upsample));
    while let Some(mut octave) = next {
        extrema.extend(extrema::find(&octave, octaves.len(), options));
        next = if octaves.len() + 1 < options.max_octaves { octave.next() } else { None };
        octaves.push(octave);
    }
    (octaves, extrema)
}

/// Strongest first; equal ones in the order they were found.
fn rank(extrema: &mut [Extremum], octaves: &[Octave]) {
    let strength = |extremum: &Extremum| strength(extremum, &octaves[extremum.octave]);
    extrema.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
}

/// Peak difference of Gaussians times the scale in pixels of the image.
///
/// Large keypoints survive a change of distance, high peaks survive noise, but the largest lie a good part of a pixel
/// off: docs/decisions/0005-keypoints-are-ranked-by-peak-times-scale.md weighs recall against precision of poses.
fn strength(extremum: &Extremum, octave: &Octave) -> f32 {
    let scale = sigma_of_level(f64::from(extremum.level)) * octave.step;
    extremum.response * scale as f32
}

/// Whether gradients that count for the descriptor lie outside of the image, or have no neighbour on one side.
fn over_border(extremum: &Extremum, octave: &Octave) -> bool {
    let reach = descriptor::REACH * sigma_of_level(f64::from(extremum.level)) as f32;
    let over = |at: f32, size: usize| at - reach < 1.0 || at + reach > size as f32 - 2.0;
    over(extremum.x, octave.width()) || over(extremum.y, octave.height())
}

/// One keypoint per dominant direction of an extremum.
fn describe(
    octave: &Octave,
    extremum: &Extremum,
    options: &SiftOptions,
    gradients: &mut GradientRow,
) -> Vec<(Keypoint, [u8; descriptor::DIM])> {
    let level = (extremum.level.round() as usize).clamp(1, SCALES);
    let mut plane = &octave.levels[level];
    let sigma = sigma_of_level(f64::from(extremum.level));
    let mut centre = [extremum.x, extremum.y];
    let continued;
    if options.border == Border::Mirrored && over_border(extremum, octave) {
        // The patch and a sample around it, for gradients at its end.
        let reach = (descriptor::REACH * sigma as f32).ceil() as usize + 2;
        let corner = centre.map(|c| c.floor() as isize - reach as isize);
        continued = plane.mirrored(corner, [2 * reach + 2; 2]);
        plane = &continued;
        centre = [centre[0] - corner[0] as f32, centre[1] - corner[1] as f32];
    }
    let directions = orientation::dominant(plane, centre, sigma as f32, options.max_orientations, gradients);
    let place = |sample: f32| f64::from(sample) * octave.step + octave.offset;
    directions
        .into_iter()
        .map(|orientation| {
            let keypoint = Keypoint {
                pixel: Pixel::new(place(extremum.x), place(extremum.y)),
                scale: (sigma * octave.step) as f32,
                orientation,
                response: strength(extremum, octave),
            };
            (keypoint, descriptor::describe(plane, centre, sigma as f32, orientation, gradients))
        })
        .collect()
}
