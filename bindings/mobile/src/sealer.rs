//! Sealers: from a frame to its features, and from those to a query.

use std::sync::{Arc, Mutex, PoisonError};

use rand_chacha::ChaCha20Rng;
use veiloc_ar::orientation_in_world;
use veiloc_features::Image;
use veiloc_obfuscation::{DeviceLimits, SealError, device_rng};
use veiloc_protocol::{AngleBits, Scheme};

use crate::camera::{Camera, FrameLayout, Mask, known_camera};
use crate::cancellation::{Cancellation, stop_of};
use crate::error::VeilocException;
use crate::pack::{Pack, PackUse};
use crate::pose::CameraPose;
use crate::profile::Profile;
use crate::query::Query;
use crate::session::Session;

/// How frames are sealed: the device's choice.
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
    /// The pack of the map: nothing is sent that the place does not know. Default: all descriptors are sent.
    #[uniffi(default = None)]
    pub pack: Option<Arc<Pack>>,
    /// What is sent with a pack. Default: matches.
    #[uniffi(default = None)]
    pub send: Option<PackUse>,
}

impl Default for SealOptions {
    fn default() -> Self {
        let (scheme, max_keypoints, max_image_side, angle_bits) = (None, None, None, None);
        let (pack, send) = (None, None);
        Self { scheme, max_keypoints, max_image_side, angle_bits, send_gravity: true, pack, send }
    }
}

/// Seals frames for one map.
#[derive(uniffi::Object)]
pub struct Sealer {
    pub(crate) sealer: veiloc_obfuscation::Sealer,
}

/// A `Sealer` for frames of one session.
#[derive(uniffi::Object)]
pub struct SessionSealer {
    sealer: Arc<Sealer>,
    session: Arc<Session>,
}

/// The features of a frame, until they are sealed. They hold positions of keypoints, and are never sent.
#[derive(uniffi::Object)]
pub struct Extracted {
    /// `None` once they were sealed.
    features: Mutex<Option<veiloc_obfuscation::Extracted>>,
    keypoints: u32,
    brightness: f64,
}

#[uniffi::export]
impl Sealer {
    /// Checks what the profile asks for.
    ///
    /// # Errors
    /// [`VeilocException`].
    #[uniffi::constructor(default(options = None))]
    pub fn new(profile: Arc<Profile>, options: Option<SealOptions>) -> Result<Arc<Self>, VeilocException> {
        let options = options.unwrap_or_default().lowered()?;
        Ok(Arc::new(Self { sealer: veiloc_obfuscation::Sealer::new(&profile.profile, options)? }))
    }

    /// Extracts the features of a frame.
    ///
    /// - `bytes`: of the frame; in Kotlin a direct `ByteBuffer` that begins with the frame.
    /// - `camera`: without one, a guessed focal length.
    /// - `camera_in_world`: the pose of the camera when it took the frame. It stays on the device, except for gravity
    ///   (`SealOptions`).
    /// - `cancellation`: a request that another thread may make to stop the call.
    /// - `mask`: people and what else must not be sent.
    ///
    /// # Errors
    /// [`VeilocException`].
    #[uniffi::method(default(camera = None, camera_in_world = None, cancellation = None, mask = None))]
    pub fn extract(
        &self,
        bytes: &[u8],
        layout: FrameLayout,
        camera: Option<Camera>,
        camera_in_world: Option<CameraPose>,
        cancellation: Option<Arc<Cancellation>>,
        mask: Option<Mask>,
    ) -> Result<Arc<Extracted>, VeilocException> {
        let hidden = Mask::hidden(mask, layout)?;
        let frame = layout.frame(bytes)?.hiding(hidden.as_ref()).map_err(SealError::from)?;
        let image = Image::from(&frame).with_stop(&stop_of(cancellation));
        let camera = known_camera(camera, layout)?;
        let pose = camera_in_world.map(CameraPose::cam_from_ar).transpose()?;
        let orientation = pose.as_ref().map(orientation_in_world).transpose()?.unwrap_or_default();
        let brightness = image.gray().mean();
        let extracted = self.sealer.extract(image, camera)?.with_orientation(orientation);
        let keypoints = extracted.features().keypoints.len() as u32;
        Ok(Arc::new(Extracted { features: Mutex::new(Some(extracted)), keypoints, brightness }))
    }

    /// Seals the features of a frame on its own, once: they are used up then, also when it fails. Frames of one place
    /// belong to one session (`inSession`).
    ///
    /// # Errors
    /// [`VeilocException`]; another frame costs nothing then.
    pub fn seal(self: Arc<Self>, extracted: Arc<Extracted>) -> Result<Arc<Query>, VeilocException> {
        seal_with(self, &extracted, None, &mut device_rng()?)
    }

    /// For the frames of a session.
    pub fn in_session(self: Arc<Self>, session: Arc<Session>) -> Arc<SessionSealer> {
        Arc::new(SessionSealer { sealer: self, session })
    }
}

#[cfg(feature = "seeded")]
#[uniffi::export]
impl Sealer {
    /// As `seal`, with 32 bytes of randomness: for tests that compare queries. A query whose seed is known hides nothing.
    ///
    /// # Errors
    /// As `seal`.
    pub fn seal_seeded(
        self: Arc<Self>,
        extracted: Arc<Extracted>,
        seed: Vec<u8>,
    ) -> Result<Arc<Query>, VeilocException> {
        let seed = seed.try_into().map_err(|_| VeilocException::argument("a seed has 32 bytes"))?;
        seal_with(self, &extracted, None, &mut rand_chacha::rand_core::SeedableRng::from_seed(seed))
    }
}

#[uniffi::export]
impl SessionSealer {
    /// Seals the features of the next frame, as `Sealer.seal`.
    ///
    /// # Errors
    /// [`VeilocException`]; the session has not changed then, and another frame costs nothing.
    pub fn seal(&self, extracted: Arc<Extracted>) -> Result<Arc<Query>, VeilocException> {
        seal_with(Arc::clone(&self.sealer), &extracted, Some(&self.session), &mut device_rng()?)
    }
}

#[uniffi::export]
impl Extracted {
    /// Number of keypoints.
    pub fn keypoints(&self) -> u32 {
        self.keypoints
    }

    /// Mean gray of the frame, 0 to 1.
    pub fn brightness(&self) -> f64 {
        self.brightness
    }
}

fn seal_with(
    sealer: Arc<Sealer>,
    features: &Extracted,
    session: Option<&Session>,
    rng: &mut ChaCha20Rng,
) -> Result<Arc<Query>, VeilocException> {
    let extracted = features.features.lock().unwrap_or_else(PoisonError::into_inner).take();
    let used_up = || VeilocException::argument("the frame was sealed already; send its query again");
    let extracted = extracted.ok_or_else(used_up)?;
    let sealed = match session {
        Some(session) => sealer.sealer.in_session(&mut session.locked()).seal(extracted, rng)?,
        None => sealer.sealer.seal(extracted, rng)?,
    };
    let (keypoints, brightness) = (features.keypoints, features.brightness);
    Ok(Arc::new(Query { sealed, sealer, keypoints, brightness }))
}

impl SealOptions {
    /// Queries that could not determine a pose are refused.
    fn lowered(&self) -> Result<veiloc_obfuscation::SealOptions, VeilocException> {
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
        options = match (&self.pack, self.send) {
            (Some(pack), send) => options.with_place(pack.place.clone(), send.unwrap_or_default()),
            (None, Some(_)) => {
                return Err(VeilocException::argument(
                    "send says what is sent with a pack, but there is none",
                ));
            }
            (None, None) => options,
        };
        Ok(options.only_balanced())
    }
}
