//! Sealing, and the bytes to send.

use std::sync::Arc;

use rand_chacha::ChaCha20Rng;
use veiloc_ar::{SealedCameraFrame, rig_message, seal_to_send};
use veiloc_geometry::Stop;
use veiloc_obfuscation::{DeviceLimits, device_rng};
use veiloc_protocol::{AngleBits, Scheme, SizeClass};

use crate::camera::{Camera, FrameLayout, known_camera};
use crate::cancellation::Cancellation;
use crate::error::VeilocException;
use crate::pose::CameraPose;
use crate::profile::Profile;
use crate::session::Session;

/// How a frame is sealed: the device's choice.
#[derive(Debug, Clone, PartialEq, Eq, uniffi::Record)]
pub struct SealOptions {
    /// `dcl` (the default), its layouts, `random-lines` or `coordinate-permutation`.
    #[uniffi(default = None)]
    pub scheme: Option<String>,
    /// Most rows to send. Default: what the profile asks, at most 2048.
    #[uniffi(default = None)]
    pub max_keypoints: Option<u32>,
    /// Longest side to which frames are scaled down, pixels. Default: what the profile asks, at most 2048.
    #[uniffi(default = None)]
    pub max_image_side: Option<u32>,
    /// Bits of an angle. Default 12.
    #[uniffi(default = None)]
    pub angle_bits: Option<u8>,
    /// Whether the direction of gravity is sent, rounded to about a degree, where the pose of the camera is known. Not for
    /// a world whose vertical is not gravity, unlike those of ARKit and ARCore.
    #[uniffi(default = true)]
    pub send_gravity: bool,
}

impl Default for SealOptions {
    fn default() -> Self {
        let (scheme, max_keypoints, max_image_side, angle_bits) = (None, None, None, None);
        Self { scheme, max_keypoints, max_image_side, angle_bits, send_gravity: true }
    }
}

/// A sealed query.
#[derive(uniffi::Object)]
pub struct Query {
    pub(crate) sealed: SealedCameraFrame,
    pub(crate) profile: Arc<Profile>,
}

/// Seals a frame.
///
/// - `bytes`: of the frame; in Kotlin a direct `ByteBuffer` that begins with the frame.
/// - `camera`: without one, a guessed focal length.
/// - `session`: without one, a frame of its own. Frames of one place belong to one session.
/// - `camera_in_world`: the pose of the camera when it took the frame. It stays on the device, except for gravity
///   (`SealOptions`).
/// - `cancellation`: a request that another thread may make to stop the call.
///
/// # Errors
/// [`VeilocException`]; the session has not changed then, and another frame costs nothing.
#[uniffi::export(default(
    camera = None,
    session = None,
    options = None,
    camera_in_world = None,
    cancellation = None
))]
#[expect(clippy::too_many_arguments, reason = "named in Kotlin and Swift, and all but three have defaults")]
pub fn seal(
    profile: Arc<Profile>,
    bytes: &[u8],
    layout: FrameLayout,
    camera: Option<Camera>,
    session: Option<Arc<Session>>,
    options: Option<SealOptions>,
    camera_in_world: Option<CameraPose>,
    cancellation: Option<Arc<Cancellation>>,
) -> Result<Arc<Query>, VeilocException> {
    let mut rng = device_rng()?;
    let stop = cancellation.map(|cancellation| cancellation.stop.clone()).unwrap_or_default();
    seal_with(profile, bytes, layout, camera, session, options, camera_in_world, &stop, &mut rng)
}

/// As `seal`, with 32 bytes of randomness: for tests that compare queries. A query whose seed is known hides nothing.
///
/// # Errors
/// As `seal`.
#[cfg(feature = "seeded")]
#[uniffi::export]
pub fn seal_seeded(
    profile: Arc<Profile>,
    bytes: &[u8],
    layout: FrameLayout,
    camera: Option<Camera>,
    seed: Vec<u8>,
) -> Result<Arc<Query>, VeilocException> {
    let seed = seed.try_into().map_err(|_| VeilocException::argument("a seed has 32 bytes"))?;
    let mut rng = rand_chacha::rand_core::SeedableRng::from_seed(seed);
    seal_with(profile, bytes, layout, camera, None, None, None, &Stop::default(), &mut rng)
}

