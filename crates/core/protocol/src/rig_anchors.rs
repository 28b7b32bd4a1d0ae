//! Whether the frames of a rig share their anchors: the device checks it before it sends them (rule L10).
//!
//! A rig tells how its cameras stand to each other. If two of them see a keypoint under different anchors, its two planes
//! meet in its ray, so frames of one view must be sealed in one session. What the device knows decides, frame by frame:
//!
//! | how the two frames were sealed | together in a rig |
//! |---|---|
//! | in one session | always, also where it placed its anchors anew because the camera turned away: it drops what it sent before |
//! | alone, or in two sessions | only if no keypoint can be in both: exact rotations about one centre, and views apart |
//! | in one session, before and after a frame that began anew because its orientation was not known | as in two sessions |
//! | not known, because they were read from bytes | as before, or if their anchors agree in the world |
//!
//! Schemes without anchors are not checked: no session protects them.

use std::fmt;
use std::str::FromStr;

use veiloc_geometry::nalgebra::{Rotation3, Vector3};

use crate::{CanonicalCamera, RigMessage, Scheme, SealedFrame};

/// With which other queries a query was sealed, as far as this device knows. It stays on the device: no message has it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SealedIn {
    /// It was read from bytes.
    #[default]
    Unknown,
    /// With none.
    Alone,
    /// With those of this session, or of a part of it.
    Session(SessionTag),
}

/// Names a session on its device, so that its frames are recognized there; as text 16 hexadecimal digits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SessionTag(pub [u8; 8]);

impl fmt::Display for SessionTag {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", u64::from_be_bytes(self.0))
    }
}

/// Text that is no [`SessionTag`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a session has 16 hexadecimal digits")]
pub struct SessionTagError;

impl FromStr for SessionTag {
    type Err = SessionTagError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let is_hex = text.len() == 16 && text.bytes().all(|b| b.is_ascii_hexdigit());
        let number = is_hex.then(|| u64::from_str_radix(text, 16).ok()).flatten();
        number.map(|number| Self(number.to_be_bytes())).ok_or(SessionTagError)
    }
}

/// Two frames of a rig that were not sealed in one session: lines of a keypoint that both show cross in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "frames {first} and {second} of the rig were not sealed in one session: the lines of a keypoint that both show cross in \
     it; seal all images of a rig in one session"
)]
pub struct SeparateAnchors {
    /// Index of a frame.
    pub first: usize,
    /// Index of a later one.
    pub second: usize,
}

/// Deviations of a rotation that count as possible.
const POSSIBLE_SDS: f64 = 5.0;
/// Keypoints may be missing at the borders of a canonical camera, whose sides are rounded up: on each side at least half a
/// block less.
const MARGIN: f64 = 0.5 * CanonicalCamera::BLOCK as f64;
const ROUNDING: f64 = 1e-9;

impl RigMessage {
    /// The largest angle between the anchors of two frames of one session, degrees, beside the deviations of their poses:
    /// the session corrects the measured orientation of each by up to half of it.
    pub const ANCHOR_TOLERANCE_DEG: f64 = 3.0;

    /// Whether frames that can show one keypoint were sealed in one session, as far as this device can tell. Check this
    /// before sending.
    ///
    /// # Errors
    /// [`SeparateAnchors`] with the first two frames that were not.
    pub fn check_anchors(&self) -> Result<(), SeparateAnchors> {
        for (second, b) in self.frames.iter().enumerate() {
            if let Some(first) = self.frames[..second].iter().position(|a| !may_be_sent_together(a, b)) {
                return Err(SeparateAnchors { first, second });
            }
        }
        Ok(())
    }
}

fn may_be_sent_together(a: &SealedFrame, b: &SealedFrame) -> bool {
    let has_anchors = |frame: &SealedFrame| matches!(frame.query.scheme(), Scheme::Dcl(_));
    if !has_anchors(a) && !has_anchors(b) {
        return true;
    }
    let is_shared = match (a.query.sealed_in(), b.query.sealed_in()) {
        (SealedIn::Session(a), SealedIn::Session(b)) => a == b,
        (SealedIn::Alone, _) | (_, SealedIn::Alone) => false,
        (SealedIn::Unknown, _) | (_, SealedIn::Unknown) => anchors_agree(a, b),
    };
    is_shared || views_are_apart(a, b)
}

/// Whether the anchors of two frames are the same directions in the world.
fn anchors_agree(a: &SealedFrame, b: &SealedFrame) -> bool {
    if a.query.scheme() != b.query.scheme() || a.query.canonical_camera() != b.query.canonical_camera() {
        return false;
    }
    let by_anchors = b.query.turn().cam_from_layout() * a.query.turn().cam_from_layout().inverse();
    let off = by_anchors.angle_to(&rotation_between(a, b)).to_degrees();
    off <= RigMessage::ANCHOR_TOLERANCE_DEG + POSSIBLE_SDS * a.rotation_sd_deg.hypot(b.rotation_sd_deg)
}

/// Camera of `a` to camera of `b`.
fn rotation_between(a: &SealedFrame, b: &SealedFrame) -> Rotation3<f64> {
    b.cam_from_rig.rotation() * a.cam_from_rig.rotation().inverse()
}

/// Whether no keypoint is in both: exact poses with one centre, and a border of one view that has the other view behind it,
/// as of the images of a panorama.
fn views_are_apart(a: &SealedFrame, b: &SealedFrame) -> bool {
    let b_from_a = rotation_between(a, b);
    let between = b.cam_from_rig.translation() - b_from_a * a.cam_from_rig.translation();
    let is_exact = [a, b].iter().all(|f| f.rotation_sd_deg == 0.0 && f.translation_sd == 0.0);
    is_exact
        && between.norm() <= ROUNDING
        && (is_behind_a_border(a, b, &b_from_a.inverse()) || is_behind_a_border(b, a, &b_from_a))
}

/// Whether a border of the view of `own` has all of the view of `other` behind it.
fn is_behind_a_border(own: &SealedFrame, other: &SealedFrame, own_from_other: &Rotation3<f64>) -> bool {
    let half_sides = |frame: &SealedFrame| {
        let camera = frame.query.camera();
        [camera.width, camera.height].map(|side| (0.5 * f64::from(side) - MARGIN) / camera.mean_focal())
    };
    let ([x, y], [u, v]) = (half_sides(own), half_sides(other));
    let borders = [[1.0, 0.0, x], [-1.0, 0.0, x], [0.0, 1.0, y], [0.0, -1.0, y]].map(Vector3::from);
    let corners = [[u, v], [-u, v], [u, -v], [-u, -v]].map(|[u, v]| own_from_other * Vector3::new(u, v, 1.0));
    borders.iter().any(|inward| corners.iter().all(|corner| inward.dot(corner) <= ROUNDING))
}
