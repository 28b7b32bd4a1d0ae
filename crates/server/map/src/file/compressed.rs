//! The section of a compressed map: one record for all of it, then one a point.

use zerocopy::{FromBytes, IntoBytes};

use super::layout::{CompressedRecord, RememberedRecord};
use crate::compressed::{Compressed, Remembered};

/// The section, with what is remembered of these points: all, or none in a packed map, which has them in a section of its own.
pub(super) fn encode(compressed: &Compressed, here: &[Remembered]) -> Vec<u8> {
    let Compressed { bytes, keypoints, points, of_points: _, packed_from: _ } = compressed;
    let head = CompressedRecord { bytes: *bytes, keypoints: *keypoints, points: *points };
    let mut encoded = head.as_bytes().to_vec();
    for Remembered { seen_by, covariance } in here {
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
    let (head, rest) = head(bytes)?;
    let records = <[RememberedRecord]>::ref_from_bytes(rest).map_err(|_| "not whole records".to_owned())?;
    let remembered = |r: &RememberedRecord| Remembered { seen_by: r.seen_by, covariance: r.covariance };
    let compressed = Compressed {
        bytes: head.bytes,
        keypoints: head.keypoints,
        points: head.points,
        of_points: records.iter().map(remembered).collect(),
        packed_from: None,
    };
    compressed.check(track_lengths)?;
    Ok(compressed)
}

/// The section's first record, and what follows.
fn head(bytes: &[u8]) -> Result<(CompressedRecord, &[u8]), String> {
    CompressedRecord::read_from_prefix(bytes).map_err(|_| "shorter than its first record".to_owned())
}

/// The section's content in a packed map, which remembers points elsewhere.
pub(super) fn decode_packed(
    bytes: &[u8],
    of_points: Vec<Remembered>,
    origin: [f64; 3],
) -> Result<Compressed, String> {
    match head(bytes)? {
        (head, []) => Ok(Compressed {
            bytes: head.bytes,
            keypoints: head.keypoints,
            points: head.points,
            of_points,
            packed_from: Some(origin),
        }),
        _ => Err("remembers points, which a packed map does elsewhere".to_owned()),
    }
}
