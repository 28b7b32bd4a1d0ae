//! Searches with several focal lengths: if a search leaves a doubt, it is repeated with others.

use crate::confidence::Doubt;
use crate::error::PoseError;
use crate::likelihood::{FocalPrior, FocalVerdict};
use crate::options::PoseOptions;
use crate::rig::{JUMP_HANDICAP, RigEstimate, RigFrame};

type Found = Result<RigEstimate, PoseError>;

/// Log evidence above which a trusted pose is not tested with other focal lengths.
const CLEAR_LOG_EVIDENCE: f64 = 150.0;

/// Log likelihood by which a search with another focal length may end behind the best one: farther behind it is not
/// refined, which takes most of the time of a query that is not found. Of two focal lengths near the true one both lead to
/// it.
const MAX_BEHIND: f64 = 5.0;

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

/// The best of a search with the given focal length and, if that leaves a doubt, of searches with others. `search_at`
/// gets the factor on the given focal length, and the options of the search: all others together draw at most as many
/// samples as the first, so that an image of another place does not cost a multiple of one that is found.
pub(crate) fn over_focal_lengths(
    focal: FocalPrior,
    frames: &[RigFrame],
    options: &PoseOptions,
    mut search_at: impl FnMut(f64, &PoseOptions) -> Found,
) -> Found {
    let mut best = search_at(1.0, options);
    let surplus = min_surplus(focal, frames, &best);
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
fn other_focal_lengths(focal: FocalPrior, found: &Found) -> &'static [f64] {
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
fn min_surplus(focal: FocalPrior, frames: &[RigFrame], found: &Found) -> f64 {
    if focal != FocalPrior::Calibrated {
        return 0.0;
    }
    let agreeing = found.iter().flat_map(|found| frames.iter().zip(&found.frames));
    let agreeing = agreeing.map(|(frame, found)| (&frame.problem.observations, found.inlier_count));
    JUMP_HANDICAP + FocalVerdict::min_gain_of(agreeing)
}

/// Whether no other focal length needs to be tried.
pub(crate) fn is_clear(found: &Found) -> bool {
    // A suspicious focal length has already been tested, and a given position says nothing about it.
    let other = |doubt: &Doubt| !matches!(doubt, Doubt::FocalLength { .. } | Doubt::FarFromPosition { .. });
    // From a search with a wrong focal length, another camera may explain the matches well and be wrong.
    let is_of_other_camera =
        |found: &RigEstimate| found.frames.iter().any(|f| f.principal_shift_px != [0.0; 2]);
    found.as_ref().is_ok_and(|found| {
        found.confidence.log_evidence > CLEAR_LOG_EVIDENCE
            && !is_of_other_camera(found)
            && !found.confidence.doubts().iter().any(other)
    })
}

/// Log evidence; the smallest number when nothing was found.
fn log_evidence_of(found: &Found) -> f64 {
    found.as_ref().map_or(f64::NEG_INFINITY, |estimate| estimate.confidence.log_evidence)
}
