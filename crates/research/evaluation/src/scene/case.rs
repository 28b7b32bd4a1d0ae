//! A condition with what it needs: the maps, and the simulated sensors.

use veiloc_geometry::Intrinsics;
use veiloc_protocol::CoarseGravity;

use super::condition::Condition;
use super::options::SceneEvaluation;
use crate::error::EvalError;
use crate::pipeline::{EvaluatedQuery, ServedMap, SimulatedGravity};

/// The maps of a scene.
pub(super) struct Maps<'a> {
    pub(super) whole: ServedMap<'a>,
    pub(super) sparse: Option<ServedMap<'a>>,
}

impl<'a> Maps<'a> {
    pub(super) fn under(&self, condition: &Condition) -> &ServedMap<'a> {
        self.sparse.as_ref().filter(|_| condition.sparse_map).unwrap_or(&self.whole)
    }
}

/// A condition of a scene.
pub(super) struct Case {
    pub(super) condition: Condition,
    gravity: Option<SimulatedGravity>,
}

impl Case {
    /// The condition; refused if a query cannot encode its gravity, or the scene has no direction of gravity.
    pub(super) fn of(condition: Condition, evaluation: &SceneEvaluation) -> Result<Self, EvalError> {
        let SceneEvaluation { posed, map_list, .. } = evaluation;
        // A given map has its own direction.
        let noise = condition.gravity.filter(|_| evaluation.map.is_none());
        let gravity = noise.map(|noise| SimulatedGravity::of(posed, map_list, noise)).transpose()?;
        Ok(Self { condition, gravity })
    }

    /// The sensors, if the map is built for them.
    pub(super) const fn sensors(&self) -> Option<&SimulatedGravity> {
        self.gravity.as_ref()
    }

    /// Whether a query is localized alone under this condition. Gravity is measured at the true pose.
    pub(super) fn is_for(&self, query: &EvaluatedQuery, is_negative: bool) -> bool {
        let Condition { negatives, frames, gravity, .. } = self.condition;
        negatives == is_negative
            && frames.is_none()
            && (negatives || gravity.is_none() || query.truth.is_some())
    }

    /// The gravity that the device sends with a query.
    pub(super) fn gravity_of(&self, query: &EvaluatedQuery, seed: u64) -> Option<CoarseGravity> {
        let noise = self.condition.gravity?;
        if self.condition.negatives {
            return SimulatedGravity::random(&query.name, noise.sd_deg, seed);
        }
        self.gravity?.measured(&query.name, query.truth.as_ref()?, seed)
    }

    /// The camera that the device assumes: the true one, or one with the error of the condition.
    pub(super) fn assumed_camera(
        &self,
        camera: &Intrinsics,
        device: &str,
        seed: u64,
    ) -> Result<Intrinsics, EvalError> {
        let Some(error) = self.condition.camera else { return Ok(*camera) };
        error.applied(camera, device, seed).ok_or_else(|| {
            EvalError::Options(format!(
                "camera:{error}: a camera of model {} has no such parameter; the models up to OPENCV have all of them",
                camera.model.name()
            ))
        })
    }
}
