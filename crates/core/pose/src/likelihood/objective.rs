//! The likelihood of chosen correspondences as a function of a pose and its camera, with the camera priors.

use crate::likelihood::camera::{CAMERA, DistortedCamera, PoseWithCamera};
use crate::likelihood::descent::{Convergence, levenberg_marquardt};
use crate::likelihood::design_effect::ScoreCells;
use crate::likelihood::matches::{LikelihoodTerm, Matches, Residual, SumOfLogs};
use crate::likelihood::pose_priors::PosePriors;
use crate::likelihood::system::{POSE, System};

/// The soft likelihood over chosen correspondences, `−Σ log(1 + exp llr)`, and the camera priors.
#[derive(Clone)]
pub struct Objective<'a> {
    /// With the camera as given.
    pub matches: &'a Matches<'a>,
    /// The camera priors.
    pub priors: &'a PosePriors,
    /// The correspondences that may be right.
    pub active: Vec<usize>,
    /// Scale of the noise, pixels.
    pub noise: f64,
}

/// The scores of the matches at one pose and camera.
pub struct Scores {
    /// By the part of the image in which their points project.
    pub cells: ScoreCells,
    /// Number of correspondences that are likelier right than wrong.
    pub agreeing: usize,
}

impl Scores {
    fn new(matches: &Matches<'_>) -> Self {
        Self { cells: ScoreCells::new(&matches.camera), agreeing: 0 }
    }

    fn add(&mut self, residual: &Residual, term: &LikelihoodTerm) {
        self.cells.add(&residual.pixel, &residual.score(term));
        self.agreeing += usize::from(term.ratio > 1.0);
    }
}

impl Objective<'_> {
    /// Loss and derivatives. Correspondences that cannot be seen count as certainly wrong.
    pub fn linearize<const N: usize>(&self, at: &PoseWithCamera) -> System<N> {
        self.system(at, true, |_, _| ())
    }

    /// The same with the scores of the matches, in one pass.
    pub fn linearize_with_scores<const N: usize>(&self, at: &PoseWithCamera) -> (System<N>, Scores) {
        let mut scores = Scores::new(self.matches);
        let system = self.system(at, true, |residual, term| scores.add(residual, term));
        (system, scores)
    }

    /// The same; when not `gated`, also of matches whose points project outside of the image or of their sector.
    fn system<const N: usize>(
        &self,
        at: &PoseWithCamera,
        gated: bool,
        mut visit: impl FnMut(&Residual, &LikelihoodTerm),
    ) -> System<N> {
        let mut system = System::<N>::empty();
        let mut gain = SumOfLogs::new();
        let rows = self.matches.residuals();
        self.each(at, gated, |residual, term| {
            visit(residual, term);
            gain.add(term.ratio);
            system.add(residual, term.weight, term.right, rows);
        });
        system.loss = -gain.sum();
        let mut of_priors = System::empty();
        self.priors.add_to(&at.pose, &mut of_priors);
        system.mirrored().with_pose_terms(&of_priors)
    }

    /// The scores of the matches.
    pub fn scores(&self, at: &PoseWithCamera) -> Scores {
        let mut scores = Scores::new(self.matches);
        self.each(at, true, |residual, term| scores.add(residual, term));
        scores
    }

    /// The optimum from a start, with the first `N − 6` parameters of the camera free under a prior of these standard
    /// deviations; its loss is never larger than the start's. A large change of the camera needs many steps, and
    /// matches that leave the image or their sector at a step make the loss jump unless it is not `gated`.
    pub fn descend<const N: usize>(
        &self,
        start: &PoseWithCamera,
        sd: &[f64; CAMERA],
        gated: bool,
        convergence: Convergence,
    ) -> PoseWithCamera {
        let step = |at: &PoseWithCamera, here: &System<N>, damping| {
            Some((at.moved(here.damped_step(damping)?.as_slice())?, f64::INFINITY))
        };
        let look =
            |at: &PoseWithCamera| self.system::<N>(at, gated, |_, _| ()).with_camera_prior(&at.change, sd);
        levenberg_marquardt(*start, convergence, look, |here| here.loss, step).at
    }

    /// Visits the matches that may be right.
    fn each(&self, at: &PoseWithCamera, gated: bool, mut visit: impl FnMut(&Residual, &LikelihoodTerm)) {
        let camera = DistortedCamera::changed(&self.matches.camera, &at.change);
        let noise = self.matches.at_noise(self.noise);
        for &i in &self.active {
            let Some(residual) = self.matches.residual_of(&camera, i, &at.pose, gated) else { continue };
            visit(&residual, &self.matches.likelihood_term(i, &residual, &noise));
        }
    }
}

impl PoseWithCamera {
    /// After a step of the pose and of the first parameters of the camera; `None` when the camera would be too
    /// different.
    pub fn moved(&self, step: &[f64]) -> Option<Self> {
        let (of_pose, of_camera) = step.split_first_chunk::<POSE>()?;
        Some(Self { pose: self.pose.perturbed(of_pose), change: self.change.moved(of_camera)? })
    }
}
