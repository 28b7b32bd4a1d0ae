//! Options of the estimation, each with its unit and the reason for its default.

use std::fmt;
use std::str::FromStr;

use crate::error::PoseError;
use crate::ransac::Budget;
use crate::ransac::Stop;

/// How hypotheses are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum ScoreKind {
    /// The paper's recipe: truncated squared pixel distance of the projection from the point or line. On anchored lines
    /// it has a false optimum, with the scene projected onto an anchor.
    Msac,
    /// The log likelihood ratio of the observations, which models the anchors of Dual Convergent Lines.
    #[default]
    Likelihood,
}

impl fmt::Display for ScoreKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Msac => "msac",
            Self::Likelihood => "likelihood",
        })
    }
}

/// The text is not the name of a score.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{text:?} is not a score; use msac or likelihood")]
pub struct UnknownScore {
    /// The text as given.
    pub text: String,
}

impl FromStr for ScoreKind {
    type Err = UnknownScore;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "msac" => Ok(Self::Msac),
            "likelihood" => Ok(Self::Likelihood),
            _ => Err(UnknownScore { text: text.to_owned() }),
        }
    }
}

/// The solver for hypotheses from anchored lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum AnchoredSolver {
    /// Six lines of both anchors: the paper's recipe.
    P6lp,
    /// Five lines of one anchor; then all lines of the others vote for the depth along the anchor's ray.
    RadialVote,
    /// Five lines of one anchor and one of the other.
    DualRadial,
}

impl AnchoredSolver {
    /// The vote with the likelihood; `p6lp` with MSAC: MSAC and `p6lp` together are the paper's recipe.
    pub const fn default_for(score: ScoreKind) -> Self {
        match score {
            ScoreKind::Msac => Self::P6lp,
            ScoreKind::Likelihood => Self::RadialVote,
        }
    }
}

impl fmt::Display for AnchoredSolver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::P6lp => "p6lp",
            Self::RadialVote => "radial-vote",
            Self::DualRadial => "dual-radial",
        })
    }
}

/// The text is not the name of a solver.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{text:?} is not a solver for anchored lines; use p6lp, dual-radial or radial-vote")]
pub struct UnknownSolver {
    /// The text as given.
    pub text: String,
}

impl FromStr for AnchoredSolver {
    type Err = UnknownSolver;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "p6lp" => Ok(Self::P6lp),
            "radial-vote" => Ok(Self::RadialVote),
            "dual-radial" => Ok(Self::DualRadial),
            _ => Err(UnknownSolver { text: text.to_owned() }),
        }
    }
}

/// Options of [`crate::estimate_pose`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PoseOptions {
    /// How hypotheses are compared; `None` takes [`ScoreKind::default`].
    pub score: Option<ScoreKind>,
    /// The solver for hypotheses from anchored lines; `None` chooses by [`AnchoredSolver::default_for`].
    pub anchored_solver: Option<AnchoredSolver>,
    /// MSAC's inlier threshold for points, pixels; lines use it divided by √2. 4 is the paper's for 7Scenes (640 ×
    /// 480); it takes 8 for Aachen and 18 for Cambridge.
    pub max_error_px: f64,
    /// Noise scale of a keypoint across its line (for points: along each axis), pixels; the only scale of the
    /// likelihood. It includes detector noise, dither, angle quantization and the map's own error. Too large is better
    /// than too small: the search finds more poses, and the final refinement uses the noise that the inliers show.
    pub noise_px: f64,
    /// Whether the final refinement estimates the noise from the inliers, starting at [`Self::noise_px`]; otherwise
    /// that value is used.
    pub estimate_noise: bool,
    /// Share of right correspondences that is assumed when the problem has no prior. Only its logarithm matters.
    pub expected_inlier_ratio: f64,
    /// Least number of minimal samples.
    pub min_hypotheses: usize,
    /// Largest number of minimal samples.
    pub max_hypotheses: usize,
    /// Exactly this many samples instead of stopping by confidence: for comparisons at equal effort.
    pub fixed_hypotheses: Option<usize>,
    /// Stop when the probability to have missed a better sample is below one minus this.
    pub confidence: f64,
    /// Minimum number of agreeing keypoints. Six lines always agree with some pose, so it must be well above six.
    pub min_inliers: usize,
    /// Whether to report what the matches say about the camera ([`crate::PoseEstimate::camera_evidence`]), as a
    /// self-test of a map needs it; it costs one more refinement.
    pub camera_evidence: bool,
    /// Ends the search without a result ([`PoseError::Stopped`]) once it is set.
    pub stop: Stop,
}

/// Frames of a rig up to which its search may draw more samples. More frames make the search easier, not harder, and the
/// work of a session must have a bound.
const MAX_BUDGET_FRAMES: usize = 4;

impl Default for PoseOptions {
    fn default() -> Self {
        Self {
            score: None,
            anchored_solver: None,
            max_error_px: 4.0,
            noise_px: 2.0,
            estimate_noise: true,
            expected_inlier_ratio: 0.2,
            min_hypotheses: 200,
            max_hypotheses: 10_000,
            fixed_hypotheses: None,
            confidence: 0.9999,
            min_inliers: 10,
            camera_evidence: false,
            stop: Stop::default(),
        }
    }
}

impl PoseOptions {
    /// The solver for hypotheses from anchored lines.
    pub(crate) fn solver(&self) -> AnchoredSolver {
        self.anchored_solver.unwrap_or(AnchoredSolver::default_for(self.score.unwrap_or_default()))
    }

    /// The sample budget for a search over several frames: the maximum is that of a single frame, multiplied up to
    /// [`MAX_BUDGET_FRAMES`] times.
    pub(crate) fn budget(&self, frames: usize) -> Budget {
        match self.fixed_hypotheses {
            Some(samples) => Budget::fixed(samples),
            None => Budget {
                min: self.min_hypotheses.min(self.max_hypotheses),
                max: self.max_hypotheses.saturating_mul(frames.min(MAX_BUDGET_FRAMES)),
                confidence: self.confidence,
            },
        }
    }

    /// Rejects invalid values.
    pub(crate) fn check(&self) -> Result<(), PoseError> {
        for (what, value) in [("max_error_px", self.max_error_px), ("noise_px", self.noise_px)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(PoseError::BadValue { what, value });
            }
        }
        for (what, value) in
            [("confidence", self.confidence), ("expected_inlier_ratio", self.expected_inlier_ratio)]
        {
            if !(value > 0.0 && value < 1.0) {
                return Err(PoseError::BadValue { what, value });
            }
        }
        if self.max_hypotheses == 0 || self.fixed_hypotheses == Some(0) {
            return Err(PoseError::BadValue { what: "number of hypotheses", value: 0.0 });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_read_what_they_print() {
        for score in [ScoreKind::Msac, ScoreKind::Likelihood] {
            assert_eq!(score.to_string().parse(), Ok(score));
        }
        assert!("MSAC".parse::<ScoreKind>().is_err());
        for solver in [AnchoredSolver::P6lp, AnchoredSolver::RadialVote, AnchoredSolver::DualRadial] {
            assert_eq!(solver.to_string().parse(), Ok(solver));
        }
        assert!("p3p".parse::<AnchoredSolver>().is_err());
    }
}
