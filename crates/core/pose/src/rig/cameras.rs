//! The cameras of the images: what their errors add to the covariance of the pose, and whether the matches contradict them.
//!
//! They are tested after the focal lengths ([`super::lens`]). A wrong principal point, as in a cropped image, and pixels
//! that are not square move the pose, but the residuals hardly grow: a shift of the principal point resembles a
//! rotation. Many matches can distinguish both, because a rotation also changes the perspective. The camera of a single
//! image that the matches contradict is estimated, those of several frames are doubted.
//!
//! All frames of a camera have the same errors, so more frames do not average them out:
//!
//! ```text
//! C_camera = Σ_cameras M S Mᵀ,   M = Λ⁻¹ Σ_frames A_iᵀ K_i J_i,   Λ = Σ A_iᵀ K_i A_i
//! ```
//!
//! `S` is the second moment of the errors by all frames of the camera, `J_i` the step of a frame's pose by them, `K_i`
//! its information with its deviation from the odometry marginalised out, and `A_i` takes a step of the rig to the
//! frame.

use veiloc_geometry::nalgebra::Matrix6;

use super::evidence::FrameContribution;
use super::frame::agreeing;
use super::joint::Poses;
use super::lens::{Refined, SharedCamera};
use super::polish::polish;
use super::search::Search;
use crate::likelihood::{
    CameraEvidence, CameraInfluence, CameraObjective, CameraVerdict, FocalPrior, FocalVerdict,
    PoseWithCamera, Symmetric6, propagated, sum,
};
use crate::options::PoseOptions;

/// What a test of the cameras shows.
#[derive(Default)]
pub(super) struct CameraTest {
    /// Whether the matches of a frame contradict its camera, and no other one was estimated.
    pub(super) is_contradicted: bool,
    /// What the matches of a single image say about its camera, if asked for.
    pub(super) evidence: Option<CameraEvidence>,
    /// What errors of a single image's camera add to the covariance of its pose.
    covariance: Option<Symmetric6>,
}

impl CameraTest {
    /// Tests the cameras of refined poses. That of a single image is estimated when it is wrong.
    pub(super) fn new(search: &mut Search<'_>, refined: &mut Refined, options: &PoseOptions) -> Self {
        if search.frames.len() > 1 {
            let is_contradicted =
                (0..search.frames.len()).any(|f| is_contradicted(search, refined, f, options));
            return Self { is_contradicted, ..Self::default() };
        }
        let SharedCamera { change, focal, verdict, .. } = refined.cameras[0];
        let (pose, noise) = (refined.polished.poses.cams[0], refined.polished.noise[0]);
        let objective = search.frames[0].camera_objective(&pose, noise);
        let here = objective.linearize(&PoseWithCamera { pose, change });
        let evidence = options.camera_evidence.then(|| objective.evidence(&here)).flatten().map(|evidence| {
            let focal_gain = match verdict {
                FocalVerdict::Wrong if focal == FocalPrior::Calibrated => {
                    let matches = search.frames[0].matches();
                    let likelihoods = search.frames[0].kernel().likelihoods(&pose, noise);
                    FocalVerdict::min_gain(matches.observations, agreeing(&likelihoods).len())
                }
                _ => verdict.suspected_gain(),
            };
            CameraEvidence { focal_gain, ..evidence }
        });
        let verdict = objective.test(&here);
        let covariance = if let CameraVerdict::Other(other) = verdict {
            let rig = search.constraints[0].rig(&other.pose);
            let start = Poses::rigid(&search.constraints, rig);
            refined.move_to(search, 0, &(start, other.change.without_distortion()), options);
            // The focal length was refined with the rest of the camera.
            refined.cameras[0].verdict = FocalVerdict::Fine;
            let pose = refined.polished.poses.cams[0];
            let at = PoseWithCamera { pose, change: refined.cameras[0].change };
            objective_of(search, refined, 0).covariance_of_estimated(&at)
        } else {
            objective.covariance(&here)
        };
        let covariance = Some(search.constraints[0].covariance_of_rig(&covariance));
        Self { is_contradicted: verdict == CameraVerdict::Contradicted, evidence, covariance }
    }

