//! Bursts: a few frames of the last second, sealed in one session and localized together.
//!
//! An AR app has thirty frames a second, and the AR framework knows exactly how the camera moved between them. Together
//! they give a pose where one frame shows too little. A [`Burst`] keeps the sharpest frame of each part of the last
//! second, and seals them as a rig: the newest one is the rig, and the poses of the others are relative to it.
//!
//! ```text
//! time      |---------- window, 1 s ----------|
//! parts     |    0     |    1     |    2     |     frames = 3
//! kept      |  x       |        x |   x      |     the sharpest of each part
//!                                   the rig
//! ```
//!
//! Parts follow each other from the first frame that is offered. The newest frame begins a part or belongs to the
//! newest one, so that one always has a frame. A part without any frame stays empty.
//!
//! # What is sent
//! The sealed queries, the poses relative to the rig, and the direction of gravity, rounded and once. Pixels stay in
//! memory until the frames are sealed or replaced, and are never sent. All frames are sealed in the session of the
//! place, so that the planes of one keypoint do not meet in it (rule L10). A burst gives each frame once (rule L7):
//! after a network error, send the bytes of the message again.
//!
//! # Memory
//! At most [`BurstOptions::frames`] times the width times the height of a frame, in bytes: 6 MB for three frames of
//! 1920 × 1080 pixels. A frame that is offered is copied only when it is kept.
//!
//! # The unit of the map
//! The poses of the AR framework are in metres, those of a map in its own unit, and
//! [`BurstOptions::metres_per_unit`] converts them. With a wrong unit the frames of a camera that moves contradict each
//! other, and are worth no more than one. Until the unit is known, from the options or from an answer
//! ([`Burst::learn_unit`]), only the newest frame that can be sealed is: its message has no distance. [`Alignment::distance_ratio`](crate::Alignment::distance_ratio) shows whether the unit is
//! right, and `veiloc map align` gives a map metres.

use std::collections::VecDeque;

use rand::CryptoRng;
use veiloc_features::{CameraFrame, Image, Mask, PixelFormat};
use veiloc_geometry::{QuarterTurns, Stop};
use veiloc_obfuscation::{KnownCamera, SealError, SealErrorKind, Sealer, Session};
use veiloc_protocol::{Answer, RigMessage, SealedQuery};

use crate::rig::check_numbers;
use crate::{CameraFromAr, RigError, orientation_in_world, rig_message};

/// Which frames a burst keeps, and how exact their poses are.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct BurstOptions {
    /// Most frames that are sealed together, 1 to [`Self::MAX_FRAMES`]. Default 3. Each costs the service as much as one
    /// query.
    pub frames: usize,
    /// How far back the frames reach, seconds. Default 1.
    pub window: f64,
    /// Standard deviation of the rotation between one kept frame and the next, about each axis, degrees. Default 0.1: of
    /// the tracking of ARKit and ARCore over a second.
    pub rotation_sd_deg: f64,
    /// The same of the position, along each axis, metres. Default 0.01.
    pub translation_sd: f64,
    /// Metres of a unit of the map, as `GET /v1/maps` and every answer state it ([`Burst::learn_unit`]). Default: not
    /// known; until it is, one frame is sealed at a time.
    pub metres_per_unit: Option<f64>,
}

impl Default for BurstOptions {
    fn default() -> Self {
        Self { frames: 3, window: 1.0, rotation_sd_deg: 0.1, translation_sd: 0.01, metres_per_unit: None }
    }
}

impl BurstOptions {
    /// Largest number of frames.
    pub const MAX_FRAMES: usize = 5;

    /// These options with another number of frames.
    #[must_use]
    pub const fn with_frames(mut self, frames: usize) -> Self {
        self.frames = frames;
        self
    }

    /// These options with another window, seconds.
    #[must_use]
    pub const fn with_window(mut self, seconds: f64) -> Self {
        self.window = seconds;
        self
    }

    /// These options with other standard deviations from one kept frame to the next: degrees and metres.
    #[must_use]
    pub const fn with_sds(mut self, rotation_sd_deg: f64, translation_sd: f64) -> Self {
        (self.rotation_sd_deg, self.translation_sd) = (rotation_sd_deg, translation_sd);
        self
    }

