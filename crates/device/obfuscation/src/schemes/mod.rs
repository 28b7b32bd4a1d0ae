//! The obfuscation schemes, one per file: from dithered positions to rows. Sealing and evaluation share them.
//!
//! | scheme | what is sent for a keypoint `x` | file |
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
use veiloc_protocol::{AngleBits, DclLayout, Rows, Scheme};

use crate::SealError;
use crate::rule::FrameRule;
use dcl::DclLift;

/// One row per position, for a single frame outside of a session. `dithered` are positions in an image of this camera,
/// whose principal point is the image's centre.
///
/// The error names the index of a position.
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
            Ok(dcl.rows(&match layout {
                DclLayout::Random => dcl.of_random_anchors(dithered, rng),
                DclLayout::Halves(_) | DclLayout::Sectors(_) => dcl.anchor_angles(dithered),
            }))
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

/// Rows of all positions, or an error with the index of the first position that has none.
fn each<P, T>(positions: &[P], row: impl Fn(&P) -> Option<T>) -> Result<Vec<T>, SealError> {
    positions.iter().enumerate().map(|(index, p)| row(p).ok_or(SealError::TooFar { index })).collect()
}
