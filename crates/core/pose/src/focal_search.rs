//! The focal length of a pose: the given one, or another that the matches make likelier.
//!
//! There are two stages. If a search leaves a doubt, it is repeated with other focal lengths. After the search, the
//! focal length is refined with the pose when it is unknown or contradicted by the matches; larger jumps are tried too,
//! because a wrong focal length may have led to a pose at which no small change improves the likelihood.

use crate::camera_refinement::CameraTest;
use crate::confidence::{Confidence, Doubt};
use crate::error::PoseError;
use crate::likelihood::{
    CameraObjective, Correspondences, FocalObjective, FocalPrior, FocalTest, FocalVerdict, Matches,
    PoseWithFocal,
};
use crate::options::PoseOptions;
use crate::pose_estimate::PoseEstimate;
use crate::ransac::Estimator;
use crate::ransac::search::{Polished, Search};

/// Log evidence above which a trusted pose is not tested with other focal lengths.
const CLEAR_LOG_EVIDENCE: f64 = 150.0;

/// Log likelihood by which a search with another focal length may end behind the best one: farther behind it is not
/// refined, which takes most of the time of a query that is not found. Of two focal lengths near the true one both lead to
/// it.
const MAX_BEHIND: f64 = 5.0;

/// Jumps that are tried, relative to the current focal length.
pub(crate) const JUMPS: [f64; 2] = [0.94, 1.06];

/// Maximum number of jumps.
pub(crate) const MAX_JUMPS: usize = 4;

/// Log likelihood that a jump must gain in addition to the gain required of a small change: it may have found another
/// optimum.
pub(crate) const JUMP_HANDICAP: f64 = 2.5;

/// Log evidence above which a pose whose focal length is consistent, or nearly, is not a false optimum of a wrong focal
/// length: those had 350.
pub(crate) const UNAMBIGUOUS_LOG_EVIDENCE: f64 = 800.0;

/// Iterations that alternate between focal length and noise.
pub(crate) const MAX_ROUNDS: usize = 3;

/// The best cost of the searches with several focal lengths.
pub(crate) struct BestCost(f64);

impl Default for BestCost {
    fn default() -> Self {
        Self(f64::INFINITY)
    }
}

impl BestCost {
    /// Whether to refine the result of a search with this cost; remembers the cost.
    pub(crate) fn is_near(&mut self, cost: f64) -> bool {
        self.0 = self.0.min(cost);
        cost <= self.0 + MAX_BEHIND
    }
}

/// An estimate, as far as the choice of a focal length needs it.
pub(crate) trait WithConfidence {
    /// The confidence of the estimate.
    fn confidence(&self) -> &Confidence;

    /// Required gain of another focal length before a calibrated one is called wrong, [`FocalVerdict::min_gain`].
    fn min_gain(&self) -> f64;

    /// Whether more of the camera than its focal length was estimated. From a search with a wrong focal length, such a
    /// camera may explain the matches well and be wrong.
    fn is_of_other_camera(&self) -> bool {
        false
    }
}

/// An estimate of one image, with its observations.
pub(crate) struct ImageEstimate<'a> {
    pub(crate) estimate: PoseEstimate,
    pub(crate) observations: &'a Correspondences,
}

impl WithConfidence for ImageEstimate<'_> {
    fn confidence(&self) -> &Confidence {
        &self.estimate.confidence
    }

    fn min_gain(&self) -> f64 {
        FocalVerdict::min_gain(self.observations, self.estimate.inlier_count)
    }

    fn is_of_other_camera(&self) -> bool {
        self.estimate.principal_shift_px != [0.0; 2]
    }
}

