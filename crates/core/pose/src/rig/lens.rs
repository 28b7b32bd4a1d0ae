//! The cameras of the images: the given focal lengths, or others that the matches make likelier.
//!
//! A wrong focal length can be detected: the projections of right matches miss by amounts that grow towards the image's
//! border, and no pose compensates for this unless the scene is flat. All frames of one camera share it: one frame may have
//! too few matches to contradict its focal length, and several frames that see different points have enough. It is
//! refined with the poses when it is unknown or contradicted by the matches; larger jumps are tried too, because a wrong
//! focal length may have led to poses at which no small change improves the likelihood.

use super::frame::{Frame, agreeing};
use super::joint::{Linearized, Poses};
use super::odometry::OdometryConstraint;
use super::polish::{Polished, polish};
use super::search::Search;
use crate::likelihood::{
    CameraChange, Convergence, Correspondences, FocalPrior, FocalTest, FocalVerdict, Objective, POSE,
    POSE_AND_FOCAL, PoseWithCamera, levenberg_marquardt,
};
use crate::options::PoseOptions;

/// Jumps that are tried, relative to the current focal length.
const JUMPS: [f64; 2] = [0.94, 1.06];

/// Maximum number of jumps.
const MAX_JUMPS: usize = 4;

/// Log likelihood that a jump must gain in addition to the gain required of a small change: it may have found another
/// optimum.
pub(crate) const JUMP_HANDICAP: f64 = 2.5;

/// Log evidence above which a pose whose focal length is consistent, or nearly, is not a false optimum of a wrong focal
/// length: those had 350.
const UNAMBIGUOUS_LOG_EVIDENCE: f64 = 800.0;

/// Iterations that alternate between focal length and noise.
const MAX_ROUNDS: usize = 3;

/// A camera that took one frame or more.
#[derive(Debug, Clone)]
pub(super) struct SharedCamera {
    /// Its frames, of those with correspondences.
    pub(super) frames: Vec<usize>,
    /// How well its focal length is known.
    pub(super) focal: FocalPrior,
    /// How it differs from the given one.
    pub(super) change: CameraChange,
    /// The verdict on the given focal length; [`FocalVerdict::Wrong`] when another was estimated.
    pub(super) verdict: FocalVerdict,
    /// Gain of another focal length from which on it speaks against the given one in the map: what the map's cameras cause,
    /// they cause in each frame.
    pub(super) min_gain_of_map: f64,
}

impl SharedCamera {
    /// The cameras of these frames, in order of their first frames. `factor` is the search's factor on the focal
    /// lengths that are known worst.
    fn all(frames: &[Frame<'_>], factor: f64) -> Vec<Self> {
        let worst = worst_known(frames.iter().map(Frame::focal));
        let mut cameras: Vec<Self> = Vec::new();
        for (i, frame) in frames.iter().enumerate() {
            let min_gain_of_map = frame.problem.map_cameras.min_focal_gain;
            let known = cameras
                .iter_mut()
                .find(|of| of.focal == frame.focal() && frames[of.frames[0]].camera() == frame.camera());
            if let Some(camera) = known {
                camera.frames.push(i);
                camera.min_gain_of_map += min_gain_of_map;
            } else {
                let factor = if frame.focal() == worst { factor } else { 1.0 };
                cameras.push(Self {
                    frames: vec![i],
                    focal: frame.focal(),
                    change: CameraChange::of_focal(factor),
                    verdict: FocalVerdict::Fine,
                    min_gain_of_map,
                });
            }
        }
        cameras
    }

    /// Prior standard deviation of the logarithm of its focal length; `None` when it was not estimated.
    pub(super) fn estimated_sd(&self) -> Option<f64> {
        (self.verdict == FocalVerdict::Wrong).then(|| self.focal.sd())
    }
}

/// The least certain knowledge of a focal length.
pub(crate) fn worst_known(all: impl Iterator<Item = FocalPrior>) -> FocalPrior {
    let rank = |focal: &FocalPrior| match focal {
        FocalPrior::Calibrated => 0,
        FocalPrior::Exif => 1,
        FocalPrior::Unknown => 2,
    };
    all.max_by_key(rank).unwrap_or_default()
}

/// Refined poses with their cameras. The search's frames are restricted to what these can see.
pub(super) struct Refined {
    pub(super) polished: Polished,
    pub(super) cameras: Vec<SharedCamera>,
}

impl Refined {
    /// Refines the result of a search, which multiplied the focal length by `factor`; see [`SharedCamera::all`].
    pub(super) fn new(search: &mut Search<'_>, start: &Poses, factor: f64, options: &PoseOptions) -> Self {
        for (frame, cam) in search.frames.iter_mut().zip(&start.cams) {
            frame.restrict_to_visible(cam);
        }
        let cameras = SharedCamera::all(&search.frames, factor);
        for camera in &cameras {
            search.set_camera(&camera.frames, &camera.change);
        }
        let polished = polish(&search.frames, &search.constraints, start, options);
        let mut refined = Self { polished, cameras };
        let mut remaining: Vec<usize> = (0..refined.cameras.len()).collect();
        while !remaining.is_empty() {
            let camera = remaining.remove(refined.largest_gain_index(search, &remaining));
            refined.estimate_focal(search, camera, options);
            let SharedCamera { focal, verdict, .. } = refined.cameras[camera];
            if focal == FocalPrior::Calibrated && verdict == FocalVerdict::Wrong {
                refined.test_again(search, camera, options);
            }
        }
        refined
    }

