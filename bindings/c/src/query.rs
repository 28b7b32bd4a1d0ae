//! Sealing, and the bytes to send.

use std::ffi::c_char;

use rand_chacha::ChaCha20Rng;
use veiloc_ar::{SealedCameraFrame, rig_message, seal_to_send};
use veiloc_obfuscation::{DeviceLimits, SealOptions, device_rng};
use veiloc_protocol::{AngleBits, Profile, Scheme, SizeClass};

use crate::bytes::VeilocBytes;
use crate::camera::{VeilocCamera, VeilocFrame, camera};
use crate::cancellation::VeilocCancellation;
use crate::pointers;
use crate::pose::{VeilocPose, axes};
use crate::profile::VeilocProfile;
use crate::session::VeilocSession;
use crate::status::{Failure, VeilocStatus, guarded};

/// How a frame is sealed: the device's choice. All zeros are the defaults.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct VeilocOptions {
    /// `dcl` (also for null), its layouts, `random-lines` or `coordinate-permutation`.
    pub scheme: *const c_char,
    /// Most rows to send; 0 for what the profile asks, at most 2048.
    pub max_keypoints: u32,
    /// Longest side to which frames are scaled down, pixels; 0 for what the profile asks, at most 2048.
    pub max_image_side: u32,
    /// Bits of an angle; 0 for 12.
    pub angle_bits: u32,
    /// The direction of gravity is sent, rounded to about a degree, where the pose of the camera is known, unless this is
    /// true. Set it for a world whose vertical is not gravity, unlike those of ARKit and ARCore.
    pub without_gravity: bool,
    /// A request that another thread may make to stop the call; null for none.
    pub cancellation: *const VeilocCancellation,
}

/// A sealed query.
pub struct VeilocQuery {
    sealed: SealedCameraFrame,
    profile: Profile,
}

/// What is known about a sealed query.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct VeilocQueryInfo {
    /// Rows of the query.
    pub rows: u32,
    /// Keypoints that were found in the frame.
    pub keypoints: u32,
    /// Mean gray of the frame, 0 to 1.
    pub brightness: f64,
    /// How many of `steps` are used.
    pub step_count: u32,
    /// Rows of each step of progressive localization that can determine a pose, ascending.
    pub steps: [u32; 8],
}

/// Where the randomness comes from.
enum Randomness {
    Device,
    #[cfg_attr(not(feature = "seeded"), expect(dead_code, reason = "tests only"))]
    Seed([u8; 32]),
}

/// Seals a frame.
///
/// - `session`: null for a frame of its own. Frames of one place belong to one session.
/// - `camera`: null for a guessed focal length.
/// - `options`: null for the defaults.
/// - `camera_in_world`: the pose of the camera when it took the frame, in `pose_axes` (a `VeilocAxes`); null when it
///   is not known. It stays on the device, except for gravity (`VeilocOptions`).
///
/// Fails with `Unbalanced` when the query could not determine a pose; the session has not changed then, and another
/// frame costs nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_seal(
    profile: *const VeilocProfile,
    session: *mut VeilocSession,
    frame: *const VeilocFrame,
    camera: *const VeilocCamera,
    options: *const VeilocOptions,
    pose_axes: u32,
    camera_in_world: *const VeilocPose,
    out: *mut *mut VeilocQuery,
) -> VeilocStatus {
    let arguments = Arguments { profile, session, frame, camera, options, pose_axes, camera_in_world };
    // SAFETY: the contract of the crate.
    guarded(|| unsafe { arguments.seal(Randomness::Device, out) })
}

/// As `veiloc_seal`, with 32 bytes of randomness: for tests that compare queries. A query whose seed is known hides
/// nothing.
#[cfg(feature = "seeded")]
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_seal_seeded(
    profile: *const VeilocProfile,
    session: *mut VeilocSession,
    frame: *const VeilocFrame,
    camera: *const VeilocCamera,
    options: *const VeilocOptions,
    pose_axes: u32,
    camera_in_world: *const VeilocPose,
    seed: *const u8,
    out: *mut *mut VeilocQuery,
) -> VeilocStatus {
    let arguments = Arguments { profile, session, frame, camera, options, pose_axes, camera_in_world };
    guarded(|| {
        // SAFETY: the contract of the crate; `seed` points to 32 bytes.
        let seed = unsafe { pointers::slice(seed, 32, "seed") }?;
        let seed = seed.try_into().map_err(|_| Failure::new(VeilocStatus::Argument, "the seed"))?;
        // SAFETY: as above.
        unsafe { arguments.seal(Randomness::Seed(seed), out) }
    })
}

struct Arguments {
    profile: *const VeilocProfile,
    session: *mut VeilocSession,
    frame: *const VeilocFrame,
    camera: *const VeilocCamera,
    options: *const VeilocOptions,
    pose_axes: u32,
    camera_in_world: *const VeilocPose,
}

impl Arguments {
    /// # Safety
    /// The contract of the crate for all pointers.
    unsafe fn seal(&self, randomness: Randomness, out: *mut *mut VeilocQuery) -> Result<(), Failure> {
        // SAFETY: the caller guarantees it; the same for the others.
        let profile = &unsafe { pointers::reference(self.profile, "profile") }?.profile;
        // SAFETY: as above.
        let given = unsafe { pointers::reference(self.frame, "frame") }?;
        // SAFETY: as above.
        let frame = unsafe { given.frame() }?;
        // SAFETY: as above.
        let camera = unsafe { camera(self.camera, given) }?;
        // SAFETY: as above.
        let pose = unsafe { pointers::optional(self.camera_in_world) };
        let pose = pose.map(|pose| pose.cam_from_ar(axes(self.pose_axes)?)).transpose()?;
        // SAFETY: as above.
        let options = unsafe { options(self.options) }?;
        let mut rng = match randomness {
            Randomness::Device => device_rng()?,
            Randomness::Seed(seed) => rand_chacha::rand_core::SeedableRng::from_seed(seed),
        };
        let rng: &mut ChaCha20Rng = &mut rng;
        // SAFETY: as above.
        let session = unsafe { pointers::optional_mutable(self.session) }.map(|own| &mut own.session);
        let sealed = seal_to_send(session, &frame, &camera, profile, &options, pose.as_ref(), rng)?;
        // SAFETY: as above.
        unsafe { pointers::give_handle(out, VeilocQuery { sealed, profile: profile.clone() }) }
    }
}

