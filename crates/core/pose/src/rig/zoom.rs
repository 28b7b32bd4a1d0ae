//! The focal length of a rig's images: a seventh number that all frames of one camera share.
//!
//! What `focal_search.rs` does for one image is done here for the frames of one [`Lens`] together, with the poses of all
//! frames and the ties between them free: the normal equations are the arrow of `joint.rs` with one more row at its tip.
//!
//! ```text
//! | B_i              -W_i A_i            h_i      | | δ_i |   | -g_i - W_i r_i |
//! | -A_iᵀ W_i        Σ A_iᵀ W_i A_i                | |  ε  | = |  Σ A_iᵀ W_i r_i |
//! | h_iᵀ                                 Σ H_φφ    | |  φ  |   | -Σ g_φ          |
//! ```
//!
//! One frame may be too poor to contradict its focal length; several that see different things are not, and a focal length
//! that two frames of one camera would both rather have is told for all of them.

use crate::likelihood::{
    Convergence, FocalKnowledge, FocalVerdict, ZoomObjective, ZoomSystem, Zoomed, levenberg_marquardt,
    stretched,
};
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Cholesky, Const, Matrix6, SMatrix, SVector, Vector6};

use super::frame::Frame;
use super::joint::{Poses, Step};
use super::odometry::{Pull, Tie};
use super::polish::{PolishedRig, polish};
use super::search::RigSearch;
use crate::focal_search::{JUMP_HANDICAP, JUMPS, MOST_JUMPS, PLENTY, ROUNDS};
use crate::options::PoseOptions;

/// A camera that took one frame or more: what is given of it is the same for all of them.
#[derive(Debug, Clone)]
pub(super) struct Lens {
    /// Its frames, of those that show something.
    pub(super) frames: Vec<usize>,
    /// How well its focal length is known.
    pub(super) focal: FocalKnowledge,
    /// Its focal length over the given one.
    pub(super) factor: f64,
    /// What is thought of the given one; [`FocalVerdict::Wrong`] where another was estimated.
    pub(super) verdict: FocalVerdict,
}

impl Lens {
    /// The cameras of these frames, in order of their first frames. `factor` is what the search took for the focal lengths
    /// that are known worst, over the given ones.
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

    /// Standard deviation that the logarithm of its focal length had before; `None` when it was not estimated.
    pub(super) fn estimated_sd(&self) -> Option<f64> {
        (self.verdict == FocalVerdict::Wrong).then(|| self.focal.sd())
    }
}

/// What the least is that is known of a focal length.
pub(super) fn worst_known(all: impl Iterator<Item = FocalKnowledge>) -> FocalKnowledge {
    let rank = |focal: &FocalKnowledge| match focal {
        FocalKnowledge::Calibrated => 0,
        FocalKnowledge::Exif => 1,
        FocalKnowledge::Unknown => 2,
    };
    all.max_by_key(rank).unwrap_or_default()
}

/// Refined poses, and the focal lengths that they are told with. The search's frames are as these see them.
pub(super) struct RefinedRig {
    pub(super) polished: PolishedRig,
    pub(super) lenses: Vec<Lens>,
}

/// Refines from where the search ended, which took `factor` times the focal length; see [`Lens::all`].
pub(super) fn refine_focal_lengths(
    search: &mut RigSearch<'_>,
    start: &Poses,
    factor: f64,
    options: &PoseOptions,
) -> RefinedRig {
    let lenses = Lens::all(&search.frames, factor);
    for (i, cam) in start.cams.iter().enumerate() {
        let of_frame = lenses.iter().find(|lens| lens.frames.contains(&i)).map_or(1.0, |lens| lens.factor);
        search.frames[i].see_from(cam);
        search.frames[i].zoom(of_frame);
    }
    let polished = polish(&search.frames, &search.ties, start, options);
    let mut refined = RefinedRig { polished, lenses };
    let mut unjudged: Vec<usize> = (0..refined.lenses.len()).collect();
    while !unjudged.is_empty() {
        let lens = unjudged.remove(refined.most_to_blame(search, &unjudged));
        refined.judge(search, lens, options);
    }
    refined
}

