//! `points`: no protection. The position itself is sent, from the centre of the image.
//!
//! The baseline of the paper's comparison (hloc on plain keypoints, Sec. 5). Only the dither of half a pixel and the
//! rounding to quarter pixels change the position ([`PositionRow`]).

use veiloc_protocol::{PositionRow, Rows};

use super::each;
use crate::SealError;

/// One row per position. `from_center`: `[u, v]` from the image's centre, dithered, pixels.
pub(super) fn rows(from_center: &[[f64; 2]]) -> Result<Rows, SealError> {
    Ok(Rows::Points(each(from_center, |&[u, v]| PositionRow::new(u, v))?))
}