/// The best of a search with the given focal length and, if that leaves a doubt, of searches with others. `search_at`
/// gets the factor on the given focal length, and the options of the search: all others together draw at most as many
/// samples as the first, so that an image of another place does not cost a multiple of one that is found.
pub(crate) fn over_focal_lengths<T: WithConfidence>(
    focal: FocalPrior,
    options: &PoseOptions,
    mut search_at: impl FnMut(f64, &PoseOptions) -> Result<T, PoseError>,
) -> Result<T, PoseError> {
    let mut best = search_at(1.0, options);
    let surplus = min_surplus(focal, &best);
    let others = other_focal_lengths(focal, &best);
    let max_hypotheses = (options.max_hypotheses / others.len().max(1)).max(1);
    let options = PoseOptions { max_hypotheses, ..options.clone() };
    for &factor in others {
        let other = search_at(factor, &options);
        if log_evidence_of(&other) > log_evidence_of(&best) + surplus {
            best = other;
        }
        if is_clear(&best) {
            break;
        }
    }
    best
}

/// Other focal lengths to search with, relative to the given one, when the estimate has a doubt or little evidence: for
/// a default value, the full range in which a phone's default can be wrong; for a calibrated one, only when a pose was
/// found that a wrong focal length may have spoilt.
fn other_focal_lengths<T: WithConfidence>(focal: FocalPrior, found: &Result<T, PoseError>) -> &'static [f64] {
    if is_clear(found) {
        return &[];
    }
    match focal {
        FocalPrior::Calibrated if log_evidence_of(found) < 0.0 => &[],
        FocalPrior::Calibrated | FocalPrior::Exif => &[0.87, 1.15, 0.75, 1.33],
        FocalPrior::Unknown => &[0.8, 1.25, 0.65, 1.55],
    }
}

/// Additional evidence that a pose with another focal length must have: a calibrated focal length is replaced only for
/// much more evidence.
fn min_surplus<T: WithConfidence>(focal: FocalPrior, found: &Result<T, PoseError>) -> f64 {
    match focal {
        FocalPrior::Calibrated => {
            JUMP_HANDICAP + found.as_ref().map_or(FocalVerdict::min_gain_of([]), WithConfidence::min_gain)
        }
        FocalPrior::Exif | FocalPrior::Unknown => 0.0,
    }
}

/// Whether no other focal length needs to be tried.
pub(crate) fn is_clear<T: WithConfidence>(found: &Result<T, PoseError>) -> bool {
    // A suspicious focal length has already been tested, and a given position says nothing about it.
    let other = |doubt: &Doubt| !matches!(doubt, Doubt::FocalLength { .. } | Doubt::FarFromPosition { .. });
    found.as_ref().is_ok_and(|found| {
        let confidence = found.confidence();
        confidence.log_evidence > CLEAR_LOG_EVIDENCE
            && !found.is_of_other_camera()
            && !confidence.doubts().iter().any(other)
    })
}

/// Log evidence; the smallest number when nothing was found.
fn log_evidence_of<T: WithConfidence>(found: &Result<T, PoseError>) -> f64 {
    found.as_ref().map_or(f64::NEG_INFINITY, |estimate| estimate.confidence().log_evidence)
}

/// A refined pose with its focal length.
pub(crate) struct FocalRefinement<'a> {
    /// The search over the correspondences with that focal length.
    pub(crate) search: Search<'a>,
    pub(crate) polished: Polished,
    /// The focal length relative to the given one.
    pub(crate) factor: f64,
    /// The verdict on the given one; [`FocalVerdict::Wrong`] when another was estimated.
    pub(crate) verdict: FocalVerdict,
}