    /// The camera of a frame.
    pub(super) fn camera_of(&self, frame: usize) -> &SharedCamera {
        let of = self.cameras.iter().find(|camera| camera.frames.contains(&frame));
        of.expect("every frame has a camera")
    }

    /// Index of the camera with the largest gain when its focal length is free: a wrong focal length distorts the poses,
    /// and makes the others seem wrong as well.
    fn largest_gain_index(&self, search: &Search<'_>, cameras: &[usize]) -> usize {
        if cameras.len() < 2 {
            return 0;
        }
        let cost = |camera: &usize| {
            let objective = self.objective(search, *camera);
            let at = objective.refine((self.polished.poses.clone(), self.cameras[*camera].change));
            objective.linearize(&at).loss
        };
        let costs: Vec<f64> = cameras.iter().map(cost).collect();
        (0..cameras.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b])).unwrap_or(0)
    }

    /// Tests one camera's focal length, and estimates it when it is wrong.
    fn estimate_focal(&mut self, search: &mut Search<'_>, camera: usize, options: &PoseOptions) {
        let SharedCamera { focal, change, .. } = self.cameras[camera];
        let is_open = focal != FocalPrior::Calibrated || change != CameraChange::default();
        self.cameras[camera].verdict = if is_open {
            FocalVerdict::Wrong
        } else {
            self.objective(search, camera).verdict(&self.polished.poses)
        };
        for _ in 0..MAX_JUMPS {
            if self.cameras[camera].verdict == FocalVerdict::Wrong {
                for _ in 0..MAX_ROUNDS {
                    let from = (self.polished.poses.clone(), self.cameras[camera].change);
                    let refined = self.objective(search, camera).refine(from);
                    self.move_to(search, camera, &refined, options);
                }
            }
            let cost = search.raw_cost(&self.polished.poses);
            if self.cameras[camera].verdict.is_near() && cost < -UNAMBIGUOUS_LOG_EVIDENCE {
                break;
            }
            let Some((there, gain)) = self.best_jump(search, camera, cost) else { break };
            if self.cameras[camera].verdict == FocalVerdict::Wrong {
                // It is open: the likelihood decides.
                if gain <= FocalVerdict::min_gain_of([]) {
                    break;
                }
            } else {
                let effect = self.objective(search, camera).design_effect(&there);
                match FocalVerdict::of(gain / effect, &of_rig(&there), self.min_gain(search, camera)) {
                    FocalVerdict::Wrong => self.cameras[camera].verdict = FocalVerdict::Wrong,
                    suspicious @ FocalVerdict::Suspicious { .. } => {
                        if self.cameras[camera].verdict == FocalVerdict::Fine {
                            self.cameras[camera].verdict = suspicious;
                        }
                        break;
                    }
                    FocalVerdict::Fine => break,
                }
            }
            self.move_to(search, camera, &there, options);
        }
    }

    /// Returns to the given focal length if the errors of the map's own cameras explain the matches about as well as the
    /// other one. They are tried in each frame by itself; the share of the gain that is left there is left of the gain
    /// of all frames together.
    fn test_again(&mut self, search: &mut Search<'_>, camera: usize, options: &PoseOptions) {
        let SharedCamera { change, min_gain_of_map, ref frames, .. } = self.cameras[camera];
        let test = |f: usize, is_map_exact| {
            let (cam, noise) = (self.polished.poses.cams[f], self.polished.noise[f]);
            let at = PoseWithCamera { pose: cam, change };
            search.frames[f].camera_objective(&cam, noise).focal_test(&at, is_map_exact)
        };
        if search.frames.len() == 1 {
            let FocalTest { gain, agreeing, other, pose_of_given } = test(0, false);
            let min_gain = FocalVerdict::min_gain(search.frames[0].matches().observations, agreeing);
            let verdict = FocalVerdict::of(gain, &other, min_gain.max(min_gain_of_map));
            if verdict != FocalVerdict::Wrong {
                let given = Poses::rigid(&search.constraints, search.constraints[0].rig(&pose_of_given));
                self.move_to(search, camera, &(given, CameraChange::default()), options);
                self.cameras[camera].verdict = verdict;
            }
            return;
        }
        let gain_of_all =
            |is_map_exact| -> f64 { frames.iter().map(|&f| test(f, is_map_exact).gain.max(0.0)).sum() };
        let [left, all] = [false, true].map(gain_of_all);
        // The frames say nothing by themselves, or the map's cameras are nearly exact.
        if left >= all {
            return;
        }
        let open = (self.polished.poses.clone(), change);
        let loss_of_open = self.objective(search, camera).linearize(&open).loss;
        let given = (open.0.clone(), CameraChange::default());
        self.move_to(search, camera, &given, options);
        let objective = self.objective(search, camera);
        let here = (self.polished.poses.clone(), CameraChange::default());
        let gain = (objective.linearize(&here).loss - loss_of_open) / objective.design_effect(&open);
        match FocalVerdict::of(gain * left / all, &of_rig(&open), self.min_gain(search, camera)) {
            FocalVerdict::Wrong => self.move_to(search, camera, &open, options),
            verdict => self.cameras[camera].verdict = verdict,
        }
    }

    pub(super) fn move_to(
        &mut self,
        search: &mut Search<'_>,
        camera: usize,
        (poses, change): &PosesWithCamera,
        options: &PoseOptions,
    ) {
        self.cameras[camera].change = *change;
        search.set_camera(&self.cameras[camera].frames, change);
        self.polished = polish(&search.frames, &search.constraints, poses, options);
    }

    /// The jump with the largest gain over the cost `own`, and this gain.
    fn best_jump(&self, search: &mut Search<'_>, camera: usize, own: f64) -> Option<(PosesWithCamera, f64)> {
        let SharedCamera { frames, change: now, .. } = &self.cameras[camera];
        let jumps = JUMPS.map(|jump| {
            let change = CameraChange::of_focal(jump * now.factor());
            search.set_camera(frames, &change);
            let poses = search.descend(&self.polished.poses);
            let gain = own - search.raw_cost(&poses) - JUMP_HANDICAP;
            ((poses, change), gain)
        });
        search.set_camera(frames, now);
        jumps.into_iter().reduce(|best, next| if next.1 > best.1 { next } else { best })
    }

    /// Required gain of another focal length before a calibrated one is called wrong.
    fn min_gain(&self, search: &Search<'_>, camera: usize) -> f64 {
        let of = |&i: &usize| {
            let frame = &search.frames[i];
            let likelihoods =
                frame.kernel().likelihoods(&self.polished.poses.cams[i], self.polished.noise[i]);
            (frame.matches().observations, agreeing(&likelihoods).len())
        };
        let camera = &self.cameras[camera];
        FocalVerdict::min_gain_of(camera.frames.iter().map(of)).max(camera.min_gain_of_map)
    }

    fn objective<'s>(&self, search: &'s Search<'_>, camera: usize) -> FocalObjective<'s> {
        let of = |(i, frame): (usize, &'s Frame<'_>)| FrameObjective {
            objective: frame.objective(&self.polished.poses.cams[i], self.polished.noise[i]),
            fixed: (!self.cameras[camera].frames.contains(&i)).then(|| self.camera_of(i).change),
        };
        FocalObjective {
            frames: search.frames.iter().enumerate().map(of).collect(),
            constraints: &search.constraints,
            focal: self.cameras[camera].focal,
        }
    }
}

