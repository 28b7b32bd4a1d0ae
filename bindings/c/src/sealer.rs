//! Sealers: from a frame to its features, and from those to a query.

use std::ffi::c_char;
use std::sync::Arc;

use rand_chacha::ChaCha20Rng;
use veiloc_ar::orientation_in_world;
use veiloc_features::Image;
use veiloc_obfuscation::{DeviceLimits, Extracted, PackUse, SealError, SealOptions, Sealer, device_rng};
use veiloc_protocol::{AngleBits, Scheme};

use crate::camera::{VeilocCamera, VeilocFrame, camera};
use crate::cancellation::VeilocCancellation;
use crate::pack::{VeilocPack, pack_use};
use crate::pointers;
use crate::pose::{VeilocPose, axes};
use crate::profile::VeilocProfile;
use crate::query::VeilocQuery;
use crate::session::VeilocSession;
use crate::status::{Failure, VeilocStatus, guarded};

/// How frames are sealed: the device's choice. All zeros are the defaults.
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
    /// The pack of the map: nothing is sent that the place does not know. Null: all descriptors are sent. It may be freed
    /// when the sealer is made.
    pub pack: *const VeilocPack,
    /// What is sent with a pack: a `VeilocPackUse`.
    pub send: u32,
}

/// Seals frames for one map. Unlike other handles, several threads may use it at once.
pub struct VeilocSealer {
    pub(crate) sealer: Arc<Sealer>,
}

/// The features of a frame, until they are sealed. They hold positions of keypoints, and are never sent.
pub struct VeilocExtracted {
    /// `None` once they were sealed.
    extracted: Option<Extracted>,
    keypoints: usize,
    brightness: f64,
}

/// Makes a sealer: checks what the profile asks for. `options`: null for the defaults.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_sealer_new(
    profile: *const VeilocProfile,
    sealer_options: *const VeilocOptions,
    out: *mut *mut VeilocSealer,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate; the same for the others.
        let profile = &unsafe { pointers::reference(profile, "profile") }?.profile;
        // SAFETY: as above.
        let sealer = Arc::new(Sealer::new(profile, unsafe { options(sealer_options) }?)?);
        // SAFETY: as above.
        unsafe { pointers::give_handle(out, VeilocSealer { sealer }) }
    })
}

/// Extracts the features of a frame.
///
/// - `camera_of_frame`: null for a guessed focal length.
/// - `camera_in_world`: the pose of the camera when it took the frame, in `pose_axes` (a `VeilocAxes`); null when it
///   is not known. It stays on the device, except for gravity (`VeilocOptions`).
/// - `cancellation`: a request that another thread may make to stop the call; null for none.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_sealer_extract(
    sealer: *const VeilocSealer,
    frame: *const VeilocFrame,
    camera_of_frame: *const VeilocCamera,
    pose_axes: u32,
    camera_in_world: *const VeilocPose,
    cancellation: *const VeilocCancellation,
    out: *mut *mut VeilocExtracted,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate; the same for the others.
        let sealer = &unsafe { pointers::reference(sealer, "sealer") }?.sealer;
        // SAFETY: as above.
        let given = unsafe { pointers::reference(frame, "frame") }?;
        // SAFETY: as above.
        let hidden = unsafe { given.hidden() }?;
        // SAFETY: as above.
        let frame = unsafe { given.frame() }?.hiding(hidden.as_ref()).map_err(SealError::from)?;
        let mut image = Image::from(&frame);
        // SAFETY: as above.
        let known = unsafe { camera(camera_of_frame, given) }?;
        // SAFETY: as above.
        let pose = unsafe { pointers::optional(camera_in_world) };
        let pose = pose.map(|pose| pose.cam_from_ar(axes(pose_axes)?)).transpose()?;
        let orientation = pose.as_ref().map(orientation_in_world).transpose()?.unwrap_or_default();
        // SAFETY: as above.
        if let Some(cancellation) = unsafe { pointers::optional(cancellation) } {
            image = image.with_stop(&cancellation.stop);
        }
        let brightness = image.gray().mean();
        let extracted = sealer.extract(image, known)?.with_orientation(orientation);
        let keypoints = extracted.features().keypoints.len();
        // SAFETY: as above.
        unsafe {
            pointers::give_handle(out, VeilocExtracted { extracted: Some(extracted), keypoints, brightness })
        }
    })
}