    /// These options for a map with this unit.
    #[must_use]
    pub const fn with_metres_per_unit(mut self, metres: f64) -> Self {
        self.metres_per_unit = Some(metres);
        self
    }
}

/// Why a frame was not taken, or no frame could be sealed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BurstError {
    /// The number of frames or the window is not possible.
    #[error(
        "{frames} frames in {window} s: a burst has 1 to {max} frames, and a window above 0",
        max = BurstOptions::MAX_FRAMES
    )]
    Window {
        /// The number that was asked for.
        frames: usize,
        /// Seconds.
        window: f64,
    },
    /// The unit of the map or a standard deviation is not possible.
    #[error(transparent)]
    Rig(#[from] RigError),
    /// A timestamp is not finite.
    #[error("the timestamp of the frame is not finite; give the frame's own time, in seconds")]
    Timestamp,
    /// A pose is not finite.
    #[error(
        "the pose of the frame is not finite; offer frames only while the AR framework tracks the camera"
    )]
    Pose,
    /// No frame was offered since the last seal.
    #[error("there is no frame to seal; offer frames of the camera first")]
    Empty,
    /// No frame of the burst can be sealed; this is the error of the newest.
    #[error(transparent)]
    Frame(#[from] SealError),
}

/// The sharpest frames of the last second.
///
/// ```
/// use veiloc_ar::{Alignment, Axes, Burst, BurstError, CameraFrame, FrameworkPose};
/// use veiloc_geometry::Stop;
/// use veiloc_obfuscation::{KnownCamera, Sealer, Session, device_rng};
/// use veiloc_protocol::Answer;
///
/// /// For every frame, on the camera's thread. Pose and time are those of the frame.
/// fn on_frame(
///     burst: &mut Burst,
///     frame: &CameraFrame<'_>,
///     camera: &KnownCamera,
///     pose: &FrameworkPose,
///     seconds: f64,
/// ) -> Result<(), BurstError> {
///     let Some(cam_from_ar) = Axes::OpenGl.cam_from_ar(pose) else { return Err(BurstError::Pose) };
///     burst.offer(frame, camera, &cam_from_ar, seconds).map(|_| ())
/// }
///
/// /// On another thread, with what [`Burst::take`] returned. `post`: to `/v1/maps/{map}/localize-rig`.
/// fn localize(
///     mut taken: Burst,
///     sealer: &Sealer,
///     session: &mut Session,
///     alignment: &mut Alignment,
///     post: impl Fn(Vec<u8>) -> Vec<u8>,
/// ) -> Result<(), Box<dyn std::error::Error>> {
///     let sealed = taken.seal(sealer, session, &Stop::default(), &mut device_rng()?)?;
///     let answer = Answer::decode(&post(sealed.message.encode()))?;
///     alignment.add(&answer, &sealed.cam_from_ar);
///     Ok(())
/// }
/// ```
#[derive(Debug, Clone)]
pub struct Burst {
    options: BurstOptions,
    /// Of different parts, oldest first; at most [`BurstOptions::frames`].
    kept: VecDeque<Kept>,
    /// When the first part begins.
    start: f64,
    /// Time of the last frame that was offered.
    last: Option<f64>,
}

/// A frame that is kept.
#[derive(Clone)]
struct Kept {
    /// Number of its part.
    part: f64,
    sharpness: f64,
    /// Gray bytes before the turn, `[height, width]`.
    pixels: Vec<u8>,
    size: (u32, u32),
    turns: QuarterTurns,
    hidden: Option<Mask>,
    camera: KnownCamera,
    cam_from_ar: CameraFromAr,
}

// Image content and poses must never reach a log (rule L8).
impl std::fmt::Debug for Kept {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (width, height) = self.size;
        write!(f, "Kept({width}x{height})")
    }
}

