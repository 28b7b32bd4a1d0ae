//! Minimal estimators: which correspondences make a sample and which solver turns it into poses.

use rand::Rng;
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{Anchor, CameraFromWorld, PixelLine, PlaneLine, PlanePoint, Point3};
use veiloc_solvers::{ArrayVec, GravityAlignment, HalfLine, p3p, p6lp, p6lp_dual_radial, u4lp, up2p};

use crate::half_lines::half_lines;
use crate::options::AnchoredSolver;
use crate::radial::RadialVote;
use crate::sampler::{SplitSampler, WeightedSampler, draw};
use veiloc_likelihood::{Correspondences, Gravity, Matches};

/// One way from correspondences to hypotheses.
#[derive(Debug, Clone)]
pub(crate) enum Minimal {
    /// Three points.
    P3p { sampler: WeightedSampler, bearings: Vec<Vector3<f64>> },
    /// Two points and the vertical.
    Up2p { sampler: WeightedSampler, bearings: Vec<Vector3<f64>>, gravity: GravityAlignment },
    /// Six lines, for anchored ones never all of one anchor.
    P6lp { sampler: LineSampler, lines: Vec<PlaneLine> },
    /// Four lines and the vertical, for anchored ones never all of one anchor.
    U4lp { sampler: LineSampler, lines: Vec<PlaneLine>, gravity: GravityAlignment },
    /// Five anchored lines of one side and one of the other.
    DualRadial { sides: [WeightedSampler; 2], first: f64, lines: Vec<HalfLine> },
    /// Five anchored lines of one side and a vote of the other.
    Radial(Box<RadialVote>),
}

/// Where lines are drawn from.
#[derive(Debug, Clone)]
pub(crate) enum LineSampler {
    /// All alike.
    Any(WeightedSampler),
    /// Of both anchors.
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
        let all = || WeightedSampler::new((0..matches.len()).map(|i| (i, matches.weight[i])));
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
            (Correspondences::Anchored { .. }, Some(gravity)) if has_both_sides(matches) => {
                let sampler = LineSampler::Split(SplitSampler::new(both_sides(matches), 4));
                Self::U4lp { sampler, lines: planes(matches), gravity }
            }
            (Correspondences::Anchored { anchors, .. }, _) => match anchored {
                AnchoredSolver::RadialVote => match RadialVote::new(matches, noise) {
                    Some(vote) => Self::Radial(Box::new(vote)),
                    None => Self::six_anchored(matches),
                },
                AnchoredSolver::P6lp => Self::six_anchored(matches),
                AnchoredSolver::DualRadial => {
                    let sides = both_sides(matches);
                    let share = [0, 1].map(|s| sides[s].expected_share());
                    let chance = [0, 1].map(|s: usize| {
                        let possible = sides[s].len() >= 5 && sides[1 - s].len() >= 1;
                        if possible { share[s].powi(5) * share[1 - s] } else { 0.0 }
                    });
                    if chance == [0.0; 2] {
                        return Self::six_anchored(matches);
                    }
                    let first = chance[0] / (chance[0] + chance[1]);
                    Self::DualRadial { sides, first, lines: half_lines(matches, anchors) }
                }
            },
        }
    }

    fn six_anchored(matches: &Matches<'_>) -> Self {
        let sampler = LineSampler::Split(SplitSampler::new(both_sides(matches), 6));
        Self::P6lp { sampler, lines: planes(matches) }
    }

    /// Probability that a sample consists of correspondences from this list.
    pub(crate) fn hit_probability(&self, matches: &Matches<'_>, agreeing: &[usize]) -> f64 {
        let mut weight = [0.0; 2];
        for &i in agreeing {
            weight[matches.anchor[i].index()] += matches.weight[i];
        }
        let any = |sampler: &WeightedSampler, size| ((weight[0] + weight[1]) / sampler.total()).powi(size);
        let lines = |sampler: &LineSampler, size| match sampler {
            LineSampler::Any(sampler) => any(sampler, size),
            LineSampler::Split(split) => split.hit_probability(weight),
        };
        match self {
            Self::P3p { sampler, .. } => any(sampler, 3),
            Self::Up2p { sampler, .. } => any(sampler, 2),
            Self::P6lp { sampler, .. } => lines(sampler, 6),
            Self::U4lp { sampler, .. } => lines(sampler, 4),
            Self::DualRadial { sides, first, .. } => {
                let share = [0, 1].map(|s| weight[s] / sides[s].total().max(f64::MIN_POSITIVE));
                first * share[0].powi(5) * share[1] + (1.0 - first) * share[1].powi(5) * share[0]
            }
            Self::Radial(vote) => vote.hit_probability(weight),
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
            Self::DualRadial { sides, first, lines } => {
                let five = usize::from(rng.random::<f64>() >= *first);
                let next =
                    |rng: &mut R, drawn: usize| sides[if drawn < 5 { five } else { 1 - five }].draw(rng);
                let Some(sample) = draw::<6, _>(matches, rng, next) else { return };
                let mut poses = ArrayVec::new();
                let [a, b, c, d, e, sixth] = sample.map(|i| lines[i]);
                let directions = [a, b, c, d, e].map(|line| line.direction);
                p6lp_dual_radial(&a.origin, &directions, &sixth, &points(matches, &sample), &mut poses);
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

/// Whether each anchor has a line to draw.
fn has_both_sides(matches: &Matches<'_>) -> bool {
    Anchor::BOTH.iter().all(|anchor| matches.anchor.contains(anchor))
}

fn both_sides(matches: &Matches<'_>) -> [WeightedSampler; 2] {
    Anchor::BOTH.map(|anchor| {
        let members = (0..matches.len()).filter(|&i| matches.anchor[i] == anchor);
        WeightedSampler::new(members.map(|i| (i, matches.weight[i])))
    })
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
