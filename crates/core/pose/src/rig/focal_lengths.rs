//! Searches with several focal lengths: if a search leaves a doubt, it is repeated with others.

use crate::confidence::Doubt;
use crate::error::PoseError;
use crate::likelihood::{FocalPrior, FocalVerdict};
use crate::options::PoseOptions;
use crate::rig::{JUMP_HANDICAP, RigEstimate, RigFrame};

pub(crate) type Found = Result<RigEstimate, PoseError>;

/// Log evidence above which a trusted pose is not tested with other focal lengths.
const CLEAR_LOG_EVIDENCE: f64 = 150.0;

/// Log likelihood by which a search may end behind the best one: farther behind it is not refined, which takes most of the
/// time of a query that is not found. Of two focal lengths near the true one both lead to it.
const MAX_BEHIND: f64 = 5.0;

/// Log likelihood by which a search must be ahead of all others to be refined at once: its focal length is then probably
/// right, and the remaining ones need not be tried.
const CLEARLY_AHEAD: f64 = 20.0;

/// Searches with given focal lengths, and refines what they find.
pub(crate) trait FocalSearch {
    /// Poses that a search found.
    type Candidate;

    /// Searches with the given focal lengths multiplied by a factor.
    fn search(&mut self, factor: f64, options: &PoseOptions) -> Result<Self::Candidate, PoseError>;

    /// Minus the log likelihood of the candidate against "all matches are wrong".
    fn cost(candidate: &Self::Candidate) -> f64;

    /// Refines and assesses it.
    fn refine(&mut self, candidate: Self::Candidate) -> Found;
}

/// The best of a search with the given focal length and, if that leaves a doubt, of searches with others: all others
/// together draw at most as many samples as the first, so that an image of another place does not cost a multiple of one
/// that is found. For the same reason only the best of several searches is refined that cannot leave a clear result.
pub(crate) fn over_focal_lengths<S: FocalSearch>(
    focal: FocalPrior,
    frames: &[RigFrame],
    options: &PoseOptions,
    searches: &mut S,
) -> Found {
    let first = searches.search(1.0, options)?;
    let mut least = S::cost(&first);
    let mut waiting = None;
    let mut best = if frames.len() == 1 && focal != FocalPrior::Calibrated && least > -CLEAR_LOG_EVIDENCE {
        waiting = Some(first);
        Err(PoseError::NoConsensus { inliers: 0, required: options.min_inliers, hypotheses: 0 })
    } else {
        searches.refine(first)
    };
    let surplus = min_surplus(focal, frames, &best);
    let take = |best: &mut Found, other: Found| {
        if best.is_err() || log_evidence_of(&other) > log_evidence_of(best) + surplus {
            *best = other;
        }
    };
    let others = other_focal_lengths(focal, &best);
    let max_hypotheses = (options.max_hypotheses / others.len().max(1)).max(1);
    let options = PoseOptions { max_hypotheses, ..options.clone() };
    for &factor in others {
        let other = searches.search(factor, &options)?;
        let cost = S::cost(&other);
        if cost < least - CLEARLY_AHEAD {
            waiting = None;
            take(&mut best, searches.refine(other));
            if is_clear(&best) {
                return best;
            }
        } else if waiting.as_ref().map_or(cost <= least + MAX_BEHIND, |known| cost < S::cost(known)) {
            waiting = Some(other);
        }
        least = least.min(cost);
    }
    if let Some(other) = waiting.filter(|other| S::cost(other) <= least + MAX_BEHIND) {
        take(&mut best, searches.refine(other));
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
