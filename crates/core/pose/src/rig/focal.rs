//! The focal length of a rig's images: a seventh parameter that all frames of one camera share.
//!
//! Does for the frames of one [`Lens`] what `focal_search.rs` does for one image, with the poses of all frames and
//! their odometry constraints free: the arrowhead normal equations of `joint.rs` with one more row.
//!
//! ```text
//! | B_i              -W_i A_i            h_i      | | δ_i |   | -g_i - W_i r_i |
//! | -A_iᵀ W_i        Σ A_iᵀ W_i A_i                | |  ε  | = |  Σ A_iᵀ W_i r_i |
//! | h_iᵀ                                 Σ H_φφ    | |  φ  |   | -Σ g_φ          |
//! ```
//!
//! One frame may have too few matches to contradict its focal length; several frames that see different points have
//! enough. The estimated focal length applies to all frames of a camera.

use crate::likelihood::{
    Convergence, FocalObjective, FocalPrior, FocalSystem, FocalVerdict, PoseWithFocal, levenberg_marquardt,
    step_focal,
};
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Cholesky, Const, Matrix6, SMatrix, SVector, Vector6};

use super::RigFrame;
use super::frame::Frame;
use super::joint::{Poses, Step};
use super::odometry::{Deviation, OdometryConstraint};
use super::polish::{PolishedRig, polish};
use super::search::RigSearch;
use crate::focal_search::{JUMP_HANDICAP, JUMPS, MAX_JUMPS, MAX_ROUNDS, UNAMBIGUOUS_LOG_EVIDENCE};
use crate::options::PoseOptions;

/// A camera that took one frame or more, with common intrinsics.
#[derive(Debug, Clone)]
pub(super) struct Lens {
    /// Its frames, of those with correspondences.
    pub(super) frames: Vec<usize>,
    /// How well its focal length is known.
    pub(super) focal: FocalPrior,
    /// Its focal length relative to the given one.
    pub(super) factor: f64,
    /// The verdict on the given one; [`FocalVerdict::Wrong`] when another was estimated.
    pub(super) verdict: FocalVerdict,
}

