//! The section of a compressed map: one record for the map, then one per point.

use zerocopy::{FromBytes, IntoBytes};

use super::layout::{CompressedRecord, PointSummaryRecord};
use crate::compressed::{PointSummary, WholeMapSummary};

/// Encodes the section with these point summaries: all of them, or none in a packed map, which has them in its own
/// section.
pub(super) fn encode(compressed: &WholeMapSummary, summaries: &[PointSummary]) -> Vec<u8> {
    let WholeMapSummary { bytes, keypoints, points, of_points: _, packed_from: _ } = compressed;
    let head = CompressedRecord { bytes: *bytes, keypoints: *keypoints, points: *points };
    let mut encoded = head.as_bytes().to_vec();
    for PointSummary { seen_by, covariance } in summaries {
        let record = PointSummaryRecord { seen_by: *seen_by, covariance: *covariance };
        encoded.extend_from_slice(record.as_bytes());
    }
    encoded
}

/// Decodes the section and checks it against the track lengths; returns the reason if it is invalid.
pub(super) fn decode(
    bytes: &[u8],
    track_lengths: impl ExactSizeIterator<Item = usize>,
) -> Result<WholeMapSummary, String> {
    let (head, rest) = head(bytes)?;
    let records = <[PointSummaryRecord]>::ref_from_bytes(rest).map_err(|_| "not whole records".to_owned())?;
    let summary = |r: &PointSummaryRecord| PointSummary { seen_by: r.seen_by, covariance: r.covariance };
    let compressed = WholeMapSummary {
        bytes: head.bytes,
        keypoints: head.keypoints,
        points: head.points,
        of_points: records.iter().map(summary).collect(),
        packed_from: None,
    };
    compressed.check(track_lengths)?;
    Ok(compressed)
}

/// Splits off the first record.
fn head(bytes: &[u8]) -> Result<(CompressedRecord, &[u8]), String> {
    CompressedRecord::read_from_prefix(bytes).map_err(|_| "shorter than its first record".to_owned())
}

/// Decodes the section of a packed map, whose point summaries are in another section.
pub(super) fn decode_packed(
    bytes: &[u8],
    of_points: Vec<PointSummary>,
    origin: [f64; 3],
) -> Result<WholeMapSummary, String> {
    match head(bytes)? {
        (head, []) => Ok(WholeMapSummary {
            bytes: head.bytes,
            keypoints: head.keypoints,
            points: head.points,
            of_points,
            packed_from: Some(origin),
        }),
        _ => Err("has summaries of points, which a packed map has in its own section".to_owned()),
    }
}