/// A burst that may be sent.
#[derive(Debug)]
pub struct SealedBurst {
    /// To send, encoded, as the body of `POST /v1/maps/{map}/localize-rig`. The newest frame is the first.
    pub message: RigMessage,
    /// The pose of the rig: that of the camera when it took the newest frame of the message. With the answer, for
    /// [`Alignment::add`](crate::Alignment::add).
    pub cam_from_ar: CameraFromAr,
    /// Frames that could not be sealed, and are not in the message.
    pub left_out: usize,
    /// Number of keypoints found in the newest frame of the message, for [`Situation`](crate::Situation).
    pub keypoints: usize,
    /// Mean gray of that frame, 0 to 1.
    pub brightness: f64,
}

impl Burst {
    /// Without frames.
    ///
    /// # Errors
    /// [`BurstError::Window`], [`BurstError::Rig`]: options that are not possible.
    pub fn new(options: BurstOptions) -> Result<Self, BurstError> {
        let BurstOptions { frames, window, rotation_sd_deg, translation_sd, metres_per_unit } = options;
        if !((1..=BurstOptions::MAX_FRAMES).contains(&frames) && window.is_finite() && window > 0.0) {
            return Err(BurstError::Window { frames, window });
        }
        check_numbers(metres_per_unit.unwrap_or(1.0), rotation_sd_deg, translation_sd)?;
        Ok(Self { options, kept: VecDeque::new(), start: 0.0, last: None })
    }

    /// Takes the unit of the map from an answer, unless the options have one.
    pub fn learn_unit(&mut self, answer: &Answer) {
        self.options.metres_per_unit = self.options.metres_per_unit.or(answer.map.metres_per_unit);
    }

    /// Takes a frame, if it is the sharpest of its part so far; its pixels are copied then. Returns whether it did.
    ///
    /// - `camera`: of the frame as the sensor gives it, before [`CameraFrame::turned`].
    /// - `cam_from_ar`: the pose of the camera when it took the frame.
    /// - `timestamp`: seconds of any clock that does not jump, in which the camera took the frame.
    ///
    /// A frame with the time of the last one is the same frame, and is not taken. After a gap longer than the window,
    /// and when time goes back (another clock, and so another AR session), the frames before are dropped.
    ///
    /// # Errors
    /// [`BurstError::Timestamp`], [`BurstError::Pose`]: a number that is not finite. Nothing changes then.
    pub fn offer(
        &mut self,
        frame: &CameraFrame<'_>,
        camera: &KnownCamera,
        cam_from_ar: &CameraFromAr,
        timestamp: f64,
    ) -> Result<bool, BurstError> {
        if !timestamp.is_finite() {
            return Err(BurstError::Timestamp);
        }
        let numbers = cam_from_ar.rotation().matrix().iter().chain(cam_from_ar.translation().iter());
        if !numbers.copied().all(f64::is_finite) {
            return Err(BurstError::Pose);
        }
        if self.last == Some(timestamp) {
            return Ok(false);
        }
        let goes_on = self.last.is_some_and(|last| (0.0..=self.options.window).contains(&(timestamp - last)));
        if !goes_on {
            self.clear();
        }
        self.last = Some(timestamp);
        if self.kept.is_empty() {
            self.start = timestamp;
        }
        let parts = self.options.frames as f64;
        let part = ((timestamp - self.start) / self.options.window * parts).floor();
        while self.kept.front().is_some_and(|oldest| oldest.part <= part - parts) {
            self.kept.pop_front();
        }
        let sharpness = frame.sharpness();
        if let Some(newest) = self.kept.back().filter(|newest| newest.part == part) {
            if sharpness <= newest.sharpness {
                return Ok(false);
            }
            self.kept.pop_back();
        }
        let (size, turns, pixels) = (frame.size(), frame.turns(), frame.gray_bytes());
        let hidden = frame.hidden().cloned();
        let (camera, cam_from_ar) = (*camera, *cam_from_ar);
        self.kept.push_back(Kept { part, sharpness, pixels, size, turns, hidden, camera, cam_from_ar });
        Ok(true)
    }

    /// Frames that are kept: those that [`Self::seal`] seals.
    pub fn len(&self) -> usize {
        self.kept.len()
    }

    /// Whether no frame is kept.
    pub fn is_empty(&self) -> bool {
        self.kept.is_empty()
    }

    /// Drops the frames: for a new AR session, or when the framework says that it lost its world, because poses of two
    /// worlds cannot be combined.
    pub fn clear(&mut self) {
        self.kept.clear();
    }