impl Lens {
    /// The cameras of these frames, in order of their first frames. `factor` is the search's factor on the focal
    /// lengths that are known worst.
    pub(super) fn all(frames: &[Frame<'_>], factor: f64) -> Vec<Self> {
        let worst = worst_known(frames.iter().map(|frame| frame.focal));
        let mut lenses: Vec<Self> = Vec::new();
        for (i, frame) in frames.iter().enumerate() {
            let camera = &frame.given.camera;
            let known = lenses
                .iter_mut()
                .find(|l| l.focal == frame.focal && frames[l.frames[0]].given.camera == *camera);
            match known {
                Some(lens) => lens.frames.push(i),
                None => lenses.push(Self {
                    frames: vec![i],
                    focal: frame.focal,
                    factor: if frame.focal == worst { factor } else { 1.0 },
                    verdict: FocalVerdict::Fine,
                }),
            }
        }
        lenses
    }

    /// Prior standard deviation of the logarithm of its focal length; `None` when it was not estimated.
    pub(super) fn estimated_sd(&self) -> Option<f64> {
        (self.verdict == FocalVerdict::Wrong).then(|| self.focal.sd())
    }
}

/// The least certain knowledge of a focal length.
pub(super) fn worst_known(all: impl Iterator<Item = FocalPrior>) -> FocalPrior {
    let rank = |focal: &FocalPrior| match focal {
        FocalPrior::Calibrated => 0,
        FocalPrior::Exif => 1,
        FocalPrior::Unknown => 2,
    };
    all.max_by_key(rank).unwrap_or_default()
}

/// Refined poses with their focal lengths. The search's frames are restricted to what these can see.
pub(super) struct RefinedRig {
    pub(super) polished: PolishedRig,
    pub(super) lenses: Vec<Lens>,
}

/// Refines the result of the search, which multiplied the focal length by `factor`; see [`Lens::all`].
///
/// `given` are the frames as the caller gave them.
pub(super) fn refine_focal_lengths(
    search: &mut RigSearch<'_>,
    start: &Poses,
    factor: f64,
    given: &[RigFrame],
    options: &PoseOptions,
) -> RefinedRig {
    let lenses = Lens::all(&search.frames, factor);
    for (i, cam) in start.cams.iter().enumerate() {
        let of_frame = lenses.iter().find(|lens| lens.frames.contains(&i)).map_or(1.0, |lens| lens.factor);
        search.frames[i].restrict_to_visible(cam);
        search.frames[i].set_focal(of_frame);
    }
    let polished = polish(&search.frames, &search.constraints, start, options);
    let mut refined = RefinedRig { polished, lenses };
    let mut remaining: Vec<usize> = (0..refined.lenses.len()).collect();
    while !remaining.is_empty() {
        let lens = remaining.remove(refined.largest_gain_index(search, &remaining));
        refined.estimate_focal(search, lens, options);
        let Lens { focal, verdict, .. } = refined.lenses[lens];
        if focal == FocalPrior::Calibrated && verdict == FocalVerdict::Wrong {
            refined.test_again(search, lens, given, options);
        }
    }
    refined
}

impl RefinedRig {
    /// Index of the lens with the largest gain when its focal length is free: a wrong focal length distorts the poses,
    /// and makes the others seem wrong as well.
    fn largest_gain_index(&self, search: &RigSearch<'_>, lenses: &[usize]) -> usize {
        if lenses.len() < 2 {
            return 0;
        }
        let cost = |lens: &usize| {
            let objective = self.objective(search, *lens);
            let (poses, factor) = objective.refine((self.polished.poses.clone(), self.lenses[*lens].factor));
            objective.linearize(&poses, factor).loss
        };
        let costs: Vec<f64> = lenses.iter().map(cost).collect();
        (0..lenses.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b])).unwrap_or(0)
    }

    /// Tests one lens' focal length, and estimates it when it is wrong.
    fn estimate_focal(&mut self, search: &mut RigSearch<'_>, lens: usize, options: &PoseOptions) {
        let is_open = self.lenses[lens].focal != FocalPrior::Calibrated || self.lenses[lens].factor != 1.0;
        self.lenses[lens].verdict = if is_open {
            FocalVerdict::Wrong
        } else {
            self.objective(search, lens).verdict(&self.polished.poses)
        };
        for _ in 0..MAX_JUMPS {
            if self.lenses[lens].verdict == FocalVerdict::Wrong {
                for _ in 0..MAX_ROUNDS {
                    let from = (self.polished.poses.clone(), self.lenses[lens].factor);
                    let (poses, factor) = self.objective(search, lens).refine(from);
                    self.move_to(search, lens, &poses, factor, options);
                }
            }
            let cost = search.raw_cost(&self.polished.poses);
            if self.lenses[lens].verdict.is_near() && cost < -UNAMBIGUOUS_LOG_EVIDENCE {
                break;
            }
            let Some((poses, factor, gain)) = self.best_jump(search, lens, cost) else { break };
            if self.lenses[lens].verdict == FocalVerdict::Wrong {
                // It is open: the likelihood decides.
                if gain <= FocalVerdict::min_gain_of([]) {
                    break;
                }
            } else {
                let effect = {
                    let objective = self.objective(search, lens);
                    objective.design_effect(&objective.linearize(&poses, factor))
                };
                match FocalVerdict::of(gain / effect, &of_rig(&poses, factor), self.min_gain(search, lens)) {
                    FocalVerdict::Wrong => self.lenses[lens].verdict = FocalVerdict::Wrong,
                    suspicious @ FocalVerdict::Suspicious { .. } => {
                        if self.lenses[lens].verdict == FocalVerdict::Fine {
                            self.lenses[lens].verdict = suspicious;
                        }
                        break;
                    }
                    FocalVerdict::Fine => break,
                }
            }
            self.move_to(search, lens, &poses, factor, options);
        }
    }

    /// Returns to the given focal length if the errors of the map's own cameras explain the matches about as well as the
    /// other one. They are tried in each frame by itself; the share of the gain that is left there is left of the gain
    /// of all frames together.
    fn test_again(
        &mut self,
        search: &mut RigSearch<'_>,
        lens: usize,
        given: &[RigFrame],
        options: &PoseOptions,
    ) {
        let factor = self.lenses[lens].factor;
        let mut gains = [0.0; 2];
        for &f in &self.lenses[lens].frames {
            let (frame, cam, noise) =
                (&search.frames[f], self.polished.poses.cams[f], self.polished.noise[f]);
            let objective = frame.camera_objective(given, &cam, noise);
            let of_frame = objective.focal_gains(&PoseWithFocal { pose: cam, factor });
            gains = [0, 1].map(|k| gains[k] + of_frame[k].max(0.0));
        }
        let [left, all] = gains;
        // The frames say nothing by themselves, or the map's cameras are nearly exact.
        if left >= all {
            return;
        }
        let open = self.polished.poses.clone();
        let found = {
            let objective = self.objective(search, lens);
            objective.linearize(&open, factor)
        };
        self.move_to(search, lens, &open, 1.0, options);
        let (gain, min_gain) = {
            let objective = self.objective(search, lens);
            let here = objective.linearize(&self.polished.poses, 1.0);
            ((here.loss - found.loss) / objective.design_effect(&found), self.min_gain(search, lens))
        };
        match FocalVerdict::of(gain * left / all, &of_rig(&open, factor), min_gain) {
            FocalVerdict::Wrong => self.move_to(search, lens, &open, factor, options),
            verdict => self.lenses[lens].verdict = verdict,
        }
    }

    fn move_to(
        &mut self,
        search: &mut RigSearch<'_>,
        lens: usize,
        poses: &Poses,
        factor: f64,
        options: &PoseOptions,
    ) {
        self.lenses[lens].factor = factor;
        search.set_focal(&self.lenses[lens].frames, factor);
        self.polished = polish(&search.frames, &search.constraints, poses, options);
    }

    /// The jump with the largest gain over the cost `own`, and this gain.
    fn best_jump(&self, search: &mut RigSearch<'_>, lens: usize, own: f64) -> Option<(Poses, f64, f64)> {
        let Lens { frames, factor: now, .. } = &self.lenses[lens];
        let mut best: Option<(Poses, f64, f64)> = None;
        for jump in JUMPS {
            let factor = jump * now;
            search.set_focal(frames, factor);
            let poses = search.descend(&self.polished.poses);
            let gain = own - search.raw_cost(&poses) - JUMP_HANDICAP;
            if best.as_ref().is_none_or(|(_, _, known)| gain > *known) {
                best = Some((poses, factor, gain));
            }
        }
        search.set_focal(frames, *now);
        best
    }

    /// Required gain of another focal length before a calibrated one is called wrong.
    fn min_gain(&self, search: &RigSearch<'_>, lens: usize) -> f64 {
        let agreeing = |&i: &usize| {
            let search = &search.frames[i].search;
            let likelihoods =
                search.kernel().likelihoods(&self.polished.poses.cams[i], self.polished.noise[i]);
            (search.matches().observations, likelihoods.iter().filter(|llr| **llr > 0.0).count())
        };
        FocalVerdict::min_gain_of(self.lenses[lens].frames.iter().map(agreeing))
    }

    fn objective<'s, 'a>(&self, search: &'s RigSearch<'a>, lens: usize) -> RigFocalObjective<'s> {
        let of = |(i, frame): (usize, &'s Frame<'a>)| {
            let own = self.lenses.iter().find(|l| l.frames.contains(&i)).unwrap_or(&self.lenses[lens]);
            let (cam, noise) = (&self.polished.poses.cams[i], self.polished.noise[i]);
            // The prior of a focal length counts once, however many frames it has.
            let is_first = self.lenses[lens].frames.first() == Some(&i);
            let objective = FocalObjective {
                matches: &frame.seen,
                priors: frame.search.priors().clone(),
                active: frame.search.possible(cam, noise),
                noise,
                sd: if is_first { self.lenses[lens].focal.sd() } else { f64::INFINITY },
            };
            FrameWithFocal {
                objective,
                fixed: (!self.lenses[lens].frames.contains(&i)).then_some(own.factor),
            }
        };
        RigFocalObjective {
            frames: search.frames.iter().enumerate().map(of).collect(),
            constraints: &search.constraints,
        }
    }
}

