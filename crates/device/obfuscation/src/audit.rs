//! **Never for devices.** Obfuscation that keeps the answers, for attacks and evaluation to be judged by.
//!
//! All run the code a device runs, line for line; they only do not forget. This module is there with the cargo feature
//! `ground-truth` only, which no crate of the device's road turns on (`tests/device_build.rs`).

use rand::{CryptoRng, Rng};
use veiloc_descriptor::Descriptors;
use veiloc_features::Features;
use veiloc_geometry::{Intrinsics, Pinhole, Pixel};
use veiloc_protocol::{AngleBits, LayoutTurn, Observations, Profile, Scheme, SealedQuery};

use crate::decoy;
use crate::places::{Places, dither};
use crate::rule::FrameRule;
use crate::schemes::{lift, select};
use crate::seal::{Hidden, seal_frame};
use crate::{DeviceLimits, Orientation, SealError, SealOptions, Session};

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
    options: &SealOptions,
    rng: &mut impl CryptoRng,
) -> Result<(SealedQuery, SealTruth), SealError> {
    seal_frame(&features, camera, profile, options, &FrameRule::default(), rng, SealTruth::of)
}

impl Session {
    /// As [`Session::seal`], and returns what was hidden. For the audit and for evaluation only.
    ///
    /// # Errors
    /// As [`Session::seal`].
    pub fn seal_with_truth(
        &mut self,
        features: Features,
        camera: &Intrinsics,
        profile: &Profile,
        options: &SealOptions,
        held: &Orientation,
        rng: &mut impl CryptoRng,
    ) -> Result<(SealedQuery, SealTruth), SealError> {
        self.seal_and(features, (camera, profile), options, held, rng, SealTruth::of)
    }
}

impl SealTruth {
    fn of(hidden: &Hidden<'_>) -> Self {
        Self {
            source: hidden.order.iter().map(|&row| hidden.kept.get(row).map(|kept| kept.source)).collect(),
            pixels: hidden.order.iter().map(|&row| hidden.places.pixels[hidden.places.of[row]]).collect(),
        }
    }
}

/// How an evaluation seals under any scheme, `points` too, as many keypoints as the profile asks for.
pub fn options_for(scheme: Scheme) -> SealOptions {
    let options = match scheme {
        Scheme::Points => SealOptions::unprotected_points(),
        Scheme::RandomLines | Scheme::CoordinatePermutation | Scheme::Dcl(_) => {
            SealOptions::new(scheme).expect("it hides positions")
        }
    };
    let everything = DeviceLimits {
        max_keypoints: usize::MAX,
        max_image_side: u32::MAX,
        max_vocabulary_words: usize::MAX,
    };
    options.with_limits(everything)
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
    // Of a bare image the focal length is not known, and taken to be the longer side.
    let focal = f64::from(width.max(height).max(1));
    let principal = [width, height].map(|side| 0.5 * f64::from(side));
    let camera = Pinhole { width: width.max(1), height: height.max(1), focal: [focal; 2], principal };
    let turn = LayoutTurn::default();
    let rows = lift(&dithered, &camera, *scheme, angle_bits, rng).map_err(|e| match e {
        SealError::TooFar { index: place } => {
            SealError::TooFar { index: places.of.iter().position(|p| *p == place).unwrap_or(place) }
        }
        other => other,
    })?;
    let rows = select(&rows, places.of.iter().copied());
    Ok(rows.observations(*scheme, angle_bits, &camera, turn).expect("the rows were lifted under this scheme"))
}

/// Decoys as [`crate::seal`] invents them beside rows with these keypoints and descriptors, `count` of each. For
/// evaluation of how many more of them would do.
///
/// Positions lie in the image. Nothing is invented for an image without keypoints.
///
/// # Errors
/// [`SealError::NoDecoys`] for a kind of too few numbers, and for fewer rows than can be blended.
pub fn decoys(
    keypoints: &[Pixel],
    descriptors: &Descriptors,
    size: [u32; 2],
    count: usize,
    rng: &mut impl Rng,
) -> Result<(Vec<Pixel>, Descriptors), SealError> {
    if keypoints.is_empty() || descriptors.is_empty() {
        return Ok((Vec::new(), Descriptors::empty(descriptors.kind())));
    }
    let mut places = Places::new(keypoints.iter().copied());
    let [width, height] = size.map(f64::from);
    let inside = |p: Pixel| (0.0..width).contains(&p.u) && (0.0..height).contains(&p.v);
    decoy::add_places(&mut places, keypoints.len(), count, size, inside, rng);
    let mut all = descriptors.clone();
    decoy::add_descriptors(&mut all, count, rng)?;
    let invented = all.select(descriptors.len()..all.len());
    let pixels = places.of[keypoints.len()..].iter().map(|place| places.pixels[*place]).collect();
    Ok((pixels, invented))
}
