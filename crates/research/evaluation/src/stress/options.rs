//! Options of an evaluation under stress.

use super::condition::StressCondition;
use crate::SceneEvaluation;
use crate::pose::ORACLE_RADIUS_PX;
use crate::results::metrics::Threshold;

/// Inputs and options: every stress with every scheme.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct StressEvaluation {
    /// The scene, its schemes and localization.
    pub scene: SceneEvaluation,
    /// Conditions, in the order of the table; [`StressCondition::None`] always comes first.
    pub stresses: Vec<StressCondition>,
    /// A pose beyond either bound is wrong, and must not be trusted.
    pub wrong_threshold: Threshold,
    /// Whether to optimize from the true pose as well, to find the losses of the search
    /// ([`TruthStartErrors`](super::TruthStartErrors)).
    pub from_truth: bool,
    /// For [`Self::from_truth`]: largest reprojection error of a true match under the true pose, pixels.
    pub oracle_radius_px: f64,
}

impl StressEvaluation {
    /// All conditions; a pose beyond 25 cm or 2° is wrong.
    pub fn new(scene: SceneEvaluation) -> Self {
        Self {
            scene,
            stresses: StressCondition::DEFAULT.to_vec(),
            wrong_threshold: Threshold { translation: 0.25, rotation_deg: 2.0 },
            from_truth: false,
            oracle_radius_px: ORACLE_RADIUS_PX,
        }
    }

    /// Each condition once, [`StressCondition::None`] first.
    pub(super) fn ordered(&self) -> Vec<StressCondition> {
        let mut ordered = vec![StressCondition::None];
        for stress in &self.stresses {
            if !ordered.contains(stress) {
                ordered.push(*stress);
            }
        }
        ordered
    }
}
