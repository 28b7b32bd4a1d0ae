//! From a frame of the camera to a sealed query.

use std::path::Path;

use rand::CryptoRng;
use veiloc_features::{CameraFrame, FeatureError, Features, Image};
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{CameraFromRig, Intrinsics};
use veiloc_obfuscation::{KnownCamera, Orientation, SealError, SealOptions, Session, extract_loaded, seal};
use veiloc_protocol::{Profile, RigMessage, SealedFrame, SealedQuery, UnbalancedAnchors};

use crate::CameraFromAr;

/// Name of the frame in messages, as it has no file.
const NAME: &str = "the frame";

/// A frame of the camera, sealed.
#[derive(Debug)]
pub struct SealedCameraFrame {
    /// The query to send.
    pub query: SealedQuery,
    /// Number of keypoints found in the frame; the query may hold fewer, or decoys.
    pub keypoints: usize,
    /// Mean gray of the frame, 0 to 1.
    pub brightness: f64,
}

/// Seals a frame for the map of a profile.
///
/// - `camera`: of the frame as the sensor gives it, before [`CameraFrame::turned`].
/// - `rng`: [`veiloc_obfuscation::device_rng`] on a device.
///
/// Seal a frame once and keep the query until it is answered (rule L7). For several frames of one place use
/// [`seal_frame_in`] (rule L10). With a pose of the camera, give its gravity: [`SealOptions::with_gravity_of`] and
/// [`orientation_in_world`].
///
/// # Errors
/// [`SealError`]: the camera of another image size, too little texture, a profile that requests more than the device
/// allows.
pub fn seal_frame(
    frame: &CameraFrame<'_>,
    camera: &KnownCamera,
    profile: &Profile,
    options: &SealOptions,
    rng: &mut impl CryptoRng,
) -> Result<SealedCameraFrame, SealError> {
    let extracted = Extracted::new(frame, camera, profile, options)?;
    extracted.sealed(|features, camera, options| seal(features, camera, profile, options, rng))
}

/// Seals the next frame of a session: as [`seal_frame`], with the session's anchors.
///
/// `cam_from_ar`: the pose of the camera when it took the frame. It stays on the device, except for the direction of
/// gravity, rounded to about a degree, which [`SealOptions::without_gravity`] keeps there too. Without a pose, the frame
/// belongs to the session only where the camera rested or turned on the spot.
///
/// # Errors
/// As [`seal_frame`] and [`Session::seal`]; the session has not changed then.
pub fn seal_frame_in(
    session: &mut Session,
    frame: &CameraFrame<'_>,
    camera: &KnownCamera,
    profile: &Profile,
    options: &SealOptions,
    cam_from_ar: Option<&CameraFromAr>,
    rng: &mut impl CryptoRng,
) -> Result<SealedCameraFrame, SealError> {
    let held = held_by(cam_from_ar)?;
    let extracted = Extracted::new(frame, camera, profile, options)?;
    extracted.sealed(|features, camera, options| session.seal(features, camera, profile, options, &held, rng))
}

/// Why a frame gave no query that may be sent.
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    /// It could not be sealed.
    #[error(transparent)]
    Seal(#[from] SealError),
    /// Its query could not determine a pose.
    #[error(transparent)]
    Unbalanced(#[from] UnbalancedAnchors),
}

/// Seals a frame, in a session if there is one, and returns only a query that can determine a pose. After an error the
/// session has not changed and nothing was sent, so another frame costs nothing. `cam_from_ar`: as for [`seal_frame_in`].
///
/// # Errors
/// [`FrameError`].
pub fn seal_to_send(
    session: Option<&mut Session>,
    frame: &CameraFrame<'_>,
    camera: &KnownCamera,
    profile: &Profile,
    options: &SealOptions,
    cam_from_ar: Option<&CameraFromAr>,
    rng: &mut impl CryptoRng,
) -> Result<SealedCameraFrame, FrameError> {
    let Some(session) = session else {
        let options = options.clone().with_gravity_of(&held_by(cam_from_ar)?);
        let sealed = seal_frame(frame, camera, profile, &options, rng)?;
        sealed.query.check_sides()?;
        return Ok(sealed);
    };
    let mut next = session.clone();
    let sealed = seal_frame_in(&mut next, frame, camera, profile, options, cam_from_ar, rng)?;
    sealed.query.check_sides()?;
    *session = next;
    Ok(sealed)
}

/// The orientation of a camera for a session, with the gravity direction: the AR world's `y` is up. `None` when a
/// number is not finite.
pub fn orientation_in_world(cam_from_ar: &CameraFromAr) -> Option<Orientation> {
    let down = cam_from_ar.rotation() * -Vector3::y();
    Orientation::in_world(*cam_from_ar.rotation())?.with_down(down.into())
}

fn held_by(cam_from_ar: Option<&CameraFromAr>) -> Result<Orientation, SealError> {
    match cam_from_ar {
        Some(pose) => orientation_in_world(pose).ok_or(SealError::NoOrientation),
        None => Ok(Orientation::unknown()),
    }
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
    Ok(RigMessage { frames: frames.collect() })
}

/// Whether these are possible for [`rig_message`].
pub(crate) fn check_numbers(
    metres_per_unit: f64,
    rotation_sd_deg: f64,
    translation_sd: f64,
) -> Result<(), RigError> {
    let is_sd = |sd: f64| sd.is_finite() && sd >= 0.0;
    let is_unit = metres_per_unit.is_finite() && metres_per_unit > 0.0;
    if is_unit && is_sd(rotation_sd_deg) && is_sd(translation_sd) { Ok(()) } else { Err(RigError::Number) }
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

/// The features of a frame, before they are sealed.
struct Extracted {
    features: Features,
    camera: Intrinsics,
    options: SealOptions,
    brightness: f64,
}

impl Extracted {
    fn new(
        frame: &CameraFrame<'_>,
        camera: &KnownCamera,
        profile: &Profile,
        options: &SealOptions,
    ) -> Result<Self, SealError> {
        let (intrinsics, actual) = (&camera.intrinsics, frame.size());
        let size = (intrinsics.width, intrinsics.height);
        if size != actual {
            let path = Path::new(NAME).to_owned();
            return Err(FeatureError::ImageSize { path, actual, camera: size, turn: None }.into());
        }
        let gray = frame.gray();
        let brightness = gray.mean();
        let options = options.clone().with_focal(camera.focal);
        let turned = intrinsics.turned(frame.turns());
        let (features, camera) =
            extract_loaded(Image::from(gray), Path::new(NAME), &turned, profile, &options)?;
        Ok(Self { features, camera, options, brightness })
    }

    fn sealed(
        self,
        seal: impl FnOnce(Features, &Intrinsics, &SealOptions) -> Result<SealedQuery, SealError>,
    ) -> Result<SealedCameraFrame, SealError> {
        let Self { features, camera, options, brightness } = self;
        let keypoints = features.keypoints.len();
        let query = seal(features, &camera, &options)?;
        Ok(SealedCameraFrame { query, keypoints, brightness })
    }
}