/// The rig's pose with a focal length, in the type for a camera's.
fn of_rig(poses: &Poses, factor: f64) -> PoseWithFocal {
    PoseWithFocal { pose: CameraFromWorld::new(*poses.rig.rotation(), *poses.rig.translation()), factor }
}

/// The objective when the focal length of one lens is free.
struct RigFocalObjective<'a> {
    frames: Vec<FrameWithFocal<'a>>,
    constraints: &'a [OdometryConstraint],
}

struct FrameWithFocal<'a> {
    objective: FocalObjective<'a>,
    /// The relative focal length, for frames of another lens.
    fixed: Option<f64>,
}

struct Linearized {
    systems: Vec<FocalSystem>,
    deviations: Vec<Deviation>,
    loss: f64,
}

/// A step of all poses and of the logarithm of the focal length, with the gain predicted by the quadratic model.
struct FocalStep {
    poses: Step,
    log_focal: f64,
}

/// One frame's six unknowns, eliminated: its own system, its step for fixed rig and focal length, and its derivative by
/// the focal length.
struct Eliminated {
    own: Cholesky<f64, Const<6>>,
    alone: Vector6<f64>,
    bent: Vector6<f64>,
}

impl RigFocalObjective<'_> {
    /// The likelihood's verdict on the given focal length, at the optimum for it: one linearized step decides whether
    /// to refine.
    fn verdict(&self, poses: &Poses) -> FocalVerdict {
        let here = self.linearize(poses, 1.0);
        let Some(step) = self.solved(&here, 0.0) else { return FocalVerdict::Fine };
        if !FocalVerdict::warrants_refinement(step.poses.promised, step.log_focal) {
            return FocalVerdict::Fine;
        }
        let (there, factor) = self.refine((poses.clone(), 1.0));
        let found = self.linearize(&there, factor);
        let gain = (here.loss - found.loss) / self.design_effect(&found);
        let agreeing = self.frames.iter().zip(&here.systems).filter(|(frame, _)| frame.fixed.is_none());
        let least =
            FocalVerdict::min_gain_of(agreeing.map(|(f, s)| (f.objective.matches.observations, s.agreeing)));
        FocalVerdict::of(gain, &of_rig(&there, factor), least)
    }

    /// Mean design effect of the frames with this focal length, by their numbers of agreeing matches.
    fn design_effect(&self, at: &Linearized) -> f64 {
        let own = || self.frames.iter().zip(&at.systems).filter(|(frame, _)| frame.fixed.is_none());
        let agreeing: usize = own().map(|(_, system)| system.agreeing).sum();
        let weighted = own().map(|(_, system)| system.agreeing as f64 * system.cells.design_effect());
        if agreeing > 0 { weighted.sum::<f64>() / agreeing as f64 } else { 1.0 }
    }

    /// Levenberg–Marquardt from a start; never returns a larger loss than the start's.
    fn refine(&self, start: (Poses, f64)) -> (Poses, f64) {
        let step = |(poses, factor): &(Poses, f64), here: &Linearized, damping| {
            let step = self.solved(here, damping)?;
            let factor = step_focal(*factor, step.log_focal)?;
            Some(((poses.moved(self.constraints, &step.poses), factor), f64::INFINITY))
        };
        let look = |(poses, factor): &(Poses, f64)| self.linearize(poses, *factor);
        levenberg_marquardt(start, Convergence::OF_FOCAL, look, |here| here.loss, step).at
    }

    fn linearize(&self, poses: &Poses, factor: f64) -> Linearized {
        let system = |(frame, cam): (&FrameWithFocal<'_>, &CameraFromWorld)| {
            let at = PoseWithFocal { pose: *cam, factor: frame.fixed.unwrap_or(factor) };
            let mut system = frame.objective.linearize(&at);
            if frame.fixed.is_some() {
                system.gradient[6] = 0.0;
                system.hessian.row_mut(6).fill(0.0);
                system.hessian.column_mut(6).fill(0.0);
            }
            system
        };
        let systems: Vec<FocalSystem> = self.frames.iter().zip(&poses.cams).map(system).collect();
        let deviations = poses.deviations(self.constraints);
        let loss =
            systems.iter().map(|s| s.loss).sum::<f64>() + deviations.iter().map(|p| p.loss).sum::<f64>();
        Linearized { systems, deviations, loss }
    }

    fn solved(&self, here: &Linearized, damping: f64) -> Option<FocalStep> {
        let damped = |mut h: Matrix6<f64>| {
            for k in 0..6 {
                h[(k, k)] += damping * h[(k, k)].max(1e-12);
            }
            h
        };
        // Of the rig's six numbers and the focal length.
        let (mut hessian, mut gradient) = (SMatrix::<f64, 7, 7>::zeros(), SVector::<f64, 7>::zeros());
        let mut eliminated: Vec<Option<Eliminated>> = Vec::new();
        for ((constraint, system), deviation) in
            self.constraints.iter().zip(&here.systems).zip(&here.deviations)
        {
            let own: Matrix6<f64> = system.hessian.fixed_view::<6, 6>(0, 0).into();
            let by_focal: Vector6<f64> = system.hessian.fixed_view::<6, 1>(0, 6).into();
            let slope: Vector6<f64> = system.gradient.fixed_rows::<6>(0).into();
            let (of_rig, across, rest);
            if constraint.is_rigid() {
                of_rig = (constraint.over_rig(&own), constraint.gradient_over_rig(&slope));
                across = constraint.gradient_over_rig(&by_focal);
                rest = (system.hessian[(6, 6)], system.gradient[6]);
                eliminated.push(None);
            } else {
                let w = Matrix6::from_diagonal(&deviation.precision);
                let strain = deviation.precision.component_mul(&deviation.step);
                let own = (damped(own) + w).cholesky()?;
                let alone = own.solve(&-(slope + strain));
                let bent = own.solve(&by_focal);
                let held = w - w * own.solve(&w);
                of_rig = (constraint.over_rig(&held), -constraint.gradient_over_rig(&(strain + w * alone)));
                across = constraint.gradient_over_rig(&(w * bent));
                rest =
                    (system.hessian[(6, 6)] - by_focal.dot(&bent), system.gradient[6] + by_focal.dot(&alone));
                eliminated.push(Some(Eliminated { own, alone, bent }));
            }
            let mut block = hessian.fixed_view_mut::<6, 6>(0, 0);
            block += of_rig.0;
            let mut first = gradient.fixed_rows_mut::<6>(0);
            first += of_rig.1;
            for k in 0..6 {
                hessian[(k, 6)] += across[k];
                hessian[(6, k)] += across[k];
            }
            hessian[(6, 6)] += rest.0;
            gradient[6] += rest.1;
        }
        for k in 0..7 {
            hessian[(k, k)] += damping * hessian[(k, k)].max(1e-12);
        }
        let tip = hessian.cholesky()?.solve(&-gradient);
        let (rig, log_focal): (Vector6<f64>, f64) = (tip.fixed_rows::<6>(0).into(), tip[6]);
        let mut slope = 0.0;
        let mut cams = Vec::with_capacity(self.constraints.len());
        let parts = self.constraints.iter().zip(&here.systems).zip(&here.deviations).zip(&eliminated);
        for (((constraint, system), deviation), eliminated) in parts {
            let carried = constraint.carried(&rig);
            let cam = match eliminated {
                None => carried,
                Some(Eliminated { own, alone, bent }) => {
                    let strain = deviation.precision.component_mul(&deviation.step);
                    let pulled = own.solve(&deviation.precision.component_mul(&carried));
                    let cam = alone + pulled - bent * log_focal;
                    slope += strain.dot(&(cam - carried));
                    cam
                }
            };
            slope += system.gradient.fixed_rows::<6>(0).dot(&cam) + system.gradient[6] * log_focal;
            cams.push(cam);
        }
        let finite = tip.iter().chain(cams.iter().flat_map(Vector6::iter)).all(|s| s.is_finite());
        finite.then_some(FocalStep { poses: Step { rig, cams, promised: -0.5 * slope }, log_focal })
    }
}
