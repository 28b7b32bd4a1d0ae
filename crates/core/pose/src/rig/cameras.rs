//! The cameras of a rig's images: what their errors add to the covariance of the pose, and whether the matches contradict
//! them.
//!
//! Does for the frames of one [`Lens`] what `camera_refinement.rs` does for one image. All frames of a lens have the same
//! errors, so more frames do not average them out:
//!
//! ```text
//! C_camera = Σ_lenses M S Mᵀ,   M = Λ⁻¹ Σ_frames A_iᵀ K_i J_i,   Λ = Σ A_iᵀ K_i A_i
//! ```
//!
//! `S` is the second moment of the errors by all frames of the lens, `J_i` the step of a frame's pose by them, `K_i` its
//! information with its deviation from the odometry marginalised out, and `A_i` takes a step of the rig to the frame.

use veiloc_geometry::nalgebra::Matrix6;

use super::RigFrame;
use super::evidence::FrameContribution;
use super::focal::Lens;
use super::polish::PolishedRig;
use super::search::RigSearch;
use crate::likelihood::{
    CameraChange, CameraEvidence, CameraInfluence, CameraObjective, CameraVerdict, PoseWithCamera,
    Symmetric6, propagated, sum,
};
use crate::options::PoseOptions;

/// What the cameras of a rig's images do to its pose.
pub(super) struct RigCameras {
    /// What their errors add to the covariance of the rig's pose.
    pub(super) covariance: Symmetric6,
    /// Whether the matches of a frame contradict its camera.
    pub(super) is_contradicted: bool,
}

impl RigCameras {
    /// At refined poses. `given` are the frames as the caller gave them.
    pub(super) fn new(
        search: &RigSearch<'_>,
        polished: &PolishedRig,
        lenses: &[Lens],
        contributions: &[FrameContribution<'_>],
        given: &[RigFrame],
        options: &PoseOptions,
    ) -> Self {
        let frames = Frames { search, polished, given };
        let held: Matrix6<f64> = contributions
            .iter()
            .zip(&search.constraints)
            .map(|(w, constraint)| {
                constraint.information_over_rig(&w.information_with_shared_errors(), &w.deviation)
            })
            .sum();
        let held = held.cholesky();
        let of_lens = |lens: &Lens| {
            let (spread, force) = frames.of_lens(lens, contributions)?;
            propagated(&held.as_ref()?.solve(&force), &spread)
        };
        let covariance = lenses.iter().filter_map(of_lens).fold([[0.0; 6]; 6], |all, one| sum(&all, &one));
        let is_contradicted = lenses.iter().any(|lens| {
            lens.frames.iter().any(|&f| frames.contradict(f, lens, contributions[f].inliers.len(), options))
        });
        Self { covariance, is_contradicted }
    }
}

struct Frames<'s, 'a> {
    search: &'s RigSearch<'a>,
    polished: &'s PolishedRig,
    given: &'s [RigFrame],
}

impl Frames<'_, '_> {
    /// Second moment of a lens' errors, and the force on the rig by each of them; `None` when no frame determines them.
    fn of_lens(
        &self,
        lens: &Lens,
        contributions: &[FrameContribution<'_>],
    ) -> Option<(Matrix6<f64>, Matrix6<f64>)> {
        let change = CameraChange::of_focal(lens.factor);
        let mut force = Matrix6::zeros();
        let mut evidence = Vec::with_capacity(lens.frames.len());
        for &f in &lens.frames {
            let at = PoseWithCamera { pose: self.polished.poses.cams[f], change };
            let influence = self.objective(f, &at, self.polished.noise[f]).look(&at).influence;
            let Some(CameraInfluence { pose_by_camera, evidence: mut of_frame }) = influence else {
                continue;
            };
            let (w, constraint) = (&contributions[f], &self.search.constraints[f]);
            of_frame.shared_variance /= w.share();
            let information = w.information_with_shared_errors();
            force += constraint.force_over_rig(&information, &w.deviation, &pose_by_camera);
            evidence.push(of_frame);
        }
        let first = *lens.frames.first()?;
        let at = PoseWithCamera { pose: self.polished.poses.cams[first], change };
        let objective = self.objective(first, &at, self.polished.noise[first]);
        Some((objective.assumed_spread(&CameraEvidence::of_all(&evidence), &change)?, force))
    }

    /// Whether the matches of a frame contradict its camera, at the frame's own best pose. Those of a frame that
    /// contradicts the other frames say nothing: fewer agree with the joint pose, `agreeing`, than with another one.
    fn contradict(&self, f: usize, lens: &Lens, agreeing: usize, options: &PoseOptions) -> bool {
        let search = &self.search.frames[f].search;
        let alone = search.polish(&self.polished.poses.cams[f], options.estimate_noise);
        let of_alone = search.agreeing(&alone.pose, &search.likelihoods(&alone)).len();
        let at = PoseWithCamera { pose: alone.pose, change: CameraChange::of_focal(lens.factor) };
        2 * agreeing >= of_alone && {
            let objective = self.objective(f, &at, alone.noise);
            objective.test(&objective.look(&at)) != CameraVerdict::Fine
        }
    }

    fn objective(&self, f: usize, at: &PoseWithCamera, noise: f64) -> CameraObjective<'_> {
        self.search.frames[f].camera_objective(self.given, &at.pose, noise)
    }
}
