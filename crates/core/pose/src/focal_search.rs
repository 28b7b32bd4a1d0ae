//! Which focal length a pose is told with: the one given, or another that the matches make likelier.
//!
//! Two places look. Where a search leaves a doubt, it is repeated with other focal lengths. And where it ended, the focal
//! length is refined with the pose when it is open or contradicted, and jumps further off are tried, because a wrong one may
//! have led to a pose at which no small change of it helps.

use crate::confidence::{Confidence, Doubt};
use crate::error::PoseError;
use crate::likelihood::{Correspondences, FocalKnowledge, FocalVerdict, Matches, ZoomObjective, Zoomed};
use crate::pose_estimate::PoseEstimate;
use crate::ransac::Estimator;
use crate::ransac::search::{Polished, Search};

/// Log evidence from which on a trusted pose is not asked whether another focal length would explain more.
const CLEAR: f64 = 150.0;

/// Jumps that are tried, over the focal length so far.
pub(crate) const JUMPS: [f64; 2] = [0.94, 1.06];

/// Such jumps at most.
pub(crate) const MOST_JUMPS: usize = 4;

/// Log likelihood by which a jump must be better than what a small change must gain: it may have found another optimum.
pub(crate) const JUMP_HANDICAP: f64 = 2.5;

/// Log likelihood from which on a pose whose focal length is found fine, or nearly, is no false optimum of a wrong one: those
/// had 350.
pub(crate) const PLENTY: f64 = 800.0;

/// Rounds of estimating the focal length at the noise that the inliers show, and the noise again.
pub(crate) const ROUNDS: usize = 3;

/// An estimate, as far as the choice of a focal length asks.
pub(crate) trait WithConfidence {
    /// What speaks for and against it.
    fn confidence(&self) -> &Confidence;

    /// What another focal length must gain before a calibrated one is called wrong, [`FocalVerdict::least_gain`].
    fn least_gain(&self) -> f64;
}

/// An estimate of one image, with what it observed.
pub(crate) struct OfImage<'a> {
    pub(crate) estimate: PoseEstimate,
    pub(crate) observations: &'a Correspondences,
}

impl WithConfidence for OfImage<'_> {
    fn confidence(&self) -> &Confidence {
        &self.estimate.confidence
    }

    fn least_gain(&self) -> f64 {
        FocalVerdict::least_gain(self.observations, self.estimate.inlier_count)
    }
}

/// The best of a search with the given focal length and, where that leaves a doubt, of searches with others. `search_at` is
/// told how many times the given one.
pub(crate) fn over_focal_lengths<T: WithConfidence>(
    focal: FocalKnowledge,
    mut search_at: impl FnMut(f64) -> Result<T, PoseError>,
) -> Result<T, PoseError> {
    let mut best = search_at(1.0);
    let surplus = least_surplus(focal, &best);
    for &factor in other_focal_lengths(focal, &best) {
        let other = search_at(factor);
        if worth(&other) > worth(&best) + surplus {
            best = other;
        }
        if is_clear(&best) {
            break;
        }
    }
    best
}

/// Other focal lengths to search with, over the given one, when that leaves a doubt or does not show much evidence: all
/// that a phone's guess may be wrong by when it is a guess, and for a measured one only when something was found that the
/// focal length may have spoilt.
fn other_focal_lengths<T: WithConfidence>(
    focal: FocalKnowledge,
    found: &Result<T, PoseError>,
) -> &'static [f64] {
    if is_clear(found) {
        return &[];
    }
    match focal {
        FocalKnowledge::Calibrated if worth(found) < 0.0 => &[],
        FocalKnowledge::Calibrated | FocalKnowledge::Exif => &[0.87, 1.15, 0.75, 1.33],
        FocalKnowledge::Unknown => &[0.8, 1.25, 0.65, 1.55],
    }
}

/// Evidence that a pose of another focal length must have over this one: a calibrated focal length gives way to much more
/// only.
fn least_surplus<T: WithConfidence>(focal: FocalKnowledge, found: &Result<T, PoseError>) -> f64 {
    match focal {
        FocalKnowledge::Calibrated => {
            JUMP_HANDICAP + found.as_ref().map_or(FocalVerdict::least_gain_of([]), WithConfidence::least_gain)
        }
        FocalKnowledge::Exif | FocalKnowledge::Unknown => 0.0,
    }
}

/// Whether no other focal length needs to be asked.
pub(crate) fn is_clear<T: WithConfidence>(found: &Result<T, PoseError>) -> bool {
    // A suspicious focal length was looked at already.
    let other = |doubt: &Doubt| !matches!(doubt, Doubt::FocalLength { .. });
    found
        .as_ref()
        .map(WithConfidence::confidence)
        .is_ok_and(|told| told.log_evidence > CLEAR && !told.doubts().iter().any(other))
}

