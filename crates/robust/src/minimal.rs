//! Minimal estimators: which correspondences make a sample and which solver turns it into poses.

use rand::Rng;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{Anchor, CameraFromWorld, PixelLine, PlaneLine, PlanePoint, Point3};
use veiloc_solvers::{ArrayVec, p3p, p6lp};

use crate::matches::{Kind, Matches};
use crate::options::AnchoredSolver;
use crate::radial::RadialVote;
use crate::sampler::WeightedSampler;

/// Draws before a sample of distinct correspondences is given up.
const PATIENCE: usize = 64;

/// One way from correspondences to hypotheses.
#[derive(Debug, Clone)]
pub(crate) enum Minimal {
    /// Three points.
    P3p { sampler: WeightedSampler, bearings: Vec<Vector3<f64>> },
    /// Six lines, for anchored ones never all of one anchor.
    P6lp { sampler: WeightedSampler, sides: Option<[WeightedSampler; 2]>, lines: Vec<PlaneLine> },
    /// Five anchored lines of one side and a vote of the other.
    Radial(Box<RadialVote>),
}

impl Minimal {
    pub(crate) fn new(matches: &Matches, anchored: AnchoredSolver, noise: f64) -> Self {
        if anchored == AnchoredSolver::RadialVote
            && let Some(vote) = RadialVote::new(matches, noise)
        {
            return Self::Radial(Box::new(vote));
        }
        let weights = |members: &dyn Fn(usize) -> bool| {
            WeightedSampler::new((0..matches.len()).filter(|&i| members(i)).map(|i| (i, matches.weight[i])))
        };
        let sampler = weights(&|_| true);
        let back_projected = || {
            let line = |o| PixelLine::from_homogeneous(o).expect("observed lines have unit normals");
            matches.observed.iter().map(|o| line(*o).back_project(&matches.camera)).collect()
        };
        match matches.kind {
            Kind::Points => {
                let c = &matches.camera;
                let bearings = matches
                    .observed
                    .iter()
                    .map(|o| {
                        let x = (o.x - c.principal[0]) / c.focal[0];
                        PlanePoint::new(x, (o.y - c.principal[1]) / c.focal[1]).bearing()
                    })
                    .collect();
                Self::P3p { sampler, bearings }
            }
            Kind::Lines => Self::P6lp { sampler, sides: None, lines: back_projected() },
            Kind::Anchored(_) => {
                let sides = Anchor::BOTH.map(|a| weights(&|i| matches.anchor[i] == a));
                Self::P6lp { sampler, sides: Some(sides), lines: back_projected() }
            }
        }
    }

    /// Probability that a sample consists of correspondences from this list.
    pub(crate) fn hit_probability(&self, matches: &Matches, agreeing: &[usize]) -> f64 {
        let weight =
            |members: &mut dyn Iterator<Item = usize>| members.map(|i| matches.weight[i]).sum::<f64>();
        let all = || weight(&mut agreeing.iter().copied());
        match self {
            Self::P3p { sampler, .. } => (all() / sampler.total()).powi(3),
            Self::P6lp { sampler, .. } => (all() / sampler.total()).powi(6),
            Self::Radial(vote) => {
                let of =
                    |a: Anchor| weight(&mut agreeing.iter().copied().filter(|&i| matches.anchor[i] == a));
                vote.hit_probability(Anchor::BOTH.map(of))
            }
        }
    }

    /// Draws a sample and appends the poses it gives.
    pub(crate) fn hypothesize<R: Rng + ?Sized>(
        &mut self,
        matches: &Matches,
        rng: &mut R,
        models: &mut Vec<CameraFromWorld>,
    ) {
        match self {
            Self::P3p { sampler, bearings } => {
                let Some(sample) = draw::<3, _>(matches, rng, |rng, _| sampler.draw(rng)) else { return };
                let mut poses = ArrayVec::new();
                let points = sample.map(|i| Point3::from_vector(matches.points[i]));
                p3p(&sample.map(|i| bearings[i]), &points, &mut poses);
                models.extend(poses);
            }
            Self::P6lp { sampler, sides, lines } => {
                let sample = draw::<6, _>(matches, rng, |rng, drawn| match (&*sides, drawn) {
                    // The sixth line comes from the other anchor when the first five share one.
                    (Some(sides), [first, rest @ ..])
                        if drawn.len() == 5
                            && rest.iter().all(|&i| matches.anchor[i] == matches.anchor[*first]) =>
                    {
                        sides[matches.anchor[*first].other().index()].draw(rng)
                    }
                    _ => sampler.draw(rng),
                });
                let Some(sample) = sample else { return };
                let mut poses = ArrayVec::new();
                let points = sample.map(|i| Point3::from_vector(matches.points[i]));
                p6lp(&sample.map(|i| lines[i]), &points, &mut poses);
                models.extend(poses);
            }
            Self::Radial(vote) => vote.hypothesize(matches, rng, models),
        }
    }
}

/// `K` correspondences, no two of one observation or one map point: at most one of such a pair is right.
pub(crate) fn draw<const K: usize, R: Rng + ?Sized>(
    matches: &Matches,
    rng: &mut R,
    mut next: impl FnMut(&mut R, &[usize]) -> Option<usize>,
) -> Option<[usize; K]> {
    let mut sample: ArrayVec<usize, K> = ArrayVec::new();
    for _ in 0..PATIENCE {
        let i = next(rng, &sample)?;
        let clash = sample.iter().any(|&j| {
            i == j || matches.observed[i] == matches.observed[j] || matches.points[i] == matches.points[j]
        });
        if !clash {
            sample.push(i);
            if sample.is_full() {
                return sample.into_inner().ok();
            }
        }
    }
    None
}
