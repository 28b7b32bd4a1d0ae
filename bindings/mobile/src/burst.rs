//! Bursts: a few frames of the last second, localized together.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use veiloc_obfuscation::{SealError, device_rng};

use crate::answer::Answer;
use crate::camera::{Camera, FrameLayout, Mask, known_camera};
use crate::cancellation::{Cancellation, stop_of};
use crate::error::VeilocException;
use crate::pose::{Axes, CameraPose};
use crate::query::Query;
use crate::sealer::Sealer;
use crate::session::Session;

/// Which frames a burst keeps, and how exact their poses are.
#[derive(Debug, Clone, Copy, PartialEq, uniffi::Record)]
pub struct BurstOptions {
    /// Most frames that are sealed together, 1 to 5. Each costs the service as much as one query.
    #[uniffi(default = 3)]
    pub frames: u32,
    /// How far back the frames reach, seconds.
    #[uniffi(default = 1.0)]
    pub window: f64,
    /// Standard deviation of the rotation between one kept frame and the next, degrees: of the tracking of ARKit and
    /// ARCore over a second.
    #[uniffi(default = 0.1)]
    pub rotation_sd_deg: f64,
    /// The same of the position, metres.
    #[uniffi(default = 0.01)]
    pub translation_sd: f64,
    /// Metres of a unit of the map, as `GET /v1/maps` and every answer state it. None: until `learn_unit` learns it, one
    /// frame is sealed at a time.
    #[uniffi(default = None)]
    pub metres_per_unit: Option<f64>,
}

/// The sharpest frames of the last second. One thread may offer frames while another seals.
///
/// It copies the gray bytes of the frames that it keeps: at most `frames` times width times height.
#[derive(uniffi::Object)]
pub struct Burst {
    burst: Mutex<veiloc_ar::Burst>,
}

/// A burst that was sealed.
#[derive(uniffi::Object)]
pub struct SealedBurst {
    sealed: veiloc_ar::SealedBurst,
    sealer: Arc<Sealer>,
}

impl Burst {
    fn locked(&self) -> MutexGuard<'_, veiloc_ar::Burst> {
        // A poisoned lock is safe: a frame is added as the last step.
        self.burst.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[uniffi::export]
impl Burst {
    /// Begins without frames.
    ///
    /// # Errors
    /// [`VeilocException::Argument`] for options that are not possible.
    #[uniffi::constructor(default(options = None))]
    pub fn new(options: Option<BurstOptions>) -> Result<Arc<Self>, VeilocException> {
        let mut own = veiloc_ar::BurstOptions::default();
        if let Some(given) = options {
            own = own
                .with_frames(given.frames as usize)
                .with_window(given.window)
                .with_sds(given.rotation_sd_deg, given.translation_sd);
            if let Some(metres) = given.metres_per_unit {
                own = own.with_metres_per_unit(metres);
            }
        }
        Ok(Arc::new(Self { burst: Mutex::new(veiloc_ar::Burst::new(own)?) }))
    }

    /// Takes the unit of the map from an answer, unless the options gave one. Call it with every answer.
    pub fn learn_unit(&self, answer: &Answer) {
        self.locked().learn_unit(&answer.answer);
    }

    /// Takes a frame of the camera if it is the sharpest of its part of the window so far, and returns whether it did.
    /// Offer every frame while the AR framework tracks the camera.
    ///
    /// - `bytes`, `layout`, `camera`: as for `Sealer.extract`.
    /// - `camera_in_world`: the pose of the camera when it took the frame.
    /// - `timestamp`: seconds of any clock that does not jump, when the camera took the frame.
    /// - `mask`: as for `Sealer.extract`.
    ///
    /// # Errors
    /// [`VeilocException`]; nothing has changed then.
    #[uniffi::method(default(mask = None))]
    pub fn offer(
        &self,
        bytes: &[u8],
        layout: FrameLayout,
        camera: Option<Camera>,
        camera_in_world: CameraPose,
        timestamp: f64,
        mask: Option<Mask>,
    ) -> Result<bool, VeilocException> {
        let hidden = Mask::hidden(mask, layout)?;
        let frame = layout.frame(bytes)?.hiding(hidden.as_ref()).map_err(SealError::from)?;
        let camera = known_camera(camera, layout)?;
        let pose = camera_in_world.cam_from_ar()?;
        Ok(self.locked().offer(&frame, &camera, &pose, timestamp)?)
    }

    /// Frames that `seal` would seal.
    pub fn frames(&self) -> u32 {
        self.locked().len() as u32
    }

    /// Drops the frames: for a new AR session, or when the framework says that it lost its world.
    pub fn clear(&self) {
        self.locked().clear();
    }

    /// Seals the frames in the session of their place, and forgets them. A frame that cannot be sealed is left out.
    ///
    /// # Errors
    /// [`VeilocException`] when no frame can be sealed; the session has not changed then, and the frames are gone.
    #[uniffi::method(default(cancellation = None))]
    pub fn seal(
        &self,
        sealer: Arc<Sealer>,
        session: Arc<Session>,
        cancellation: Option<Arc<Cancellation>>,
    ) -> Result<Arc<SealedBurst>, VeilocException> {
        // The camera goes on while this thread seals.
        let mut taken = self.locked().take();
        let mut rng = device_rng()?;
        let sealed = taken.seal(&sealer.sealer, &mut session.locked(), &stop_of(cancellation), &mut rng)?;
        Ok(Arc::new(SealedBurst { sealed, sealer }))
    }
}

#[uniffi::export]
impl SealedBurst {
    /// The bytes for `POST /v1/maps/{map}/localize-rig`: all that leaves the device. After a network error, send them
    /// again.
    pub fn bytes(&self) -> Vec<u8> {
        self.sealed.message.encode()
    }

    /// The pose of the camera when it took the newest frame of the burst: with the answer, for `Alignment.add`.
    pub fn camera_in_world(&self, axes: Axes) -> CameraPose {
        let pose = veiloc_ar::Axes::from(axes).camera_pose(&self.sealed.cam_from_ar);
        CameraPose { axes, pose: pose.into() }
    }

    /// Frames that were sealed.
    pub fn frames(&self) -> u32 {
        self.sealed.message.frames.len() as u32
    }

    /// Frames that could not be sealed.
    pub fn left_out(&self) -> u32 {
        self.sealed.left_out as u32
    }

    /// The newest frame that was sealed, for `advice`.
    pub fn newest(&self) -> Option<Arc<Query>> {
        let veiloc_ar::SealedBurst { message, keypoints, brightness, .. } = &self.sealed;
        let query = message.frames.first()?.query.clone();
        let (keypoints, brightness) = (*keypoints as u32, *brightness);
        Some(Arc::new(Query { sealed: query, sealer: Arc::clone(&self.sealer), keypoints, brightness }))
    }
}