/// The rig's pose with a camera, in the type for that of an image.
fn of_rig((poses, change): &PosesWithCamera) -> PoseWithCamera {
    let pose = veiloc_geometry::CameraFromWorld::new(*poses.rig.rotation(), *poses.rig.translation());
    PoseWithCamera { pose, change: *change }
}

type PosesWithCamera = (Poses, CameraChange);

/// The objective when the focal length of one camera is free.
struct FocalObjective<'a> {
    frames: Vec<FrameObjective<'a>>,
    constraints: &'a [OdometryConstraint],
    focal: FocalPrior,
}

struct FrameObjective<'a> {
    objective: Objective<'a>,
    /// The camera, for frames of another one.
    fixed: Option<CameraChange>,
}

impl FocalObjective<'_> {
    /// The likelihood's verdict on the given focal length, at the optimum for it: one linearized step decides whether
    /// to refine. The refinement is necessary because matches that the wrong focal length lost return only during it.
    fn verdict(&self, poses: &Poses) -> FocalVerdict {
        let given = (poses.clone(), CameraChange::default());
        let here = self.linearize(&given);
        let Some(step) = here.damped_step(self.constraints, 0.0) else { return FocalVerdict::Fine };
        if !FocalVerdict::warrants_refinement(step.promised) {
            return FocalVerdict::Fine;
        }
        let there = self.refine(given.clone());
        let gain = (here.loss - self.linearize(&there).loss) / self.design_effect(&there);
        let least = FocalVerdict::min_gain_of(
            self.own(&given).map(|(observations, agreeing, _)| (observations, agreeing)),
        );
        FocalVerdict::of(gain, &of_rig(&there), least)
    }

    /// The frames of the camera: their observations, how many agree, and their design effect.
    fn own(&self, (poses, change): &PosesWithCamera) -> impl Iterator<Item = (&Correspondences, usize, f64)> {
        let frames = self.frames.iter().zip(&poses.cams).filter(|(frame, _)| frame.fixed.is_none());
        frames.map(move |(frame, cam)| {
            let scores = frame.objective.scores(&PoseWithCamera { pose: *cam, change: *change });
            (frame.objective.matches.observations, scores.agreeing, scores.cells.design_effect())
        })
    }

    /// Mean design effect of the frames with this camera, by their numbers of agreeing matches.
    fn design_effect(&self, at: &PosesWithCamera) -> f64 {
        let (all, weighted) = self.own(at).fold((0.0, 0.0), |(all, weighted), (_, agreeing, effect)| {
            (all + agreeing as f64, weighted + agreeing as f64 * effect)
        });
        if all > 0.0 { weighted / all } else { 1.0 }
    }

    /// Levenberg–Marquardt from a start; never returns a larger loss than the start's.
    fn refine(&self, start: PosesWithCamera) -> PosesWithCamera {
        let step = |(poses, change): &PosesWithCamera, here: &Linearized<POSE_AND_FOCAL>, damping| {
            let step = here.damped_step(self.constraints, damping)?;
            let change = change.moved(step.of_camera())?;
            Some(((poses.moved(self.constraints, &step), change), f64::INFINITY))
        };
        let look = |at: &PosesWithCamera| self.linearize(at);
        levenberg_marquardt(start, Convergence::OF_FOCAL, look, |here| here.loss, step).at
    }

    fn linearize(&self, (poses, change): &PosesWithCamera) -> Linearized<POSE_AND_FOCAL> {
        // The prior of a focal length counts once, however many frames it has.
        let first = self.frames.iter().position(|frame| frame.fixed.is_none());
        Linearized::new(poses, self.constraints, |i, cam| {
            let FrameObjective { objective, fixed } = &self.frames[i];
            let at = PoseWithCamera { pose: *cam, change: fixed.unwrap_or(*change) };
            let mut system = objective.linearize::<POSE_AND_FOCAL>(&at);
            if fixed.is_some() {
                system.gradient[POSE] = 0.0;
                system.hessian.row_mut(POSE).fill(0.0);
                system.hessian.column_mut(POSE).fill(0.0);
            }
            if first == Some(i) { system.with_camera_prior(change, &self.focal.free_sd()) } else { system }
        })
    }
}
