//! The search over checked frames, with one focal length after another.

use rand::Rng;
use veiloc_geometry::RigFromWorld;

use super::assess::{Found, refine_and_assess};
use super::estimate::RigEstimate;
use super::frame::{Frame, RigFrame};
use super::joint::Poses;
use super::lens::worst_known;
use super::rival::find_rival;
use super::search::Search;
use crate::confidence::State;
use crate::error::PoseError;
use crate::likelihood::{FocalPrior, Matches};
use crate::options::PoseOptions;
use crate::rig::focal_lengths::{FocalSearch, is_clear, over_focal_lengths};

/// If a search over several frames leaves a doubt, it is repeated with this multiple of the minimum number of samples
/// per frame: there are many matches in all frames together and few in each, and loose odometry with precise matches
/// lets enough of them agree with a wrong pose for the search to stop early. On RedKitchen's trajectory with every
/// tenth image mapped, recall of dcl at 5 cm/5°: 79, 86 and 97 % for two, four and eight frames without, 83, 90 and 100
/// % with (`veiloc eval scene --conditions sparse-map+frames:N`).
const RETRY_SAMPLE_FACTOR: usize = 4;

/// Frames that have passed their check.
pub(crate) struct Images<'a> {
    pub(super) frames: &'a [RigFrame],
    /// Which of them can give hypotheses, `[F]`.
    can_be_drawn: Vec<bool>,
    /// Indices of those with correspondences.
    shown: Vec<usize>,
    /// Their correspondences, with the given focal lengths.
    given: Vec<Matches<'a>>,
}

impl<'a> Images<'a> {
    /// Which frames can give hypotheses, `[F]`.
    ///
    /// # Errors
    /// [`PoseError::Frame`] for an invalid frame.
    pub(crate) fn check(frames: &[RigFrame]) -> Result<Vec<bool>, PoseError> {
        let check = |(frame, given): (usize, &RigFrame)| {
            given.has_minimal_sample().map_err(|source| PoseError::Frame { frame, source: Box::new(source) })
        };
        frames.iter().enumerate().map(check).collect()
    }

    /// # Errors
    /// As [`Self::check`].
    pub(crate) fn new(frames: &'a [RigFrame], options: &PoseOptions) -> Result<Self, PoseError> {
        let can_be_drawn = Self::check(frames)?;
        let shown: Vec<usize> = (0..frames.len()).filter(|&i| !frames[i].problem.points.is_empty()).collect();
        let matches = |&i: &usize| Matches::new(&frames[i].problem, options.expected_inlier_ratio);
        let given = shown.iter().map(matches).collect();
        Ok(Self { frames, can_be_drawn, shown, given })
    }

    /// The frames with correspondences, by their indices.
    pub(super) fn with_matches(&self) -> impl Iterator<Item = (usize, &Matches<'a>)> {
        self.shown.iter().copied().zip(&self.given)
    }

    /// The best pose over all focal lengths, and its rival.
    pub(crate) fn estimate<R: Rng + ?Sized>(
        &self,
        options: &PoseOptions,
        rng: &mut R,
    ) -> Result<RigEstimate, PoseError> {
        let mut searches = Searches { images: self, options, rng: &mut *rng };
        let best = over_focal_lengths(self.focal(), self.frames, options, &mut searches);
        // The optimum lies between two tried focal lengths: the best of them may not be the best of all.
        if options.stop.is_set() {
            return Err(PoseError::Stopped);
        }
        let mut best = best?;
        // A pose that is no better than chance has no rival.
        if options.fixed_hypotheses.is_none() && best.confidence.state() != State::NotFound {
            let rival = find_rival(self, &best, options, rng);
            best.rival = rival.map(|(pose, _)| pose);
            best.confidence.rival_log_evidence = rival.map(|(_, log_evidence)| log_evidence);
        }
        Ok(best)
    }