    /// A burst with the frames, to be sealed on another thread; this one goes on without them.
    #[must_use]
    pub fn take(&mut self) -> Self {
        let kept = std::mem::take(&mut self.kept);
        Self { options: self.options, kept, start: self.start, last: self.last }
    }

    /// Seals the frames in the session of their place, and forgets them: no frame is sealed twice (rule L7).
    ///
    /// A frame that cannot be sealed, or whose query could not determine a pose, is left out. Gravity is sent with the
    /// newest frame only: those of the others follow from it. On a network error, send the bytes of the message again.
    ///
    /// - `stop`: stops the call from another thread.
    ///
    /// # Errors
    /// [`BurstError::Frame`] when no frame can be sealed, and when the call was stopped; [`BurstError::Empty`]. The
    /// session has not changed then; the frames are gone.
    pub fn seal(
        &mut self,
        sealer: &Sealer,
        session: &mut Session,
        stop: &Stop,
        rng: &mut impl CryptoRng,
    ) -> Result<SealedBurst, BurstError> {
        let BurstOptions { rotation_sd_deg, translation_sd, metres_per_unit, .. } = self.options;
        let kept = std::mem::take(&mut self.kept);
        let mut next = session.clone();
        let newest_options = sealer.options().clone().only_balanced();
        let others = Sealer::new(sealer.profile(), newest_options.clone().without_gravity())?;
        let newest = Sealer::new(sealer.profile(), newest_options)?;
        let mut sealed: Vec<(Sealed, CameraFromAr)> = Vec::new();
        let (mut first_error, mut left_out) = (None, 0);
        for frame in kept.iter().rev() {
            // Several would tell the tilt more finely than it is rounded.
            let sealer = if sealed.is_empty() { &newest } else { &others };
            match frame.seal(sealer, &mut next, stop, rng) {
                Ok(query) => sealed.push((query, frame.cam_from_ar)),
                Err(error) if error.kind() == SealErrorKind::Stopped => return Err(error.into()),
                Err(error) => {
                    left_out += 1;
                    first_error = first_error.or(Some(error));
                }
            }
            // The distance between frames has no meaning yet.
            if metres_per_unit.is_none() && !sealed.is_empty() {
                break;
            }
        }
        let Some((newest, cam_from_ar)) = sealed.first() else {
            return Err(first_error.map_or(BurstError::Empty, BurstError::Frame));
        };
        let (keypoints, brightness, cam_from_ar) = (newest.keypoints, newest.brightness, *cam_from_ar);
        let (queries, cameras): (Vec<_>, Vec<_>) =
            sealed.into_iter().map(|(frame, camera)| (frame.query, camera)).unzip();
        let metres = metres_per_unit.unwrap_or(1.0);
        let mut message = rig_message(queries, &cameras, metres, rotation_sd_deg, translation_sd)?;
        // Errors of steps add up.
        for (steps, frame) in message.frames.iter_mut().enumerate() {
            let factor = (steps as f64).sqrt();
            frame.rotation_sd_deg *= factor;
            frame.translation_sd *= factor;
        }
        *session = next;
        Ok(SealedBurst { message, cam_from_ar, left_out, keypoints, brightness })
    }
}

/// A frame that was sealed.
struct Sealed {
    query: SealedQuery,
    keypoints: usize,
    brightness: f64,
}

impl Kept {
    fn seal(
        &self,
        sealer: &Sealer,
        session: &mut Session,
        stop: &Stop,
        rng: &mut impl CryptoRng,
    ) -> Result<Sealed, SealError> {
        let frame = CameraFrame::new(PixelFormat::Gray, self.size, &self.pixels, 0)?;
        let frame = frame.hiding(self.hidden.as_ref())?.turned(self.turns);
        let image = Image::from(&frame).with_stop(stop);
        let brightness = image.gray().mean();
        let orientation = orientation_in_world(&self.cam_from_ar)?;
        let extracted = sealer.extract(image, self.camera)?.with_orientation(orientation);
        let keypoints = extracted.features().keypoints.len();
        let query = sealer.in_session(session).seal(extracted, rng)?;
        Ok(Sealed { query, keypoints, brightness })
    }
}