impl<'a> FocalRefinement<'a> {
    /// Refines the result of a search. `seen` are the correspondences that the start can see, with the given focal
    /// length. Under MSAC, the paper's recipe, the start's focal length is not changed.
    pub(crate) fn new(
        mut search: Search<'a>,
        seen: &Matches<'a>,
        start: &PoseWithFocal,
        test: &CameraTest,
    ) -> Self {
        let CameraTest { known: focal, estimate_noise, .. } = *test;
        search.fix_visible(seen.with_focal(start.factor));
        let polished = search.polish(&start.pose, estimate_noise);
        let mut refinement = Self { search, polished, factor: start.factor, verdict: FocalVerdict::Fine };
        if !refinement.search.is_likelihood() {
            return refinement;
        }
        let is_open = focal != FocalPrior::Calibrated || start.factor != 1.0;
        refinement.verdict = if is_open {
            FocalVerdict::Wrong
        } else {
            refinement.objective(seen, focal).verdict(&refinement.polished.pose)
        };
        for _ in 0..MAX_JUMPS {
            if refinement.verdict == FocalVerdict::Wrong {
                for _ in 0..MAX_ROUNDS {
                    let from = PoseWithFocal { pose: refinement.polished.pose, factor: refinement.factor };
                    let refined = refinement.objective(seen, focal).refine(&from);
                    refinement.move_to(seen, &refined, estimate_noise);
                }
            }
            let cost = refinement.search.cost(&refinement.polished.pose, f64::INFINITY);
            if refinement.verdict.is_near() && cost < -UNAMBIGUOUS_LOG_EVIDENCE {
                break;
            }
            let Some((there, gain)) = refinement.best_jump(seen, cost) else { break };
            if refinement.verdict == FocalVerdict::Wrong {
                // It is open: the likelihood decides.
                if gain <= FocalVerdict::min_gain(refinement.search.matches().observations, 0) {
                    break;
                }
            } else {
                let effect = refinement.objective(seen, focal).linearize(&there).cells.design_effect();
                match FocalVerdict::of(
                    gain / effect,
                    &there,
                    refinement.min_gain().max(test.map.min_focal_gain),
                ) {
                    FocalVerdict::Wrong => refinement.verdict = FocalVerdict::Wrong,
                    suspicious @ FocalVerdict::Suspicious { .. } => {
                        if refinement.verdict == FocalVerdict::Fine {
                            refinement.verdict = suspicious;
                        }
                        break;
                    }
                    FocalVerdict::Fine => break,
                }
            }
            refinement.move_to(seen, &there, estimate_noise);
        }
        if focal == FocalPrior::Calibrated && refinement.verdict == FocalVerdict::Wrong {
            refinement.test_again(seen, test);
        }
        refinement
    }

    /// Returns to the given focal length if the errors of the map's own cameras explain the matches about as well as the
    /// other one.
    fn test_again(&mut self, seen: &Matches<'a>, test: &CameraTest) {
        let objective = CameraObjective {
            matches: seen,
            priors: self.search.priors(),
            active: self.search.possible(&self.polished.pose, self.polished.noise),
            noise: self.polished.noise,
            map: test.map,
            known: test.known,
        };
        let at = PoseWithFocal { pose: self.polished.pose, factor: self.factor };
        let FocalTest { verdict, pose_of_given } = objective.test_focal(&at);
        if verdict != FocalVerdict::Wrong {
            self.verdict = verdict;
            let given = PoseWithFocal { pose: pose_of_given, factor: 1.0 };
            self.move_to(seen, &given, test.estimate_noise);
        }
    }

    fn objective<'s>(&self, seen: &'s Matches<'a>, focal: FocalPrior) -> FocalObjective<'s> {
        FocalObjective {
            matches: seen,
            priors: self.search.priors().clone(),
            active: self.search.possible(&self.polished.pose, self.polished.noise),
            noise: self.polished.noise,
            sd: focal.sd(),
        }
    }

    fn move_to(&mut self, seen: &Matches<'a>, there: &PoseWithFocal, estimate_noise: bool) {
        self.factor = there.factor;
        self.search.fix_visible(seen.with_focal(there.factor));
        self.polished = self.search.polish(&there.pose, estimate_noise);
    }

    /// The jump with the largest gain over the cost `own`, and this gain.
    fn best_jump(&self, seen: &Matches<'a>, own: f64) -> Option<(PoseWithFocal, f64)> {
        JUMPS
            .iter()
            .map(|jump| jump * self.factor)
            .map(|factor| self.search.try_focal(seen.with_focal(factor), &self.polished.pose, factor))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(there, cost)| (there, own - cost - JUMP_HANDICAP))
    }

    /// Required gain of another focal length before a calibrated one is called wrong.
    fn min_gain(&self) -> f64 {
        let agreeing =
            self.search.agreeing(&self.polished.pose, &self.search.likelihoods(&self.polished)).len();
        FocalVerdict::min_gain(self.search.matches().observations, agreeing)
    }
}
