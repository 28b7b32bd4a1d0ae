//! `random-lines`: a keypoint becomes a line of random direction through it.
//!
//! Paper, Sec. 3 "Geometry obfuscation via 2D line lifting", after Speciale et al., *Privacy Preserving Image Queries
//! for Camera Localization*, ICCV 2019: any point of the line is `x + t v` with a direction `v` that is uniform over
//! the half circle.
//!
//! The direction is drawn as a wire code, and the offset of the line is rounded to quarter pixels ([`LineRow`]), so
//! that neither identifies the position (rule L9).

use rand::Rng;
use veiloc_protocol::{AngleBits, LineRow, Rows};

use super::each;
use crate::SealError;

/// One row per position. `from_center`: `[u, v]` from the image's centre, dithered, pixels.
pub(super) fn rows<R: Rng + ?Sized>(
    from_center: &[[f64; 2]],
    bits: AngleBits,
    rng: &mut R,
) -> Result<Rows, SealError> {
    // All directions are drawn before any position is read (rule L9).
    let angles: Vec<u16> =
        (0..from_center.len()).map(|_| rng.random_range(0..bits.levels()) as u16).collect();
    let lines: Vec<_> = angles.into_iter().zip(from_center).collect();
    Ok(Rows::RandomLines(each(&lines, |&(angle, &[u, v])| LineRow::through(bits, angle, u, v))?))
}