    /// What errors of the cameras add to the covariance of the rig's pose.
    pub(super) fn covariance(
        &self,
        search: &Search<'_>,
        refined: &Refined,
        contributions: &[FrameContribution<'_>],
    ) -> Symmetric6 {
        self.covariance.unwrap_or_else(|| covariance_of_several(search, refined, contributions))
    }
}

fn objective_of<'s>(search: &'s Search<'_>, refined: &Refined, f: usize) -> CameraObjective<'s> {
    search.frames[f].camera_objective(&refined.polished.poses.cams[f], refined.polished.noise[f])
}

fn covariance_of_several(
    search: &Search<'_>,
    refined: &Refined,
    contributions: &[FrameContribution<'_>],
) -> Symmetric6 {
    let information: Matrix6<f64> = contributions
        .iter()
        .zip(&search.constraints)
        .map(|(w, constraint)| {
            constraint.information_over_rig(&w.information_with_shared_errors(), &w.deviation)
        })
        .sum();
    let information = information.cholesky();
    let of_camera = |camera: &SharedCamera| {
        let (spread, force) = spread_and_force(search, refined, camera, contributions)?;
        propagated(&information.as_ref()?.solve(&force), &spread)
    };
    refined.cameras.iter().filter_map(of_camera).fold([[0.0; 6]; 6], |all, one| sum(&all, &one))
}

/// Second moment of a camera's errors, and the force on the rig by each of them; `None` when no frame determines them.
fn spread_and_force(
    search: &Search<'_>,
    refined: &Refined,
    camera: &SharedCamera,
    contributions: &[FrameContribution<'_>],
) -> Option<(Matrix6<f64>, Matrix6<f64>)> {
    let mut force = Matrix6::zeros();
    let mut evidence = Vec::with_capacity(camera.frames.len());
    for &f in &camera.frames {
        let at = PoseWithCamera { pose: refined.polished.poses.cams[f], change: camera.change };
        let influence = objective_of(search, refined, f).linearize(&at).influence;
        let Some(CameraInfluence { pose_by_camera, evidence: mut of_frame }) = influence else { continue };
        let (w, constraint) = (&contributions[f], &search.constraints[f]);
        of_frame.shared_variance /= w.share();
        let information = w.information_with_shared_errors();
        force += constraint.force_over_rig(&information, &w.deviation, &pose_by_camera);
        evidence.push(of_frame);
    }
    let objective = objective_of(search, refined, *camera.frames.first()?);
    Some((objective.assumed_spread(&CameraEvidence::of_all(&evidence), &camera.change)?, force))
}

/// Whether the matches of a frame contradict its camera, at the frame's own best pose. Those of a frame that contradicts
/// the other frames say nothing: fewer agree with the joint pose than with another one.
fn is_contradicted(search: &Search<'_>, refined: &Refined, f: usize, options: &PoseOptions) -> bool {
    let frame = &search.frames[f];
    let (joint, noise) = (&refined.polished.poses.cams[f], refined.polished.noise[f]);
    let (frames, fixed) = (std::slice::from_ref(frame), [search.constraints[f].rigid()]);
    let alone = polish(frames, &fixed, &Poses::rigid(&fixed, fixed[0].rig(joint)), options);
    let (own, own_noise) = (alone.poses.cams[0], alone.noise[0]);
    let agreeing = |cam, noise| agreeing(&frame.kernel().likelihoods(cam, noise)).len();
    2 * agreeing(joint, noise) >= agreeing(&own, own_noise) && {
        let objective = frame.camera_objective(&own, own_noise);
        let at = PoseWithCamera { pose: own, change: refined.camera_of(f).change };
        objective.test(&objective.linearize(&at)) != CameraVerdict::Fine
    }
}
