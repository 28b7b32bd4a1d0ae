//! The pose of the AR framework beside a query: its orientation for a session, and rigs of several queries.

use veiloc_geometry::CameraFromRig;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_obfuscation::{Orientation, SealError};
use veiloc_protocol::{RigMessage, SealedFrame, SealedQuery, SeparateAnchors};

use crate::CameraFromAr;
use crate::unit::check_unit;

/// The orientation of the camera when it took a frame, with the gravity direction: the AR world's `y` is up. It stays on
/// the device, except for the direction of gravity, rounded to about a degree
/// ([`Extracted::with_orientation`](veiloc_obfuscation::Extracted::with_orientation)).
///
/// # Errors
/// [`SealError::NoOrientation`] when a number is not finite.
pub fn orientation_in_world(cam_from_ar: &CameraFromAr) -> Result<Orientation, SealError> {
    let down = cam_from_ar.rotation() * -Vector3::y();
    let orientation = Orientation::in_world(*cam_from_ar.rotation());
    orientation.and_then(|known| known.with_down(down.into())).ok_or(SealError::NoOrientation)
}

/// Why queries give no message of a rig.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RigError {
    /// There are none, too many, or not as many poses.
    #[error("1 to {max} queries are needed, and a pose for each", max = RigMessage::MAX_FRAMES)]
    Count,
    /// A number is not possible.
    #[error("metres_per_unit must be above 0, and deviations 0 or more")]
    Number,
    /// Two were not sealed in one session: their lines would give keypoints away (rule L10).
    #[error(transparent)]
    SeparateAnchors(#[from] SeparateAnchors),
}

/// The message of several queries with the poses of their cameras: relative to the first, so that nothing of the AR world
/// is sent.
///
/// `metres_per_unit`: of the map. The deviations are those of the tracking between two frames: degrees, and metres.
///
/// # Errors
/// [`RigError`].
pub fn rig_message(
    queries: Vec<SealedQuery>,
    cameras: &[CameraFromAr],
    metres_per_unit: f64,
    rotation_sd_deg: f64,
    translation_sd: f64,
) -> Result<RigMessage, RigError> {
    if !(1..=RigMessage::MAX_FRAMES).contains(&queries.len()) || queries.len() != cameras.len() {
        return Err(RigError::Count);
    }
    check_numbers(metres_per_unit, rotation_sd_deg, translation_sd)?;
    let on_rig = rig_of(cameras, metres_per_unit);
    let frames = queries.into_iter().zip(on_rig).enumerate().map(|(index, (query, cam_from_rig))| {
        // The first camera is the rig itself.
        let sds = [rotation_sd_deg, translation_sd / metres_per_unit];
        let [rotation_sd_deg, translation_sd] = if index == 0 { [0.0; 2] } else { sds };
        SealedFrame { query, cam_from_rig, rotation_sd_deg, translation_sd }
    });
    let message = RigMessage { frames: frames.collect() };
    message.check_anchors()?;
    Ok(message)
}

/// Whether these are possible for [`rig_message`].
pub(crate) fn check_numbers(
    metres_per_unit: f64,
    rotation_sd_deg: f64,
    translation_sd: f64,
) -> Result<(), RigError> {
    let is_sd = |sd: f64| sd.is_finite() && sd >= 0.0;
    if check_unit(metres_per_unit).is_ok() && is_sd(rotation_sd_deg) && is_sd(translation_sd) {
        Ok(())
    } else {
        Err(RigError::Number)
    }
}

/// The poses of several cameras on one rig: relative to the first. `metres_per_unit`: of the map.
pub fn rig_of(cameras: &[CameraFromAr], metres_per_unit: f64) -> Vec<CameraFromRig> {
    let Some(ar_from_rig) = cameras.first().map(CameraFromAr::inverse) else { return Vec::new() };
    let on_rig = |cam_from_ar: &CameraFromAr| {
        let cam_from_rig = cam_from_ar.compose(&ar_from_rig);
        CameraFromRig::new(*cam_from_rig.rotation(), cam_from_rig.translation() / metres_per_unit)
    };
    cameras.iter().map(on_rig).collect()
}
