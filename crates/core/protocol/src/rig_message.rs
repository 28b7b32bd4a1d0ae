//! The sealed queries of a session and the position of each image on the device, as one byte string.
//!
//! ```text
//! "vqrig1\n"                          7 bytes
//! frames                              1 byte, 1 to 32
//! each frame:
//!   q: w x y z, t: x y z              seven numbers of 8 bytes: the rig seen from the camera, map units
//!   rotation_sd_deg, translation_sd   two numbers of 8 bytes
//!   length                            4 bytes
//!   a sealed query                    that many bytes
//! ```
//!
//! Numbers are little-endian, those of 8 bytes IEEE 754. Nothing follows the last frame.

use std::fmt;

use veiloc_geometry::CameraFromRig;

use crate::{QueryError, SealedQuery};

const WHAT: &str = "session";
const MAGIC: &[u8] = b"vqrig1\n";
/// The beginning of messages of every version; digits and a line break follow.
const ANY_VERSION: &[u8] = b"vqrig";
const VERSION: u32 = 1;

/// A sealed query and the pose of its image on the rig (the device).
#[derive(Clone)]
pub struct SealedFrame {
    /// The sealed query.
    pub query: SealedQuery,
    /// By the device's odometry, translation in map units.
    pub cam_from_rig: CameraFromRig,
    /// Standard deviation of that rotation about each axis, degrees; 0 or more. With 0 here and in
    /// [`Self::translation_sd`] the frame is fixed to the rig.
    pub rotation_sd_deg: f64,
    /// Standard deviation of the camera's position along each axis, map units; 0 or more.
    pub translation_sd: f64,
}

/// Rule L8: the motion of a device must not appear in logs.
impl fmt::Debug for SealedFrame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SealedFrame").field("query", &self.query).finish_non_exhaustive()
    }
}

/// What a device sends to be localized by several images at once.
#[derive(Debug, Clone)]
pub struct RigMessage {
    /// 1 to [`Self::MAX_FRAMES`].
    pub frames: Vec<SealedFrame>,
}

impl RigMessage {
    /// Maximum number of frames.
    pub const MAX_FRAMES: usize = 32;

    /// Bytes of a frame beside its sealed query.
    const FRAME_BYTES: usize = 9 * 8 + 4;

    /// Length of the longest message whose sealed queries have at most `query` bytes each.
    pub const fn longest(query: usize) -> usize {
        MAGIC.len() + 1 + Self::MAX_FRAMES * (Self::FRAME_BYTES + query)
    }

    /// Encodes the message. With more than [`Self::MAX_FRAMES`] frames, [`Self::decode`] rejects it.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.push(u8::try_from(self.frames.len()).unwrap_or(u8::MAX));
        for frame in &self.frames {
            let t = frame.cam_from_rig.translation();
            let numbers = frame.cam_from_rig.quaternion().into_iter().chain([t.x, t.y, t.z]);
            for number in numbers.chain([frame.rotation_sd_deg, frame.translation_sd]) {
                bytes.extend(number.to_le_bytes());
            }
            let query = frame.query.encode();
            bytes.extend(u32::try_from(query.len()).unwrap_or(u32::MAX).to_le_bytes());
            bytes.extend(query);
        }
        bytes
    }

    /// Decodes the bytes; they must hold nothing else.
    ///
    /// # Errors
    /// [`QueryError`]: not such a message, another version, truncated, an invalid number of frames, an invalid pose or
    /// deviation, or an error of [`SealedQuery::decode`] for a frame.
    pub fn decode(bytes: &[u8]) -> Result<Self, QueryError> {
        let malformed = |reason: String| QueryError::Malformed { what: WHAT, reason };
        let mut rest = bytes.strip_prefix(MAGIC).ok_or_else(|| match version_of(bytes) {
            Some(found) => QueryError::Version {
                what: WHAT,
                found,
                supported: VERSION,
                remedy: "update the app that sealed it or the program that reads it, whichever is older",
            },
            None => malformed("another file type".to_owned()),
        })?;
        let count = take(&mut rest, 1).map_or(0, |byte| byte[0]);
        if !(1..=Self::MAX_FRAMES).contains(&usize::from(count)) {
            return Err(QueryError::Field { field: "frames", value: count.into(), allowed: "1 to 32" });
        }
        let mut frames = Vec::with_capacity(count.into());
        for frame in 0..count {
            let cut = || malformed(format!("frame {frame} is cut short"));
            let mut numbers = [0.0; 9];
            for number in &mut numbers {
                let bytes = take(&mut rest, 8).and_then(|b| b.try_into().ok()).ok_or_else(cut)?;
                *number = f64::from_le_bytes(bytes);
            }
            let [w, x, y, z, tx, ty, tz, rotation_sd_deg, translation_sd] = numbers;
            let cam_from_rig = CameraFromRig::from_quaternion([w, x, y, z], [tx, ty, tz])
                .ok_or_else(|| malformed(format!("frame {frame} has no pose")))?;
            if ![rotation_sd_deg, translation_sd].iter().all(|sd| sd.is_finite() && *sd >= 0.0) {
                return Err(malformed(format!("frame {frame} has no standard deviations")));
            }
            let length = take(&mut rest, 4).and_then(|b| b.try_into().ok()).ok_or_else(cut)?;
            let query = take(&mut rest, u32::from_le_bytes(length) as usize).ok_or_else(cut)?;
            let query = SealedQuery::decode(query)?;
            frames.push(SealedFrame { query, cam_from_rig, rotation_sd_deg, translation_sd });
        }
        if rest.is_empty() { Ok(Self { frames }) } else { Err(QueryError::NotCanonical { what: WHAT }) }
    }
}

/// The version in the first line.
fn version_of(bytes: &[u8]) -> Option<u32> {
    let line = bytes.strip_prefix(ANY_VERSION)?.split(|byte| *byte == b'\n').next()?;
    std::str::from_utf8(line).ok()?.parse().ok()
}

fn take<'a>(rest: &mut &'a [u8], count: usize) -> Option<&'a [u8]> {
    let (taken, left) = rest.split_at_checked(count)?;
    *rest = left;
    Some(taken)
}
