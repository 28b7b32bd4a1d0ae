//! `points`: no protection. The position itself is sent, from the centre of the image.
//!
//! The baseline that the paper compares with (hloc on plain keypoints, Sec. 5). Of what is sent here, all is a keypoint but for
//! the dither of half a pixel and the rounding to quarter pixels ([`PositionRow`]).

use veiloc_protocol::{PositionRow, Rows};

use super::each;
use crate::SealError;

/// One row per position. `from_center`: `[u, v]` from the image's centre, dithered, pixels.
pub(super) fn rows(from_center: &[[f64; 2]]) -> Result<Rows, SealError> {
    Ok(Rows::Points(each(from_center, |&[u, v]| PositionRow::new(u, v))?))
}