/// Seals the features of a frame, once: they are used up then, also when it fails. The handle is still to be freed.
///
/// `session`: null for a frame of its own. Frames of one place belong to one session.
///
/// Fails with `Unbalanced` when the query could not determine a pose, and with `NotThisPlace` when the frame does not show
/// the place of the pack. The session has not changed after any error, so another frame costs nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_sealer_seal(
    sealer: *const VeilocSealer,
    session: *mut VeilocSession,
    extracted: *mut VeilocExtracted,
    out: *mut *mut VeilocQuery,
) -> VeilocStatus {
    // SAFETY: the contract of the crate.
    guarded(|| unsafe { seal(sealer, session, extracted, device_rng()?, out) })
}

/// As `veiloc_sealer_seal`, with 32 bytes of randomness: for tests that compare queries. A query whose seed is known
/// hides nothing.
#[cfg(feature = "seeded")]
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_sealer_seal_seeded(
    sealer: *const VeilocSealer,
    session: *mut VeilocSession,
    extracted: *mut VeilocExtracted,
    seed: *const u8,
    out: *mut *mut VeilocQuery,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate; `seed` points to 32 bytes.
        let seed = unsafe { pointers::slice(seed, 32, "seed") }?;
        let seed = seed.try_into().map_err(|_| Failure::new(VeilocStatus::Argument, "the seed"))?;
        let rng = rand_chacha::rand_core::SeedableRng::from_seed(seed);
        // SAFETY: as above.
        unsafe { seal(sealer, session, extracted, rng, out) }
    })
}

/// # Safety
/// The contract of the crate for all pointers.
unsafe fn seal(
    sealer: *const VeilocSealer,
    session: *mut VeilocSession,
    extracted: *mut VeilocExtracted,
    mut rng: ChaCha20Rng,
    out: *mut *mut VeilocQuery,
) -> Result<(), Failure> {
    // SAFETY: the caller guarantees it; the same for the others.
    let sealer = &unsafe { pointers::reference(sealer, "sealer") }?.sealer;
    // SAFETY: as above.
    let session = unsafe { pointers::optional_mutable(session) }.map(|own| &mut own.session);
    // SAFETY: as above.
    let features = unsafe { pointers::mutable(extracted, "extracted") }?;
    if out.is_null() {
        return Err(Failure::new(VeilocStatus::Argument, "out is null"));
    }
    let used_up =
        || Failure::new(VeilocStatus::Argument, "the frame was sealed already; send its query again");
    let extracted = features.extracted.take().ok_or_else(used_up)?;
    let query = match session {
        Some(session) => sealer.in_session(session).seal(extracted, &mut rng)?,
        None => sealer.seal(extracted, &mut rng)?,
    };
    let (keypoints, brightness) = (features.keypoints, features.brightness);
    // SAFETY: as above.
    unsafe {
        pointers::give_handle(out, VeilocQuery { query, sealer: Arc::clone(sealer), keypoints, brightness })
    }
}

/// # Safety
/// `given` is null or valid, and so are its scheme and pack. Queries that could not determine a pose are refused.
unsafe fn options(given: *const VeilocOptions) -> Result<SealOptions, Failure> {
    // SAFETY: the caller guarantees it.
    let Some(given) = (unsafe { pointers::optional(given) }) else {
        return Ok(SealOptions::default().only_balanced());
    };
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
    let send = pack_use(given.send)?;
    // SAFETY: as above.
    options = match unsafe { pointers::optional(given.pack) } {
        Some(pack) => options.with_place(pack.place.clone(), send),
        None if send == PackUse::default() => options,
        None => {
            return Err(argument(&"options.send says what is sent with a pack, but options.pack is null"));
        }
    };
    Ok(options.only_balanced())
}

/// Frees a sealer. Queries that it sealed stay usable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_sealer_free(sealer: *mut VeilocSealer) {
    // SAFETY: the contract of the crate.
    unsafe { pointers::free(sealer) }
}

/// Frees the features of a frame.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_extracted_free(extracted: *mut VeilocExtracted) {
    // SAFETY: the contract of the crate.
    unsafe { pointers::free(extracted) }
}
