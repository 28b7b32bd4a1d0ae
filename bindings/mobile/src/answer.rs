//! Answers of the service.

use std::sync::Arc;

use veiloc_protocol::{AnswerPose, StopCriterion};

use crate::error::VeilocException;
use crate::pose::{Accuracy, Axes, CameraPose, Pose, no_pose};

/// An answer: where a frame was taken.
#[derive(uniffi::Object)]
pub struct Answer {
    pub(crate) answer: veiloc_protocol::Answer,
}

/// A reason not to trust a pose.
#[derive(Debug, Clone, PartialEq, Eq, uniffi::Record)]
pub struct Doubt {
    /// `weak-evidence`, `ambiguous`, `imprecise`, `one-sided` or `other`.
    pub kind: String,
    /// For developers, in English. `advice` has words for users.
    pub text: String,
}

impl Answer {
    fn pose(&self) -> Result<&AnswerPose, VeilocException> {
        self.answer.pose.as_ref().ok_or_else(|| VeilocException::argument("the answer has no pose"))
    }

    fn unit(&self, given: Option<f64>) -> Result<f64, VeilocException> {
        veiloc_ar::metres_per_unit(&self.answer, given).map_err(VeilocException::argument)
    }
}

#[uniffi::export]
impl Answer {
    /// Reads an answer: the body of status 200 to a request with `accept: application/x-protobuf`.
    ///
    /// # Errors
    /// [`VeilocException::Answer`].
    #[uniffi::constructor]
    pub fn new(bytes: Vec<u8>) -> Result<Arc<Self>, VeilocException> {
        let answer = veiloc_protocol::Answer::decode(&bytes);
        Ok(Arc::new(Self { answer: answer.map_err(|e| VeilocException::Answer(e.to_string()))? }))
    }

    /// Whether it has a pose. Doubtful poses are withheld when the request asks for it.
    pub fn has_pose(&self) -> bool {
        self.answer.pose.is_some()
    }

    /// Whether there are no doubts about the pose.
    pub fn trusted(&self) -> bool {
        self.answer.trusted()
    }

    /// Reasons not to trust the pose.
    pub fn doubts(&self) -> Vec<Doubt> {
        let doubt = |doubt: &veiloc_protocol::AnswerDoubt| Doubt {
            kind: doubt.kind.name().to_owned(),
            text: doubt.text.clone(),
        };
        self.answer.doubts.iter().map(doubt).collect()
    }

    /// Standard deviation of the position in its least certain direction, map units; infinite without a pose. Relative
    /// to the map, not to the earth.
    pub fn position_sd(&self) -> f64 {
        self.answer.position_sd()
    }

    /// Metres of a unit of the map; none when the unit is not known.
    pub fn metres_per_unit(&self) -> Option<f64> {
        self.answer.map.metres_per_unit
    }

    /// Direction of gravity in the map, a unit vector of three numbers; none when the map does not know it.
    pub fn down(&self) -> Option<Vec<f64>> {
        self.answer.map.down.map(Vec::from)
    }

    /// The answer as JSON: the document that the service gives for `accept: application/json`.
    pub fn to_json(&self) -> String {
        self.answer.to_json()
    }

    /// Whether a progressive query ends with this answer: it is trusted and, with `position_sd`, its standard deviation
    /// is at most that many map units.
    #[uniffi::method(default(position_sd = None))]
    pub fn is_enough(&self, position_sd: Option<f64>) -> bool {
        let criterion = position_sd.and_then(StopCriterion::accurate_to).unwrap_or(StopCriterion::TRUSTED);
        criterion.is_met(self.answer.trusted(), self.position_sd())
    }

    /// Where the camera is in the map, with the axes of a framework in place of the map's: for apps that draw the map.
    /// For content in the AR world use an [`Alignment`](crate::alignment::Alignment). `metres_per_unit`: none for the unit
    /// that the answer states.
    ///
    /// # Errors
    /// [`VeilocException::Argument`] for an answer without a pose, or in an unknown unit.
    #[uniffi::method(default(metres_per_unit = None))]
    pub fn camera_in_map(&self, axes: Axes, metres_per_unit: Option<f64>) -> Result<Pose, VeilocException> {
        let metres = self.unit(metres_per_unit)?;
        let pose = veiloc_ar::Axes::from(axes).camera_in_map(self.pose()?, metres);
        Ok(pose.ok_or_else(no_pose)?.into())
    }

    /// Radii of 68 % confidence. `metres_per_unit`: none for the unit that the answer states.
    ///
    /// # Errors
    /// [`VeilocException::Argument`] for an answer without a pose, or in an unknown unit.
    #[uniffi::method(default(metres_per_unit = None))]
    pub fn accuracy(
        &self,
        camera_in_world: CameraPose,
        metres_per_unit: Option<f64>,
    ) -> Result<Accuracy, VeilocException> {
        let camera = camera_in_world.cam_from_ar()?;
        Ok(veiloc_ar::Accuracy::of_answer(self.pose()?, &camera, self.unit(metres_per_unit)?).into())
    }
}
