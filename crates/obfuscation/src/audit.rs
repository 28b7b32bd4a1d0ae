//! **Never for devices.** Obfuscation that keeps the answers, for attacks and evaluation to be judged by.
//!
//! All run the code a device runs, line for line; they only do not forget.

use rand::{CryptoRng, Rng};
use veiloc_descriptor::Descriptors;
use veiloc_features::Features;
use veiloc_geometry::{Intrinsics, Pixel};
use veiloc_query::{AngleBits, Observations, Profile, Scheme, SealedQuery};

use crate::SealError;
use crate::decoy;
use crate::lift::{Places, dither, lift, select};
use crate::seal::seal_frame;

/// What a sealed query hides. `[N]` each, in the order of its rows.
#[derive(Clone, PartialEq)]
pub struct SealTruth {
    /// Index of the feature in the input; `None` for a decoy.
    pub source: Vec<Option<usize>>,
    /// Where the keypoint is in the canonical camera's image, before dither; of a decoy, where it was invented.
    pub pixels: Vec<Pixel>,
}

// L8 holds for the truth all the more.
impl std::fmt::Debug for SealTruth {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "SealTruth({})", self.source.len())
    }
}

/// As [`crate::seal`], and returns what was hidden. For the audit and for evaluation only.
///
/// # Errors
/// As [`crate::seal`].
pub fn seal_with_truth(
    features: Features,
    camera: &Intrinsics,
    profile: &Profile,
    rng: &mut impl CryptoRng,
) -> Result<(SealedQuery, SealTruth), SealError> {
    seal_frame(features, camera, profile, usize::MAX, rng)
}

/// Obfuscates bare positions in the order given, `[N]`: dither, line and quantization as in [`crate::seal`], but
/// nothing is dropped, filled up or shuffled. For evaluation on given correspondences.
///
/// Equal positions get equal observations, as in [`crate::seal`].
///
/// # Errors
/// [`SealError::NotFinite`] and [`SealError::TooFar`], naming the index of the point.
pub fn obfuscate_points(
    points: &[Pixel],
    width: u32,
    height: u32,
    scheme: &Scheme,
    angle_bits: AngleBits,
    rng: &mut impl Rng,
) -> Result<Observations, SealError> {
    if let Some(index) = points.iter().position(|p| !p.is_finite()) {
        return Err(SealError::NotFinite { index });
    }
    let places = Places::new(points.iter().copied());
    let dithered: Vec<Pixel> = places.pixels.iter().map(|p| dither(*p, rng)).collect();
    let rows = lift(&dithered, [width, height], *scheme, angle_bits, rng).map_err(|e| match e {
        SealError::TooFar { index: place } => {
            SealError::TooFar { index: places.of.iter().position(|p| *p == place).unwrap_or(place) }
        }
        other => other,
    })?;
    let rows = select(&rows, places.of.iter().copied());
    Ok(rows
        .observations(*scheme, angle_bits, [width, height])
        .expect("the rows were lifted under this scheme"))
}

/// Decoys as [`crate::seal`] invents them for an image with these keypoints and descriptors, `count` of each. For
/// evaluation of how many more of them would do.
///
/// Positions lie in the image. Nothing is invented for an image without keypoints.
pub fn decoys(
    keypoints: &[Pixel],
    descriptors: &Descriptors,
    size: [u32; 2],
    count: usize,
    rng: &mut impl Rng,
) -> (Vec<Pixel>, Descriptors) {
    let mut invented = descriptors.select(std::iter::empty());
    if keypoints.is_empty() || descriptors.is_empty() {
        return (Vec::new(), invented);
    }
    let mut places = Places::new(keypoints.iter().copied());
    let [width, height] = size.map(f64::from);
    let inside = |p: Pixel| (0.0..width).contains(&p.u) && (0.0..height).contains(&p.v);
    decoy::add_places(&mut places, keypoints.len(), count, size, inside, rng);
    decoy::add_descriptors(&mut invented, descriptors, count, rng);
    (places.of[keypoints.len()..].iter().map(|place| places.pixels[*place]).collect(), invented)
}
