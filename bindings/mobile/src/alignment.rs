//! The transform from the map to the AR world.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use veiloc_ar::AlignmentOptions;

use crate::answer::Answer;
use crate::error::VeilocException;
use crate::pose::{Accuracy, Axes, CameraPose, Pose, no_pose};

/// Answers of one AR session, and the transform that most of them agree on.
#[derive(uniffi::Object)]
pub struct Alignment {
    alignment: Mutex<veiloc_ar::Alignment>,
}

/// How far the transform is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, uniffi::Enum)]
pub enum AlignmentState {
    /// No trusted answer came yet.
    Searching,
    /// One answer: content may be shown, and may move.
    Tentative,
    /// At least two answers agree.
    Aligned,
}

/// What an answer did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, uniffi::Enum)]
pub enum Update {
    /// It is part of the transform.
    Used,
    /// It is trusted but contradicts the transform, which did not move.
    Contradicts,
    /// It is doubtful and agrees. Nothing changed.
    DoubtfulAgrees,
    /// It is doubtful and contradicts, or there is no transform. Nothing changed.
    Doubtful,
    /// It has no pose, or one with a free direction. Nothing changed.
    NoPose,
    /// It does not state the unit of the map, and none was given. Nothing changed.
    UnknownUnit,
}

/// What distances between answers say, compared with the AR framework's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, uniffi::Enum)]
pub enum Distances {
    /// Too few answers, or too near to each other.
    Unknown,
    /// They agree within 5 %.
    Agree,
    /// They differ: check the unit of the map and the focal length.
    Differ,
}

/// The numbers of an alignment.
#[derive(Debug, Clone, Copy, PartialEq, uniffi::Record)]
pub struct AlignmentInfo {
    /// How far the transform is known.
    pub state: AlignmentState,
    /// Answers that it is the average of.
    pub used: u32,
    /// Trusted answers that contradict it.
    pub contradicting: u32,
    /// What distances between answers say.
    pub distances: Distances,
    /// Distances in the map divided by those of the AR framework, once there are any.
    pub distance_ratio: Option<f64>,
}

/// Where the camera is in the map.
#[derive(Debug, Clone, Copy, PartialEq, uniffi::Record)]
pub struct CameraInMap {
    /// Position in map units, and the rotation from the camera's axes (COLMAP's) to the map's.
    pub pose: Pose,
    /// How exact it is.
    pub accuracy: Accuracy,
}

impl Alignment {
    pub(crate) fn locked(&self) -> MutexGuard<'_, veiloc_ar::Alignment> {
        self.alignment.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[uniffi::export]
impl Alignment {
    /// Begins an alignment. `metres_per_unit`: of the map; none for the unit that the answers state.
    ///
    /// # Errors
    /// [`VeilocException::Argument`] when it is not above 0.
    #[uniffi::constructor(default(metres_per_unit = None))]
    pub fn new(metres_per_unit: Option<f64>) -> Result<Arc<Self>, VeilocException> {
        let mut options = AlignmentOptions::default();
        if let Some(metres) = metres_per_unit {
            let metres = veiloc_ar::check_unit(metres).map_err(VeilocException::argument)?;
            options = options.with_metres_per_unit(metres);
        }
        Ok(Arc::new(Self { alignment: Mutex::new(veiloc_ar::Alignment::new(options)) }))
    }

    /// Takes an answer and the pose of the camera **when it took the frame that was sealed**, not its pose now.
    ///
    /// # Errors
    /// [`VeilocException::Argument`] for a pose that is no rotation.
    pub fn add(&self, answer: Arc<Answer>, camera_in_world: CameraPose) -> Result<Update, VeilocException> {
        let camera = camera_in_world.cam_from_ar()?;
        Ok(match self.locked().add(&answer.answer, &camera) {
            veiloc_ar::Update::Used => Update::Used,
            veiloc_ar::Update::Contradicts => Update::Contradicts,
            veiloc_ar::Update::DoubtfulAgrees => Update::DoubtfulAgrees,
            veiloc_ar::Update::Doubtful => Update::Doubtful,
            veiloc_ar::Update::NoPose => Update::NoPose,
            veiloc_ar::Update::UnknownUnit => Update::UnknownUnit,
        })
    }

    /// Takes the pose of the camera between answers, once or twice a second: the length of its path tells how far the
    /// AR framework may have drifted.
    ///
    /// # Errors
    /// [`VeilocException::Argument`] for a pose that is no rotation.
    pub fn moved(&self, camera_in_world: CameraPose) -> Result<(), VeilocException> {
        self.locked().moved(&camera_in_world.cam_from_ar()?);
        Ok(())
    }

    /// Forgets all answers: for a new AR session, or when the framework says that it lost its world.
    pub fn reset(&self) {
        self.locked().reset();
    }

    /// The numbers of the alignment.
    pub fn info(&self) -> AlignmentInfo {
        let alignment = self.locked();
        let (aligned, ratio) = (alignment.aligned(), alignment.distance_ratio());
        AlignmentInfo {
            state: match alignment.state() {
                veiloc_ar::AlignmentState::Searching => AlignmentState::Searching,
                veiloc_ar::AlignmentState::Tentative => AlignmentState::Tentative,
                veiloc_ar::AlignmentState::Aligned => AlignmentState::Aligned,
            },
            used: aligned.map_or(0, |aligned| aligned.used as u32),
            contradicting: aligned.map_or(0, |aligned| aligned.contradicting as u32),
            distances: match ratio.map(|ratio| ratio.verdict()) {
                None | Some(veiloc_ar::DistanceVerdict::Unknown) => Distances::Unknown,
                Some(veiloc_ar::DistanceVerdict::Agrees) => Distances::Agree,
                Some(veiloc_ar::DistanceVerdict::Differs) => Distances::Differ,
            },
            distance_ratio: ratio.map(|ratio| ratio.median),
        }
    }

    /// The pose in the AR world of content whose pose in the map is known (map units); null before the first trusted
    /// answer.
    ///
    /// # Errors
    /// [`VeilocException::Argument`] for a pose that is no rotation.
    pub fn world_from_anchor(
        &self,
        axes: Axes,
        map_from_anchor: Pose,
    ) -> Result<Option<Pose>, VeilocException> {
        let alignment = self.locked();
        if alignment.aligned().is_none() {
            return Ok(None);
        }
        let pose = alignment.world_from_anchor(axes.into(), &map_from_anchor.into());
        Ok(Some(pose.ok_or_else(no_pose)?.into()))
    }

    /// Where the camera is in the map now, by its pose in the AR world; null before the first trusted answer.
    ///
    /// # Errors
    /// [`VeilocException::Argument`] for a pose that is no rotation.
    pub fn camera_in_map(&self, camera_in_world: CameraPose) -> Result<Option<CameraInMap>, VeilocException> {
        let (alignment, camera) = (self.locked(), camera_in_world.cam_from_ar()?);
        let (Some(cam_from_map), Some(accuracy)) =
            (alignment.cam_from_map(&camera), alignment.accuracy(&camera))
        else {
            return Ok(None);
        };
        let map_from_cam = cam_from_map.inverse();
        let ([w, x, y, z], position) = (map_from_cam.quaternion(), (*map_from_cam.translation()).into());
        let pose = veiloc_ar::FrameworkPose { position, rotation: [x, y, z, w] };
        Ok(Some(CameraInMap { pose: pose.into(), accuracy: accuracy.into() }))
    }
}
