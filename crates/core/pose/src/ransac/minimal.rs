//! Minimal estimators: the correspondences of a sample and the solver that turns them into poses.

use crate::solvers::{ArrayVec, GravityAlignment, HalfPlane, p3p, p6lp, p6lp_dual_radial, u4lp, up2p};
use rand::Rng;
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{Anchor, CameraFromWorld, PixelLine, PlaneLine, PlanePoint, Point3};

use crate::likelihood::{Correspondences, Gravity, Matches};
use crate::options::AnchoredSolver;
use crate::ransac::half_planes::half_planes;
use crate::ransac::radial::RadialVote;
use crate::ransac::sampler::{SplitSampler, WeightedSampler, draw, pick};

/// One method from correspondences to hypotheses.
#[derive(Debug, Clone)]
pub(crate) enum Minimal {
    /// Three points.
    P3p { sampler: WeightedSampler, bearings: Vec<Vector3<f64>> },
    /// Two points and the vertical.
    Up2p { sampler: WeightedSampler, bearings: Vec<Vector3<f64>>, gravity: GravityAlignment },
    /// Six lines; for anchored lines never all of one anchor.
    P6lp { sampler: LineSampler, lines: Vec<PlaneLine> },
    /// Four lines and the vertical; for anchored lines never all of one anchor.
    U4lp { sampler: LineSampler, lines: Vec<PlaneLine>, gravity: GravityAlignment },
    /// Five lines of one anchor and one of any other.
    DualRadial { sides: Vec<FiveAndOne>, planes: Vec<HalfPlane> },
    /// Five lines of one anchor and a vote of the others.
    Radial(Box<RadialVote>),
}

/// Lines of one anchor, and those of all others.
#[derive(Debug, Clone)]
pub(crate) struct FiveAndOne {
    five: WeightedSampler,
    one: WeightedSampler,
    /// Probability of drawing from this pair; over all anchors they sum to 1.
    share: f64,
}

/// The sampler of lines.
#[derive(Debug, Clone)]
pub(crate) enum LineSampler {
    /// From all lines.
    Any(WeightedSampler),
    /// Never all from the anchor with most lines.
    Split(SplitSampler),
}

impl Minimal {
    pub(crate) fn new(
        matches: &Matches<'_>,
        anchored: AnchoredSolver,
        gravity: Option<&Gravity>,
        noise: f64,
    ) -> Self {
        let gravity = gravity.and_then(|g| GravityAlignment::new(&g.in_camera, &g.in_world));
        let all = || WeightedSampler::new((0..matches.len()).map(|i| (i, matches.inlier_prior[i])));
        match (matches.observations, gravity) {
            (Correspondences::Points { .. }, None) => {
                Self::P3p { sampler: all(), bearings: bearings(matches) }
            }
            (Correspondences::Points { .. }, Some(gravity)) => {
                Self::Up2p { sampler: all(), bearings: bearings(matches), gravity }
            }
            (Correspondences::Lines { .. }, None) => {
                Self::P6lp { sampler: LineSampler::Any(all()), lines: planes(matches) }
            }
            (Correspondences::Lines { .. }, Some(gravity)) => {
                Self::U4lp { sampler: LineSampler::Any(all()), lines: planes(matches), gravity }
            }
            (Correspondences::Anchored { .. }, Some(gravity)) if matches.anchors_seen() > 1 => {
                let sampler = LineSampler::Split(SplitSampler::new(richest_and_rest(matches), 4));
                Self::U4lp { sampler, lines: planes(matches), gravity }
            }
            (Correspondences::Anchored { pencils, lines }, _) => match anchored {
                AnchoredSolver::RadialVote => match RadialVote::new(matches, noise) {
                    Some(vote) => Self::Radial(Box::new(vote)),
                    None => Self::six_anchored(matches),
                },
                AnchoredSolver::P6lp => Self::six_anchored(matches),
                AnchoredSolver::DualRadial => {
                    let mut sides: Vec<FiveAndOne> = pencils
                        .anchors()
                        .map(|anchor| {
                            let of = |is_own| sampler(matches, |i| (matches.anchor[i] == anchor) == is_own);
                            let (five, one) = (of(true), of(false));
                            let possible = five.len() >= 5 && one.len() >= 1;
                            let chance = five.expected_share().powi(5) * one.expected_share();
                            FiveAndOne { five, one, share: if possible { chance } else { 0.0 } }
                        })
                        .collect();
                    let total: f64 = sides.iter().map(|side| side.share).sum();
                    if !(total > 0.0) {
                        return Self::six_anchored(matches);
                    }
                    for side in &mut sides {
                        side.share /= total;
                    }
                    Self::DualRadial { sides, planes: half_planes(matches, pencils, lines) }
                }
            },
        }
    }

    fn six_anchored(matches: &Matches<'_>) -> Self {
        let sampler = LineSampler::Split(SplitSampler::new(richest_and_rest(matches), 6));
        Self::P6lp { sampler, lines: planes(matches) }
    }

