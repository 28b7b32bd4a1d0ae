//! The obfuscation schemes, one a file: from dithered positions to rows. Shared by sealing and by evaluation.
//!
//! | scheme | what is sent of a keypoint `x` | file |
//! |---|---|---|
//! | `points` | `x` | [`points`] |
//! | `random-lines` | a line of random direction through `x` | [`random_lines`] |
//! | `coordinate-permutation` | one coordinate of `x`, one of another keypoint | [`coordinate_permutation`] |
//! | `dcl` | the line through `x` and the anchor of its part of the image | [`dcl`] |

pub(crate) mod dcl;

mod coordinate_permutation;
mod points;
mod random_lines;

use rand::Rng;
use veiloc_geometry::{Pinhole, Pixel};
use veiloc_protocol::{AngleBits, Rows, Scheme};

use crate::SealError;
use crate::rule::FrameRule;
use dcl::DclLift;

/// One row per place, of a frame for itself. `dithered` are positions in an image of this camera, whose principal point is the
/// image's centre.
///
/// The error names the index of a place.
///
/// # Panics
/// For a camera without size or focal length.
pub(crate) fn lift<R: Rng + ?Sized>(
    dithered: &[Pixel],
    camera: &Pinhole,
    scheme: Scheme,
    bits: AngleBits,
    rng: &mut R,
) -> Result<Rows, SealError> {
    let center = [f64::from(camera.width) / 2.0, f64::from(camera.height) / 2.0];
    let from_center = || dithered.iter().map(|p| [p.u - center[0], p.v - center[1]]).collect::<Vec<_>>();
    match scheme {
        Scheme::Points => points::rows(&from_center()),
        Scheme::RandomLines => random_lines::rows(&from_center(), bits, rng),
        Scheme::CoordinatePermutation => coordinate_permutation::rows(from_center(), center, rng),
        Scheme::Dcl(layout) => {
            let rule = FrameRule::default();
            let dcl = DclLift::new(layout, camera, &rule, bits);
            Ok(dcl.rows(&dcl.told_of_all(dithered)))
        }
    }
}

/// Row `i` of the result is row `order[i]` of `rows`.
pub(crate) fn select(rows: &Rows, order: impl Iterator<Item = usize> + Clone) -> Rows {
    match rows {
        Rows::Points(r) => Rows::Points(order.map(|i| r[i]).collect()),
        Rows::RandomLines(r) => Rows::RandomLines(order.map(|i| r[i]).collect()),
        Rows::CoordinatePermutation(r) => Rows::CoordinatePermutation(order.map(|i| r[i]).collect()),
        Rows::Dcl(r) => Rows::Dcl(order.map(|i| r[i]).collect()),
    }
}

/// Rows of all places, or the first that has none.
fn each<P, T>(places: &[P], row: impl Fn(&P) -> Option<T>) -> Result<Vec<T>, SealError> {
    places.iter().enumerate().map(|(index, p)| row(p).ok_or(SealError::TooFar { index })).collect()
}