impl RefinedRig {
    /// Which of these lenses explains most when its focal length is free, its place in the list: a wrong one spoils the
    /// poses, and makes the others look wrong as well.
    fn most_to_blame(&self, search: &RigSearch<'_>, lenses: &[usize]) -> usize {
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

    /// What is to be thought of one lens' focal length, and a better one where it is wrong.
    fn judge(&mut self, search: &mut RigSearch<'_>, lens: usize, options: &PoseOptions) {
        let is_open =
            self.lenses[lens].focal != FocalKnowledge::Calibrated || self.lenses[lens].factor != 1.0;
        self.lenses[lens].verdict = if is_open {
            FocalVerdict::Wrong
        } else {
            self.objective(search, lens).verdict(&self.polished.poses)
        };
        for _ in 0..MOST_JUMPS {
            if self.lenses[lens].verdict == FocalVerdict::Wrong {
                for _ in 0..ROUNDS {
                    let from = (self.polished.poses.clone(), self.lenses[lens].factor);
                    let (poses, factor) = self.objective(search, lens).refine(from);
                    self.move_to(search, lens, &poses, factor, options);
                }
            }
            let cost = search.raw_cost(&self.polished.poses);
            if self.lenses[lens].verdict.is_near() && cost < -PLENTY {
                break;
            }
            let Some((poses, factor, gain)) = self.best_jump(search, lens, cost) else { break };
            if self.lenses[lens].verdict == FocalVerdict::Wrong {
                // It is open: it goes where the likelihood is.
                if gain <= FocalVerdict::least_gain_of([]) {
                    break;
                }
            } else {
                match FocalVerdict::of(gain, &of_rig(&poses, factor), self.least_gain(search, lens)) {
                    FocalVerdict::Wrong => self.lenses[lens].verdict = FocalVerdict::Wrong,
                    suspicious @ FocalVerdict::Suspicious(_) => {
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

    fn move_to(
        &mut self,
        search: &mut RigSearch<'_>,
        lens: usize,
        poses: &Poses,
        factor: f64,
        options: &PoseOptions,
    ) {
        self.lenses[lens].factor = factor;
        search.zoom(&self.lenses[lens].frames, factor);
        self.polished = polish(&search.frames, &search.ties, poses, options);
    }

    /// The jump that explains most, and how much more than what is said to cost `own`.
    fn best_jump(&self, search: &mut RigSearch<'_>, lens: usize, own: f64) -> Option<(Poses, f64, f64)> {
        let Lens { frames, factor: now, .. } = &self.lenses[lens];
        let mut best: Option<(Poses, f64, f64)> = None;
        for jump in JUMPS {
            let factor = jump * now;
            search.zoom(frames, factor);
            let poses = search.descend(&self.polished.poses);
            let gain = own - search.raw_cost(&poses) - JUMP_HANDICAP;
            if best.as_ref().is_none_or(|(_, _, known)| gain > *known) {
                best = Some((poses, factor, gain));
            }
        }
        search.zoom(frames, *now);
        best
    }

    /// What another focal length must gain before a calibrated one is called wrong.
    fn least_gain(&self, search: &RigSearch<'_>, lens: usize) -> f64 {
        let agreeing = |&i: &usize| {
            let search = &search.frames[i].search;
            let likelihoods =
                search.kernel().likelihoods(&self.polished.poses.cams[i], self.polished.noise[i]);
            (search.matches().observations, likelihoods.iter().filter(|llr| **llr > 0.0).count())
        };
        FocalVerdict::least_gain_of(self.lenses[lens].frames.iter().map(agreeing))
    }

    fn objective<'s, 'a>(&self, search: &'s RigSearch<'a>, lens: usize) -> RigZoom<'s> {
        let of = |(i, frame): (usize, &'s Frame<'a>)| {
            let own = self.lenses.iter().find(|l| l.frames.contains(&i)).unwrap_or(&self.lenses[lens]);
            let (cam, noise) = (&self.polished.poses.cams[i], self.polished.noise[i]);
            // What is known of a focal length before is known once, however many frames it has.
            let is_first = self.lenses[lens].frames.first() == Some(&i);
            let objective = ZoomObjective {
                matches: &frame.seen,
                priors: frame.search.priors().clone(),
                active: frame.search.possible(cam, noise),
                noise,
                sd: if is_first { self.lenses[lens].focal.sd() } else { f64::INFINITY },
            };
            ZoomedFrame { objective, fixed: (!self.lenses[lens].frames.contains(&i)).then_some(own.factor) }
        };
        RigZoom { frames: search.frames.iter().enumerate().map(of).collect(), ties: &search.ties }
    }
}

/// A focal length and the rig's pose with it, which stands where a camera's does.
fn of_rig(poses: &Poses, factor: f64) -> Zoomed {
    Zoomed { pose: CameraFromWorld::new(*poses.rig.rotation(), *poses.rig.translation()), factor }
}

/// What is minimised when the focal length of one lens is free.
struct RigZoom<'a> {
    frames: Vec<ZoomedFrame<'a>>,
    ties: &'a [Tie],
}

struct ZoomedFrame<'a> {
    objective: ZoomObjective<'a>,
    /// The focal length over the given one, for frames of another lens.
    fixed: Option<f64>,
}

struct Linearized {
    systems: Vec<ZoomSystem>,
    pulls: Vec<Pull>,
    loss: f64,
}

/// A step of all poses, of the logarithm of the focal length, and what the quadratic model gains by it.
struct ZoomStep {
    poses: Step,
    log_focal: f64,
}

/// One frame's six unknowns, eliminated: its own system, its step when rig and focal length stay, and how it bends with the
/// focal length.
struct Eliminated {
    own: Cholesky<f64, Const<6>>,
    alone: Vector6<f64>,
    bent: Vector6<f64>,
}

impl RigZoom<'_> {
    /// What the likelihood says of the given focal length, at the optimum for it: one linearized step tells whether to look,
    /// and what is there is then refined.
    fn verdict(&self, poses: &Poses) -> FocalVerdict {
        let here = self.linearize(poses, 1.0);
        let Some(step) = self.solved(&here, 0.0) else { return FocalVerdict::Fine };
        if !FocalVerdict::is_worth_a_look(step.poses.promised, step.log_focal) {
            return FocalVerdict::Fine;
        }
        let (there, factor) = self.refine((poses.clone(), 1.0));
        let gain = here.loss - self.linearize(&there, factor).loss;
        let agreeing = self.frames.iter().zip(&here.systems).filter(|(frame, _)| frame.fixed.is_none());
        let least = FocalVerdict::least_gain_of(
            agreeing.map(|(f, s)| (f.objective.matches.observations, s.agreeing)),
        );
        FocalVerdict::of(gain, &of_rig(&there, factor), least)
    }

    /// Levenberg–Marquardt from a start; never a larger loss than the start's.
    fn refine(&self, start: (Poses, f64)) -> (Poses, f64) {
        let step = |(poses, factor): &(Poses, f64), here: &Linearized, damping| {
            let step = self.solved(here, damping)?;
            let factor = stretched(*factor, step.log_focal)?;
            Some(((poses.moved(self.ties, &step.poses), factor), f64::INFINITY))
        };
        let look = |(poses, factor): &(Poses, f64)| self.linearize(poses, *factor);
        levenberg_marquardt(start, Convergence::OF_FOCAL, look, |here| here.loss, step).at
    }

    fn linearize(&self, poses: &Poses, factor: f64) -> Linearized {
        let system = |(frame, cam): (&ZoomedFrame<'_>, &CameraFromWorld)| {
            let at = Zoomed { pose: *cam, factor: frame.fixed.unwrap_or(factor) };
            let mut system = frame.objective.linearize(&at);
            if frame.fixed.is_some() {
                system.gradient[6] = 0.0;
                system.hessian.row_mut(6).fill(0.0);
                system.hessian.column_mut(6).fill(0.0);
            }
            system
        };
        let systems: Vec<ZoomSystem> = self.frames.iter().zip(&poses.cams).map(system).collect();
        let pulls: Vec<Pull> =
            self.ties.iter().zip(&poses.cams).map(|(tie, cam)| tie.pull(&poses.rig, cam)).collect();
        let loss = systems.iter().map(|s| s.loss).sum::<f64>() + pulls.iter().map(|p| p.loss).sum::<f64>();
        Linearized { systems, pulls, loss }
    }

    fn solved(&self, here: &Linearized, damping: f64) -> Option<ZoomStep> {
        let damped = |mut h: Matrix6<f64>| {
            for k in 0..6 {
                h[(k, k)] += damping * h[(k, k)].max(1e-12);
            }
            h
        };
        // Of the rig's six numbers and the focal length.
        let (mut hessian, mut gradient) = (SMatrix::<f64, 7, 7>::zeros(), SVector::<f64, 7>::zeros());
        let mut eliminated: Vec<Option<Eliminated>> = Vec::new();
        for ((tie, system), pull) in self.ties.iter().zip(&here.systems).zip(&here.pulls) {
            let own: Matrix6<f64> = system.hessian.fixed_view::<6, 6>(0, 0).into();
            let by_focal: Vector6<f64> = system.hessian.fixed_view::<6, 1>(0, 6).into();
            let slope: Vector6<f64> = system.gradient.fixed_rows::<6>(0).into();
            let (of_rig, across, rest);
            if tie.is_rigid() {
                of_rig = (tie.over_rig(&own), tie.gradient_over_rig(&slope));
                across = tie.gradient_over_rig(&by_focal);
                rest = (system.hessian[(6, 6)], system.gradient[6]);
                eliminated.push(None);
            } else {
                let w = Matrix6::from_diagonal(&pull.precision);
                let strain = pull.precision.component_mul(&pull.step);
                let own = (damped(own) + w).cholesky()?;
                let alone = own.solve(&-(slope + strain));
                let bent = own.solve(&by_focal);
                let held = w - w * own.solve(&w);
                of_rig = (tie.over_rig(&held), -tie.gradient_over_rig(&(strain + w * alone)));
                across = tie.gradient_over_rig(&(w * bent));
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
        let mut cams = Vec::with_capacity(self.ties.len());
        let parts = self.ties.iter().zip(&here.systems).zip(&here.pulls).zip(&eliminated);
        for (((tie, system), pull), eliminated) in parts {
            let carried = tie.carried(&rig);
            let cam = match eliminated {
                None => carried,
                Some(Eliminated { own, alone, bent }) => {
                    let strain = pull.precision.component_mul(&pull.step);
                    let pulled = own.solve(&pull.precision.component_mul(&carried));
                    let cam = alone + pulled - bent * log_focal;
                    slope += strain.dot(&(cam - carried));
                    cam
                }
            };
            slope += system.gradient.fixed_rows::<6>(0).dot(&cam) + system.gradient[6] * log_focal;
            cams.push(cam);
        }
        let finite = tip.iter().chain(cams.iter().flat_map(Vector6::iter)).all(|s| s.is_finite());
        finite.then_some(ZoomStep { poses: Step { rig, cams, promised: -0.5 * slope }, log_focal })
    }
}