    /// Probability that a sample consists of correspondences from this list.
    pub(crate) fn hit_probability(&self, matches: &Matches<'_>, agreeing: &[usize]) -> f64 {
        // Weight of each anchor, and of all.
        let mut weight = [0.0; Anchor::MAX_COUNT];
        for &i in agreeing {
            weight[matches.anchor[i].index()] += matches.inlier_prior[i];
        }
        let all: f64 = weight.iter().sum();
        let any = |sampler: &WeightedSampler, size| (all / sampler.total()).powi(size);
        let lines = |sampler: &LineSampler, size| match sampler {
            LineSampler::Any(sampler) => any(sampler, size),
            LineSampler::Split(split) => {
                let richest = weight[matches.richest_anchor().index()];
                split.hit_probability([richest, all - richest])
            }
        };
        match self {
            Self::P3p { sampler, .. } => any(sampler, 3),
            Self::Up2p { sampler, .. } => any(sampler, 2),
            Self::P6lp { sampler, .. } => lines(sampler, 6),
            Self::U4lp { sampler, .. } => lines(sampler, 4),
            Self::DualRadial { sides, .. } => sides
                .iter()
                .zip(weight)
                .map(|(side, own)| {
                    let share =
                        |weight: f64, of: &WeightedSampler| weight / of.total().max(f64::MIN_POSITIVE);
                    side.share * share(own, &side.five).powi(5) * share(all - own, &side.one)
                })
                .sum(),
            Self::Radial(vote) => vote.hit_probability(&weight),
        }
    }

    /// Draws a sample and appends the poses it gives.
    pub(crate) fn hypothesize<R: Rng + ?Sized>(
        &mut self,
        matches: &Matches<'_>,
        rng: &mut R,
        models: &mut Vec<CameraFromWorld>,
    ) {
        match self {
            Self::P3p { sampler, bearings } => {
                let Some(sample) = draw::<3, _>(matches, rng, |rng, _| sampler.draw(rng)) else { return };
                let mut poses = ArrayVec::new();
                p3p(&sample.map(|i| bearings[i]), &points(matches, &sample), &mut poses);
                models.extend(poses);
            }
            Self::Up2p { sampler, bearings, gravity } => {
                let Some(sample) = draw::<2, _>(matches, rng, |rng, _| sampler.draw(rng)) else { return };
                let mut poses = ArrayVec::new();
                up2p(&sample.map(|i| bearings[i]), &points(matches, &sample), gravity, &mut poses);
                models.extend(poses);
            }
            Self::P6lp { sampler, lines } => {
                let Some(sample) = sampler.draw::<6, _>(matches, rng) else { return };
                let mut poses = ArrayVec::new();
                p6lp(&sample.map(|i| lines[i]), &points(matches, &sample), &mut poses);
                models.extend(poses);
            }
            Self::U4lp { sampler, lines, gravity } => {
                let Some(sample) = sampler.draw::<4, _>(matches, rng) else { return };
                let mut poses = ArrayVec::new();
                u4lp(&sample.map(|i| lines[i]), &points(matches, &sample), gravity, &mut poses);
                models.extend(poses);
            }
            Self::DualRadial { sides, planes } => {
                let chosen = pick(rng, sides.iter().map(|side| side.share));
                let Some(FiveAndOne { five, one, .. }) = chosen.and_then(|chosen| sides.get(chosen)) else {
                    return;
                };
                let next = |rng: &mut R, drawn: usize| if drawn < 5 { five.draw(rng) } else { one.draw(rng) };
                let Some(sample) = draw::<6, _>(matches, rng, next) else { return };
                let mut poses = ArrayVec::new();
                let [a, b, c, d, e, sixth] = sample.map(|i| planes[i]);
                let inward = [a, b, c, d, e].map(|plane| plane.inward);
                p6lp_dual_radial(&a.axis, &inward, &sixth, &points(matches, &sample), &mut poses);
                models.extend(poses);
            }
            Self::Radial(vote) => vote.hypothesize(matches, rng, models),
        }
    }
}

impl LineSampler {
    fn draw<const K: usize, R: Rng + ?Sized>(
        &self,
        matches: &Matches<'_>,
        rng: &mut R,
    ) -> Option<[usize; K]> {
        match self {
            Self::Any(sampler) => draw(matches, rng, |rng, _| sampler.draw(rng)),
            Self::Split(sampler) => {
                let split = sampler.draw_split(rng)?;
                draw(matches, rng, |rng, drawn| sampler.side(split, drawn).draw(rng))
            }
        }
    }
}

fn points<const K: usize>(matches: &Matches<'_>, sample: &[usize; K]) -> [Point3<World>; K] {
    sample.map(|i| Point3::from_vector(matches.points[i]))
}

fn sampler(matches: &Matches<'_>, belongs: impl Fn(usize) -> bool) -> WeightedSampler {
    let members = (0..matches.len()).filter(|&i| belongs(i));
    WeightedSampler::new(members.map(|i| (i, matches.inlier_prior[i])))
}

/// The lines of the anchor with most lines, and all others: a sample from both is never degenerate.
fn richest_and_rest(matches: &Matches<'_>) -> [WeightedSampler; 2] {
    let richest = matches.richest_anchor();
    [true, false].map(|is_own| sampler(matches, |i| (matches.anchor[i] == richest) == is_own))
}

fn bearings(matches: &Matches<'_>) -> Vec<Vector3<f64>> {
    let c = &matches.camera;
    let bearing = |o: &Vector3<f64>| {
        let x = (o.x - c.principal[0]) / c.focal[0];
        PlanePoint::new(x, (o.y - c.principal[1]) / c.focal[1]).bearing()
    };
    matches.observed.iter().map(bearing).collect()
}

fn planes(matches: &Matches<'_>) -> Vec<PlaneLine> {
    let line = |o| PixelLine::from_homogeneous(o).expect("observed lines have unit normals");
    matches.observed.iter().map(|o| line(*o).back_project(&matches.camera)).collect()
}