#[expect(clippy::too_many_arguments, reason = "those of `seal`")]
fn seal_with(
    profile: Arc<Profile>,
    bytes: &[u8],
    layout: FrameLayout,
    camera: Option<Camera>,
    session: Option<Arc<Session>>,
    options: Option<SealOptions>,
    camera_in_world: Option<CameraPose>,
    stop: &Stop,
    rng: &mut ChaCha20Rng,
) -> Result<Arc<Query>, VeilocException> {
    let frame = layout.frame(bytes)?;
    let camera = known_camera(camera, layout)?;
    let pose = camera_in_world.map(CameraPose::cam_from_ar).transpose()?;
    let options = options.unwrap_or_default().lowered()?.with_stop(stop);
    let mut stored = session.as_ref().map(|session| session.locked());
    let sealed =
        seal_to_send(stored.as_deref_mut(), &frame, &camera, &profile.profile, &options, pose.as_ref(), rng)?;
    Ok(Arc::new(Query { sealed, profile }))
}

impl SealOptions {
    pub(crate) fn lowered(&self) -> Result<veiloc_obfuscation::SealOptions, VeilocException> {
        let mut options = match &self.scheme {
            Some(scheme) => veiloc_obfuscation::SealOptions::new(
                scheme.parse::<Scheme>().map_err(VeilocException::argument)?,
            )?,
            None => veiloc_obfuscation::SealOptions::default(),
        };
        if let Some(bits) = self.angle_bits {
            options = options.with_angle_bits(AngleBits::new(bits).map_err(VeilocException::argument)?);
        }
        if let Some(most) = self.max_keypoints {
            options = options.with_max_keypoints(most as usize);
        }
        if let Some(most) = self.max_image_side {
            options = options.with_limits(DeviceLimits { max_image_side: most, ..DeviceLimits::default() });
        }
        if !self.send_gravity {
            options = options.without_gravity();
        }
        Ok(options)
    }
}

#[uniffi::export]
impl Query {
    /// The bytes for `POST /v1/maps/{map}/localize`: all that leaves the device. `rows`: all rows, or one of `steps`.
    /// After a network error, send the same bytes again.
    ///
    /// # Errors
    /// [`VeilocException::Argument`] for a number of rows that is not a step.
    #[uniffi::method(default(rows = None))]
    pub fn bytes(&self, rows: Option<u32>) -> Result<Vec<u8>, VeilocException> {
        let query = &self.sealed.query;
        let Some(rows) = rows else { return Ok(query.encode()) };
        let class = SizeClass::from_rows(rows as usize)
            .ok_or_else(|| VeilocException::argument(format!("{rows} rows are not a step of the query")))?;
        let part = query.first_rows(class, &self.profile.profile);
        Ok(part.map_err(VeilocException::argument)?.encode())
    }

    /// Rows of the query.
    pub fn rows(&self) -> u32 {
        self.sealed.query.len() as u32
    }

    /// Rows of each step of progressive localization that can determine a pose, ascending.
    pub fn steps(&self) -> Vec<u32> {
        let steps = self.sealed.query.useful_steps(&self.profile.profile);
        steps.map(|class| class.rows() as u32).collect()
    }

    /// Keypoints that were found in the frame.
    pub fn keypoints(&self) -> u32 {
        self.sealed.keypoints as u32
    }

    /// Mean gray of the frame, 0 to 1.
    pub fn brightness(&self) -> f64 {
        self.sealed.brightness
    }
}

/// Several queries of one device and the poses of their cameras, for `POST /v1/maps/{map}/localize-rig`: localized
/// together. The answer is the pose of the first camera. Only poses relative to it are sent.
///
/// `rotation_sd_deg` and `translation_sd` (metres): how exact the AR framework's poses are.
///
/// # Errors
/// [`VeilocException::Argument`] for no or more than 32 queries, another number of poses, or invalid numbers.
#[uniffi::export]
pub fn rig_bytes(
    queries: Vec<Arc<Query>>,
    cameras_in_world: Vec<CameraPose>,
    metres_per_unit: f64,
    rotation_sd_deg: f64,
    translation_sd: f64,
) -> Result<Vec<u8>, VeilocException> {
    let cameras: Vec<_> =
        cameras_in_world.into_iter().map(CameraPose::cam_from_ar).collect::<Result<_, _>>()?;
    let queries = queries.iter().map(|query| query.sealed.query.clone()).collect();
    let message = rig_message(queries, &cameras, metres_per_unit, rotation_sd_deg, translation_sd);
    message.map(|message| message.encode()).map_err(VeilocException::argument)
}
