//! **Never for devices.** Obfuscation that also returns the ground truth, for attacks and evaluation.
//!
//! All functions run the code of a device without changes; they only do not discard the ground truth. The module exists
//! only with the cargo feature `ground-truth`, which no crate of a device build enables (`tests/device_build.rs`).

use rand::{CryptoRng, Rng};
use veiloc_descriptor::Descriptors;
use veiloc_geometry::{Pinhole, Pixel};
use veiloc_protocol::{AngleBits, LayoutTurn, Observations, Scheme, SealedQuery};

use crate::decoy;
use crate::positions::{DistinctPositions, dither};
use crate::schemes::{lift, select};
use crate::seal::HiddenState;
use crate::{DeviceLimits, Extracted, SealError, SealOptions, Sealer, SessionSealer};

/// The ground truth of a sealed query. `[N]` each, in the order of its rows.
#[derive(Clone, PartialEq)]
pub struct SealTruth {
    /// Index of the feature in the input; `None` for a decoy.
    pub source: Vec<Option<usize>>,
    /// Keypoint position in the canonical camera's image, before dither; for a decoy, its generated position.
    pub pixels: Vec<Pixel>,
}

// Rule L8 (no positions in logs) applies to the ground truth as well.
impl std::fmt::Debug for SealTruth {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "SealTruth({})", self.source.len())
    }
}

impl Sealer {
    /// As [`Sealer::seal`], and returns the ground truth. For the audit and for evaluation only.
    ///
    /// # Errors
    /// As [`Sealer::seal`].
    pub fn seal_with_truth(
        &self,
        extracted: Extracted,
        rng: &mut impl CryptoRng,
    ) -> Result<(SealedQuery, SealTruth), SealError> {
        self.seal_and(&extracted, rng, SealTruth::of)
    }
}

impl SessionSealer<'_> {
    /// As [`SessionSealer::seal`], and returns the ground truth. For the audit and for evaluation only.
    ///
    /// # Errors
    /// As [`SessionSealer::seal`].
    pub fn seal_with_truth(
        self,
        extracted: Extracted,
        rng: &mut impl CryptoRng,
    ) -> Result<(SealedQuery, SealTruth), SealError> {
        self.session.seal_and(self.sealer, &extracted, rng, SealTruth::of)
    }
}

impl SealTruth {
    fn of(hidden: &HiddenState<'_>) -> Self {
        Self {
            source: hidden
                .order
                .iter()
                .map(|&row| hidden.selected.get(row).map(|selected| selected.source))
                .collect(),
            pixels: hidden
                .order
                .iter()
                .map(|&row| hidden.positions.pixels[hidden.positions.index[row]])
                .collect(),
        }
    }
}

/// Seal options of an evaluation: any scheme, `points` too, and as many keypoints as the profile requests.
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
        max_pack_rows: usize::MAX,
    };
    options.with_limits(everything)
}

/// Obfuscates bare positions in the given order, `[N]`: dither, line and quantization as in [`Sealer::seal`], but
/// nothing is dropped, filled up or shuffled. For evaluation on given correspondences.
///
/// Equal positions get equal observations, as in [`Sealer::seal`].
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
    let positions = DistinctPositions::new(points.iter().copied());
    let dithered: Vec<Pixel> = positions.pixels.iter().map(|p| dither(*p, rng)).collect();
    // The focal length of a bare image is unknown; the longer side stands for it.
    let focal = f64::from(width.max(height).max(1));
    let principal = [width, height].map(|side| 0.5 * f64::from(side));
    let camera = Pinhole { width: width.max(1), height: height.max(1), focal: [focal; 2], principal };
    let turn = LayoutTurn::default();
    let rows = lift(&dithered, &camera, *scheme, angle_bits, rng).map_err(|e| match e {
        SealError::TooFar { index: position } => SealError::TooFar {
            index: positions.index.iter().position(|p| *p == position).unwrap_or(position),
        },
        other => other,
    })?;
    let rows = select(&rows, positions.index.iter().copied());
    Ok(rows.observations(*scheme, angle_bits, &camera, turn).expect("the rows were lifted under this scheme"))
}

/// Decoys as [`Sealer::seal`] makes them beside rows with these keypoints and descriptors: `count` positions and
/// descriptors. For evaluation of larger numbers of decoys.
///
/// Positions lie in the image. An image without keypoints gets no decoys.
///
/// # Errors
/// [`SealError::NoDecoys`] for a descriptor kind with too few dimensions, and for too few rows to blend.
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
    let mut positions = DistinctPositions::new(keypoints.iter().copied());
    let [width, height] = size.map(f64::from);
    let inside = |p: Pixel| (0.0..width).contains(&p.u) && (0.0..height).contains(&p.v);
    let mut all = descriptors.clone();
    decoy::add(&mut positions, &mut all, count, size, inside, rng)?;
    let invented = all.select(descriptors.len()..all.len());
    let pixels =
        positions.index[keypoints.len()..].iter().map(|position| positions.pixels[*position]).collect();
    Ok((pixels, invented))
}