    /// Searches with the given focal lengths multiplied by a factor, for those frames whose focal length is known no
    /// better than any other. With `times` above 1 it draws at least this multiple of the samples of a single-frame search
    /// for every frame.
    pub(super) fn search_at<R: Rng + ?Sized>(
        &self,
        factor: f64,
        options: &PoseOptions,
        times: usize,
        rng: &mut R,
    ) -> Result<Candidate<'_>, PoseError> {
        let stopped = || if options.stop.is_set() { Err(PoseError::Stopped) } else { Ok(()) };
        stopped()?;
        let mut search = self.search(factor, options)?;
        let mut budget = options.budget(self.drawn());
        if times > 1 {
            budget.min = budget.min.saturating_mul(times * self.drawn()).min(budget.max);
        }
        let found = search.run(budget, options, rng);
        stopped()?;
        let (hypotheses, cost) = (found.samples, found.cost);
        Ok(Candidate { search, poses: found.model, cost, factor, hypotheses })
    }

    /// Refines and assesses what a search found.
    pub(super) fn refine(
        &self,
        mut candidate: Candidate<'_>,
        options: &PoseOptions,
    ) -> Result<RigEstimate, PoseError> {
        let Candidate { ref poses, factor, hypotheses, .. } = candidate;
        let Some(poses) = poses else {
            return Err(PoseError::NoConsensus { inliers: 0, required: options.min_inliers, hypotheses });
        };
        refine_and_assess(&mut candidate.search, &Found { poses, factor, hypotheses }, self.frames, options)
    }

    /// The pose from a start, without sampling.
    pub(crate) fn optimize(
        &self,
        initial: &RigFromWorld,
        options: &PoseOptions,
    ) -> Result<RigEstimate, PoseError> {
        let mut search = self.search(1.0, options)?;
        search.use_all_priors(options);
        let start = Poses::rigid(&search.constraints, *initial);
        let descended = search.descend(&start);
        let is_better = search.settled_cost(&descended) < search.settled_cost(&start);
        let poses = if is_better { &descended } else { &start };
        refine_and_assess(&mut search, &Found { poses, factor: 1.0, hypotheses: 0 }, self.frames, options)
    }

    fn search(&self, factor: f64, options: &PoseOptions) -> Result<Search<'_>, PoseError> {
        let worst = self.focal();
        let frames = self.with_matches().map(|(i, given)| {
            let factor = if self.frames[i].problem.focal == worst { factor } else { 1.0 };
            Frame::new(i, &self.frames[i], given, factor, self.can_be_drawn[i], options)
        });
        let constraints = self.with_matches().map(|(i, given)| self.frames[i].constraint(given));
        Search::new(frames.collect(), constraints.collect(), options)
            .ok_or(PoseError::NoFrameAlone { frames: self.frames.len() })
    }

    /// How well the focal lengths that are known worst are known.
    fn focal(&self) -> FocalPrior {
        worst_known(self.shown.iter().map(|&i| self.frames[i].problem.focal))
    }

    /// Number of frames that can give hypotheses.
    fn drawn(&self) -> usize {
        self.can_be_drawn.iter().filter(|can| **can).count()
    }

    /// Whether more samples may find a better pose. For one frame the search itself decides when it is complete.
    fn may_have_missed(&self, found: &Result<RigEstimate, PoseError>, options: &PoseOptions) -> bool {
        self.drawn() > 1 && options.fixed_hypotheses.is_none() && !is_clear(found)
    }
}

/// What a search with one focal length found.
pub(super) struct Candidate<'a> {
    pub(super) search: Search<'a>,
    /// `None` when no sample gave poses.
    pub(super) poses: Option<Poses>,
    /// Minus their log likelihood; infinite without poses.
    cost: f64,
    factor: f64,
    hypotheses: usize,
}

/// The searches over the focal lengths of some images.
struct Searches<'i, 'a, 'r, R: Rng + ?Sized> {
    images: &'i Images<'a>,
    options: &'i PoseOptions,
    rng: &'r mut R,
}

impl<'i, R: Rng + ?Sized> FocalSearch for Searches<'i, '_, '_, R> {
    type Candidate = Candidate<'i>;

    fn search(&mut self, factor: f64, options: &PoseOptions) -> Result<Candidate<'i>, PoseError> {
        self.images.search_at(factor, options, 1, self.rng)
    }

    fn cost(candidate: &Candidate<'i>) -> f64 {
        candidate.cost
    }

    fn refine(&mut self, candidate: Candidate<'i>) -> Result<RigEstimate, PoseError> {
        let is_first = candidate.factor == 1.0;
        let found = self.images.refine(candidate, self.options);
        if !is_first || !self.images.may_have_missed(&found, self.options) {
            return found;
        }
        let again = self.images.search_at(1.0, self.options, RETRY_SAMPLE_FACTOR, self.rng)?;
        let again = self.images.refine(again, self.options);
        let score = |of: &Result<RigEstimate, _>| of.as_ref().map_or(f64::INFINITY, |of| of.score);
        if score(&again) < score(&found) { again } else { found }
    }
}