/// # Safety
/// `given` is null or valid, and so are its scheme and its cancellation.
pub(crate) unsafe fn options(given: *const VeilocOptions) -> Result<SealOptions, Failure> {
    // SAFETY: the caller guarantees it.
    let Some(given) = (unsafe { pointers::optional(given) }) else { return Ok(SealOptions::default()) };
    let argument = |e: &dyn std::fmt::Display| Failure::new(VeilocStatus::Argument, e);
    // SAFETY: as above.
    let mut options = match unsafe { pointers::text(given.scheme, "options.scheme") }? {
        Some(scheme) => SealOptions::new(scheme.parse::<Scheme>().map_err(|e| argument(&e))?)?,
        None => SealOptions::default(),
    };
    if given.angle_bits != 0 {
        let bits = u8::try_from(given.angle_bits).unwrap_or(u8::MAX);
        options = options.with_angle_bits(AngleBits::new(bits).map_err(|e| argument(&e))?);
    }
    if given.max_keypoints != 0 {
        options = options.with_max_keypoints(given.max_keypoints as usize);
    }
    if given.max_image_side != 0 {
        let limits = DeviceLimits { max_image_side: given.max_image_side, ..DeviceLimits::default() };
        options = options.with_limits(limits);
    }
    if given.without_gravity {
        options = options.without_gravity();
    }
    // SAFETY: as above.
    if let Some(cancellation) = unsafe { pointers::optional(given.cancellation) } {
        options = options.with_stop(&cancellation.stop);
    }
    Ok(options)
}

/// What is known about a query; zeros for null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_query_info(query: *const VeilocQuery) -> VeilocQueryInfo {
    let mut info = VeilocQueryInfo::default();
    // SAFETY: the contract of the crate.
    if let Some(VeilocQuery { sealed, profile }) = unsafe { pointers::optional(query) } {
        info.rows = sealed.query.len() as u32;
        info.keypoints = sealed.keypoints as u32;
        info.brightness = sealed.brightness;
        for (step, class) in info.steps.iter_mut().zip(sealed.query.useful_steps(profile)) {
            *step = class.rows() as u32;
            info.step_count += 1;
        }
    }
    info
}

/// The bytes of a query, for `POST /v1/maps/{map}/localize`: all that leaves the device. `rows`: 0 for all rows, or a
/// step of `VeilocQueryInfo`. After a network error, send the same bytes again.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_query_bytes(
    query: *const VeilocQuery,
    rows: u32,
    out: *mut VeilocBytes,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let VeilocQuery { sealed, profile } = unsafe { pointers::reference(query, "query") }?;
        let bytes = if rows == 0 {
            sealed.query.encode()
        } else {
            let argument = |e: &dyn std::fmt::Display| Failure::new(VeilocStatus::Argument, e);
            let class = SizeClass::from_rows(rows as usize)
                .ok_or_else(|| argument(&format!("{rows} rows are not a step of the query")))?;
            sealed.query.first_rows(class, profile).map_err(|e| argument(&e))?.encode()
        };
        if out.is_null() {
            return Err(Failure::new(VeilocStatus::Argument, "out is null"));
        }
        // SAFETY: as above.
        unsafe { pointers::give(out, bytes.into(), "out") }
    })
}

/// Frees a query.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_query_free(query: *mut VeilocQuery) {
    // SAFETY: the contract of the crate.
    unsafe { pointers::free(query) }
}

/// Several queries of one device and their poses, for `POST /v1/maps/{map}/localize-rig`: localized together. The answer
/// is the pose of the first camera.
///
/// `queries` and `cameras_in_world` hold `count` (1 to 32) pointers and poses. Only poses relative to the first are
/// sent. `rotation_sd_deg` and `translation_sd` (metres): how exact the AR framework's poses are.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_rig_bytes(
    queries: *const *const VeilocQuery,
    pose_axes: u32,
    cameras_in_world: *const VeilocPose,
    count: usize,
    metres_per_unit: f64,
    rotation_sd_deg: f64,
    translation_sd: f64,
    out: *mut VeilocBytes,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let queries = unsafe { pointers::slice(queries, count, "queries") }?;
        // SAFETY: as above.
        let poses = unsafe { pointers::slice(cameras_in_world, count, "cameras_in_world") }?;
        let axes = axes(pose_axes)?;
        let cameras: Vec<_> = poses.iter().map(|pose| pose.cam_from_ar(axes)).collect::<Result<_, _>>()?;
        let mut sealed = Vec::new();
        for query in queries {
            // SAFETY: as above.
            sealed.push(unsafe { pointers::reference(*query, "a query") }?.sealed.query.clone());
        }
        let message = rig_message(sealed, &cameras, metres_per_unit, rotation_sd_deg, translation_sd)
            .map_err(|error| Failure::new(VeilocStatus::Argument, error))?;
        // SAFETY: as above.
        unsafe { pointers::give(out, message.encode().into(), "out") }
    })
}