/// Log evidence, least when nothing was found.
fn worth<T: WithConfidence>(found: &Result<T, PoseError>) -> f64 {
    found.as_ref().map_or(f64::NEG_INFINITY, |estimate| estimate.confidence().log_evidence)
}

/// A refined pose, and the focal length it is told with.
pub(crate) struct FocalRefinement<'a> {
    /// Over the correspondences as they are with that focal length.
    pub(crate) search: Search<'a>,
    pub(crate) polished: Polished,
    /// The focal length over the given one.
    pub(crate) factor: f64,
    /// What is thought of the given one; [`FocalVerdict::Wrong`] where another was estimated.
    pub(crate) verdict: FocalVerdict,
}

impl<'a> FocalRefinement<'a> {
    /// From where the search ended. `seen` are the correspondences as the start sees them, with the focal length as given.
    /// Under MSAC, which is the paper's recipe, the start's focal length stays.
    pub(crate) fn new(
        mut search: Search<'a>,
        seen: &Matches<'a>,
        start: &Zoomed,
        focal: FocalKnowledge,
        estimate_noise: bool,
    ) -> Self {
        search.fix_visible(seen.with_focal(start.factor));
        let polished = search.polish(&start.pose, estimate_noise);
        let mut settled = Self { search, polished, factor: start.factor, verdict: FocalVerdict::Fine };
        if !settled.search.is_likelihood() {
            return settled;
        }
        let is_open = focal != FocalKnowledge::Calibrated || start.factor != 1.0;
        settled.verdict = if is_open {
            FocalVerdict::Wrong
        } else {
            settled.objective(seen, focal).verdict(&settled.polished.pose)
        };
        for _ in 0..MOST_JUMPS {
            if settled.verdict == FocalVerdict::Wrong {
                for _ in 0..ROUNDS {
                    let from = Zoomed { pose: settled.polished.pose, factor: settled.factor };
                    let refined = settled.objective(seen, focal).refine(&from);
                    settled.move_to(seen, &refined, estimate_noise);
                }
            }
            let cost = settled.search.cost(&settled.polished.pose, f64::INFINITY);
            if settled.verdict.is_near() && cost < -PLENTY {
                break;
            }
            let Some((there, gain)) = settled.best_jump(seen, cost) else { break };
            if settled.verdict == FocalVerdict::Wrong {
                // It is open: it goes where the likelihood is.
                if gain <= FocalVerdict::least_gain(settled.search.matches().observations, 0) {
                    break;
                }
            } else {
                match FocalVerdict::of(gain, &there, settled.least_gain()) {
                    FocalVerdict::Wrong => settled.verdict = FocalVerdict::Wrong,
                    suspicious @ FocalVerdict::Suspicious(_) => {
                        if settled.verdict == FocalVerdict::Fine {
                            settled.verdict = suspicious;
                        }
                        break;
                    }
                    FocalVerdict::Fine => break,
                }
            }
            settled.move_to(seen, &there, estimate_noise);
        }
        settled
    }

    fn objective<'s>(&self, seen: &'s Matches<'a>, focal: FocalKnowledge) -> ZoomObjective<'s> {
        ZoomObjective {
            matches: seen,
            priors: self.search.priors().clone(),
            active: self.search.possible(&self.polished.pose, self.polished.noise),
            noise: self.polished.noise,
            sd: focal.sd(),
        }
    }

    fn move_to(&mut self, seen: &Matches<'a>, there: &Zoomed, estimate_noise: bool) {
        self.factor = there.factor;
        self.search.fix_visible(seen.with_focal(there.factor));
        self.polished = self.search.polish(&there.pose, estimate_noise);
    }

    /// The jump that explains most, and how much more than what is said to cost `own`.
    fn best_jump(&self, seen: &Matches<'a>, own: f64) -> Option<(Zoomed, f64)> {
        JUMPS
            .iter()
            .map(|jump| jump * self.factor)
            .map(|factor| self.search.try_focal(seen.with_focal(factor), &self.polished.pose, factor))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(there, cost)| (there, own - cost - JUMP_HANDICAP))
    }

    /// What another focal length must gain before a calibrated one is called wrong.
    fn least_gain(&self) -> f64 {
        let agreeing =
            self.search.agreeing(&self.polished.pose, &self.search.likelihoods(&self.polished)).len();
        FocalVerdict::least_gain(self.search.matches().observations, agreeing)
    }
}
