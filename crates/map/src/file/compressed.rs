//! The section of a compressed map: one record for all of it, then one a point.

use zerocopy::{FromBytes, IntoBytes};

use super::layout::{CompressedRecord, RememberedRecord};
use crate::compressed::{Compressed, Remembered};

pub(super) fn encode(compressed: &Compressed) -> Vec<u8> {
    let Compressed { bytes, keypoints, points, of_points } = compressed;
    let head = CompressedRecord { bytes: *bytes, keypoints: *keypoints, points: *points };
    let mut encoded = head.as_bytes().to_vec();
    for Remembered { seen_by, covariance } in of_points {
        let record = RememberedRecord { seen_by: *seen_by, covariance: *covariance };
        encoded.extend_from_slice(record.as_bytes());
    }
    encoded
}

/// The section's content, of a map whose points have so many observations; what is wrong with it otherwise.
pub(super) fn decode(
    bytes: &[u8],
    track_lengths: impl ExactSizeIterator<Item = usize>,
) -> Result<Compressed, String> {
    let (head, rest) =
        CompressedRecord::read_from_prefix(bytes).map_err(|_| "shorter than its first record".to_owned())?;
    let records = <[RememberedRecord]>::ref_from_bytes(rest).map_err(|_| "not whole records".to_owned())?;
    let remembered = |r: &RememberedRecord| Remembered { seen_by: r.seen_by, covariance: r.covariance };
    let compressed = Compressed {
        bytes: head.bytes,
        keypoints: head.keypoints,
        points: head.points,
        of_points: records.iter().map(remembered).collect(),
    };
    compressed.check(track_lengths)?;
    Ok(compressed)
}
