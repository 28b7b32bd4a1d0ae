//! Hypotheses for anchored lines: five lines of one anchor, then a vote of the others.
//!
//! All lines of one anchor pass through one ray, so in the camera rotated onto that ray they observe a 1D radial
//! camera. Five of them determine the pose up to the depth along the ray (`p5lp_radial`), and only poses with all five
//! points in their *half*-planes survive, which is one in sixteen of the wrong ones. The remaining poses are scored by
//! the lines of their own anchor, by the angle alone. The promising ones are completed: each line of the other anchors
//! gives the depths at which its point lies on it, and the depth with the heaviest set of lines is used. Compared to
//! drawing a sixth line, the vote saves a factor of the inlier ratio and is robust to the noise of any single line.

use crate::solvers::{ArrayVec, RadialPose, p5lp_radial};
use rand::Rng;
use veiloc_geometry::nalgebra::{Rotation3, Vector2, Vector3};
use veiloc_geometry::{Anchor, CameraFromWorld, Pixel, Point3};
use veiloc_simd::Backend;
use veiloc_simd::pose::{LANES, RadialBlock, RadialLanes};

use crate::likelihood::{Correspondences, Matches, median_point, promising_first};
use crate::ransac::half_planes::{direction, half_planes};
use crate::ransac::sampler::{WeightedSampler, draw, pick};

/// A radial pose is completed when its score comes this close to the best radial score of its side.
const SLACK: f64 = 0.2;

/// Half width of a vote, in multiples of the noise.
const VOTE_WIDTH: f64 = 1.5;

/// Number of voting lines, the most promising of the other anchors: enough to find the depth; all lines then score it.
const MAX_VOTERS: usize = 128;

/// With fewer lines of other anchors, poses are also made without their vote.
const MIN_VOTERS: usize = 24;

/// Assumed positions of the scene's middle point relative to the anchor, as a share of the image's height.
const SPREADS: [f64; 3] = [0.3, 0.5, 0.8];

/// Assumed minimum distance of a keypoint from its anchor, as a share of half the image's height.
const MIN_RADIUS: f64 = 0.5;

/// Minimum number of lines of an anchor for sampling: five give a pose, more are needed to test it.
const MIN_LINES: usize = 8;

/// The lines of all anchors, ready to be drawn from.
#[derive(Debug, Clone)]
pub(crate) struct RadialVote {
    sides: Vec<Side>,
    center: Vector3<f64>,
    noise: f64,
    backend: Backend,
}

/// The lines of one anchor.
#[derive(Debug, Clone)]
struct Side {
    /// Most promising first.
    members: Vec<usize>,
    /// The most promising lines of all other anchors.
    voters: Vec<usize>,
    /// Whether there are so few that their vote may be noise.
    one_sided: bool,
    /// Probability that a sample is drawn from here.
    share: f64,
    sampler: WeightedSampler,
    /// Rotation from the camera to the camera aligned with the anchor's ray.
    turn: Rotation3<f64>,
    /// Unit direction of each correspondence's half-line there, `[N]` (zero for those of other anchors).
    directions: Vec<Vector2<f64>>,
    lanes: RadialLanes,
    /// Movement of lines in the middle of the image, pixels per radian.
    radius: f64,
    best: f64,
}

/// Range of depths at which a line of another anchor agrees.
struct Vote {
    from: f64,
    to: f64,
    weight: f64,
}

impl RadialVote {
    /// `None` unless the correspondences are anchored and one anchor has enough lines.
    pub(crate) fn new(matches: &Matches<'_>, noise: f64) -> Option<Self> {
        let Correspondences::Anchored { pencils, lines } = matches.observations else { return None };
        let center = median_point(&matches.points);
        let planes = half_planes(matches, pencils, lines);
        let middle =
            Pixel::new(0.5 * f64::from(matches.camera.width), 0.5 * f64::from(matches.camera.height));
        let side = |anchor: Anchor| {
            let of =
                |is_own: bool| (0..matches.len()).filter(move |&i| (matches.anchor[i] == anchor) == is_own);
            let members = promising_first(matches, of(true));
            let voters = promising_first(matches, of(false));
            let one_sided = voters.len() < MIN_VOTERS;
            let voters: Vec<usize> = voters.into_iter().take(MAX_VOTERS).collect();
            let ray = direction(matches, pencils, anchor);
            // An axis has no sign; it is chosen forward, so that the smallest rotation exists.
            let ray = if ray.z < 0.0 { -ray } else { ray };
            let turn = Rotation3::rotation_between(&ray, &Vector3::z()).unwrap_or_else(Rotation3::identity);
            let mut directions = vec![Vector2::zeros(); matches.len()];
            for &i in &members {
                let turned = (turn * planes[i].inward).xy();
                directions[i] = turned / turned.norm().max(f64::MIN_POSITIVE);
            }
            // The distance of a keypoint from the anchor is unknown until the depth is known.
            let distance = pencils.distance(anchor, middle).max(MIN_RADIUS * middle.v);
            let typical_line = pencils.angle_of(anchor, middle);
            let radius = distance * pencils.pixels_per_radian(anchor, typical_line);
            let extra = matches.noise_term(noise) + distance.ln();
            let blocks = members
                .chunks(LANES)
                .map(|chunk| block(matches, chunk, &center, &directions, extra))
                .collect();
            let sampler = WeightedSampler::new(members.iter().map(|&i| (i, matches.inlier_prior[i])));
            let possible = members.len() >= MIN_LINES;
            let share = if possible { sampler.expected_share().powi(5) } else { 0.0 };
            Side {
                members,
                voters,
                one_sided,
                share,
                sampler,
                turn,
                directions,
                lanes: RadialLanes::new(blocks),
                radius,
                best: 0.0,
            }
        };
        let mut sides: Vec<Side> = pencils.anchors().map(side).collect();
        let total: f64 = sides.iter().map(|side| side.share).sum();
        if sides.iter().all(|side| side.members.len() < MIN_LINES) {
            return None;
        }
        // Without any prior information, all sides are equally likely.
        let alike = (sides.len() as f64).recip();
        for side in &mut sides {
            side.share = if total > 0.0 { side.share / total } else { alike };
        }
        Some(Self { sides, center, noise, backend: Backend::best() })
    }

    /// Probability that five random lines of one anchor agree, for this total weight of agreeing lines per anchor.
    pub(crate) fn hit_probability(&self, agreeing: &[f64]) -> f64 {
        let of_side = |(side, agreeing): (&Side, &f64)| {
            side.share * (agreeing / side.sampler.total().max(f64::MIN_POSITIVE)).powi(5)
        };
        self.sides.iter().zip(agreeing).map(of_side).sum()
    }

    /// Draws five lines of one anchor and appends their poses, completed by the vote.
    pub(crate) fn hypothesize<R: Rng + ?Sized>(
        &mut self,
        matches: &Matches<'_>,
        rng: &mut R,
        models: &mut Vec<CameraFromWorld>,
    ) {
        let Some(chosen) = pick(rng, self.sides.iter().map(|side| side.share)) else { return };
        let side = &self.sides[chosen];
        let Some(sample) = draw::<5, _>(matches, rng, |rng, _| side.sampler.draw(rng)) else { return };
        let mut poses = ArrayVec::new();
        let points = sample.map(|i| Point3::from_vector(matches.points[i]));
        p5lp_radial(&sample.map(|i| side.directions[i]), &points, &mut poses);
        let k = (side.radius / self.noise).powi(2) / matches.freedom();
        for pose in poses {
            let side = &mut self.sides[chosen];
            let least = (1.0 - SLACK) * side.best;
            let rows = rows(&pose, &self.center);
            let score = f64::from(side.lanes.score(self.backend, &rows, k as f32, least as f32));
            if !(score > least) {
                continue;
            }
            side.best = side.best.max(score);
            let completed = self.complete(matches, chosen, &pose);
            if completed.is_none() || self.sides[chosen].one_sided {
                self.poses_without_vote(matches, chosen, &pose, models);
            }
            models.extend(completed);
        }
    }

    /// Poses for an anchor when the others have hardly any lines: the position along the ray is undetermined, so the
    /// camera is placed where the scene fills typical parts of the image.
    fn poses_without_vote(
        &self,
        matches: &Matches<'_>,
        chosen: usize,
        radial: &RadialPose,
        models: &mut Vec<CameraFromWorld>,
    ) {
        let side = &self.sides[chosen];
        let back = side.turn.inverse();
        let rotation = back * radial.rotation;
        let across = back * Vector3::new(radial.offset.x, radial.offset.y, 0.0);
        let along = back * Vector3::z();
        // For the most promising points: distance from the ray, and position along it.
        let first = &side.members[..side.members.len().min(MAX_VOTERS)];
        let mut tangents: Vec<(f64, f64)> = first
            .iter()
            .map(|&i| {
                let p = radial.rotation * matches.points[i];
                ((p.xy() + radial.offset).norm(), p.z)
            })
            .collect();
        if tangents.is_empty() {
            return;
        }
        let middle = tangents.len() / 2;
        let (distance, ahead) = *tangents.select_nth_unstable_by(middle, |a, b| a.0.total_cmp(&b.0)).1;
        let height = f64::from(matches.camera.height);
        for share in SPREADS {
            // The angle off the ray at which the middle point is seen.
            let depth = distance * matches.camera.focal[1] / (share * height) - ahead;
            models.push(CameraFromWorld::new(rotation, across + along * depth));
        }
    }

    /// The pose with the depth on which most lines of the others agree; `None` when none of them agrees.
    fn complete(&self, matches: &Matches<'_>, chosen: usize, radial: &RadialPose) -> Option<CameraFromWorld> {
        let side = &self.sides[chosen];
        let back = side.turn.inverse();
        let rotation = back * radial.rotation;
        let translation = back * Vector3::new(radial.offset.x, radial.offset.y, 0.0);
        let along = back * Vector3::z();
        let reach = VOTE_WIDTH * self.noise;
        let mut votes = Vec::with_capacity(side.voters.len());
        for &i in &side.voters {
            let start = rotation * matches.points[i] + translation;
            votes.extend(vote(matches, i, &start, &along, reach, self.noise));
        }
        let depth = heaviest(&votes)?;
        Some(CameraFromWorld::new(rotation, translation + along * depth))
    }
}

/// The depths at which point `i`, at `start + depth · along`, projects within `reach` pixels of its line.
fn vote(
    matches: &Matches<'_>,
    i: usize,
    start: &Vector3<f64>,
    along: &Vector3<f64>,
    reach: f64,
    noise: f64,
) -> Option<Vote> {
    let (o, c) = (&matches.observed[i], &matches.camera);
    // Pixel distance from the line is (n · p) / p_z.
    let n =
        Vector3::new(o.x * c.focal[0], o.y * c.focal[1], o.x * c.principal[0] + o.y * c.principal[1] + o.z);
    let (constant, slope) = (n.dot(start), n.dot(along));
    let at = |e: f64| -(constant - e * start.z) / (slope - e * along.z);
    let (a, b) = (at(reach), at(-reach));
    let bounded = (slope - reach * along.z) * (slope + reach * along.z) > 0.0;
    let in_front = start.z + a * along.z > 0.0 && start.z + b * along.z > 0.0;
    if !(bounded && in_front && (b - a).is_finite()) {
        return None;
    }
    // Exactly on its line, the observation has the likelihood of that radius.
    let weight = matches.log_likelihood_ratio_at(i, &(start + along * at(0.0)), noise)?;
    (weight > 0.0).then_some(Vote { from: a.min(b), to: a.max(b), weight })
}

/// The middle of the interval that the heaviest set of votes covers.
fn heaviest(votes: &[Vote]) -> Option<f64> {
    let mut ends: Vec<(f64, f64)> =
        votes.iter().flat_map(|v| [(v.from, v.weight), (v.to, -v.weight)]).collect();
    ends.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(b.1.total_cmp(&a.1)));
    let (mut sum, mut best, mut found) = (0.0, 0.0, None);
    for (k, end) in ends.iter().enumerate() {
        sum += end.1;
        if sum > best {
            best = sum;
            found = ends.get(k + 1).map(|next| 0.5 * (end.0 + next.0));
        }
    }
    found
}

fn block(
    matches: &Matches<'_>,
    members: &[usize],
    center: &Vector3<f64>,
    directions: &[Vector2<f64>],
    extra: f64,
) -> RadialBlock {
    let mut block = RadialBlock::EMPTY;
    for (l, &i) in members.iter().enumerate() {
        let p = matches.points[i] - center;
        (block.x[l], block.y[l], block.z[l]) = (p.x as f32, p.y as f32, p.z as f32);
        (block.u[l], block.v[l]) = (directions[i].x as f32, directions[i].y as f32);
        block.score_offset[l] = (matches.log_likelihood_const[i] + extra) as f32;
    }
    block
}

/// The first two rows of `[R | t]` for centred points.
fn rows(pose: &RadialPose, center: &Vector3<f64>) -> [[f32; 4]; 2] {
    let m = pose.rotation.matrix();
    let t = (pose.rotation * center).xy() + pose.offset;
    [0, 1].map(|i| [m[(i, 0)] as f32, m[(i, 1)] as f32, m[(i, 2)] as f32, t[i] as f32])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::likelihood::PoseProblem;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use veiloc_geometry::{AnchorPosition, Layout, Pencils, Pinhole, Pixel, Sectors};

    const CAMERA: Pinhole =
        Pinhole { width: 640, height: 480, focal: [525.0, 520.0], principal: [318.0, 242.0] };

    /// The paper's layout at any angle and distance, stripes, anchors outside and at infinity, three, turned ones.
    fn layouts() -> Vec<Pencils> {
        let mut all = Vec::new();
        for angle in [0.0, 0.5, std::f64::consts::FRAC_PI_2, 2.7] {
            for s in [1.0, 2.0, 3.0] {
                all.push((Layout::halves(angle, s), [0.0; 3]));
            }
        }
        let sectors = Sectors { axis: 1.17, count: 24, shift: 0.3 };
        let at = |x, y| AnchorPosition::At([x, y]);
        let striped = |anchors: &[AnchorPosition]| Layout::new(anchors, sectors, None);
        all.push((striped(&[at(-0.12, -0.49), at(1.5, 0.0)]), [0.0; 3]));
        all.push((
            striped(&[AnchorPosition::Toward(std::f64::consts::FRAC_PI_2), AnchorPosition::Toward(0.0)]),
            [0.0; 3],
        ));
        all.push((striped(&[at(0.1, 0.0), at(0.7, 0.7), AnchorPosition::Toward(2.0)]), [0.0; 3]));
        all.push((striped(&[at(-0.12, -0.49), at(0.3, 0.4)]), [0.4, 2.8, 0.2]));
        all.into_iter()
            .map(|(layout, [x, y, z])| {
                let turn = Rotation3::from_euler_angles(x, y, z);
                Pencils::new([640, 480], 525.0, &layout.expect("it closes"), &turn).expect("possible")
            })
            .collect()
    }

    /// Exact matches seen from the identity pose.
    fn exact(rng: &mut ChaCha8Rng, pencils: Pencils) -> PoseProblem {
        let pixels: Vec<Pixel> =
            (0..80).map(|_| Pixel::new(rng.random_range(1.0..639.0), rng.random_range(1.0..479.0))).collect();
        let lines = pixels
            .iter()
            .map(|p| (pencils.anchor_of(*p), pencils.angle_of(pencils.anchor_of(*p), *p)))
            .collect();
        let points = pixels
            .iter()
            .map(|p| Point3::from_vector(CAMERA.unproject(*p).homogeneous() * rng.random_range(1.0..7.0)))
            .collect();
        let observations = Correspondences::Anchored { pencils, lines };
        let keypoints = (0..80).collect();
        PoseProblem::new(CAMERA, observations, keypoints, points)
    }

    #[test]
    fn exact_matches_give_the_exact_pose_for_any_layout() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for (k, pencils) in layouts().into_iter().enumerate() {
            let problem = exact(&mut rng, pencils);
            let matches = Matches::new(&problem, 0.2);
            let mut vote = RadialVote::new(&matches, 1.0).expect("enough of one");
            let mut models = Vec::new();
            for _ in 0..20 {
                vote.hypothesize(&matches, &mut rng, &mut models);
            }
            let near = |m: &&CameraFromWorld| m.translation_error(&CameraFromWorld::identity()) < 0.02;
            assert!(models.iter().filter(near).count() >= 5, "{k}: {} models", models.len());
        }
    }

    #[test]
    fn half_planes_lead_to_their_keypoints() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for pencils in layouts() {
            let problem = exact(&mut rng, pencils);
            let matches = Matches::new(&problem, 0.2);
            let vote = RadialVote::new(&matches, 1.0).expect("enough of one");
            for side in &vote.sides {
                for &i in &side.members {
                    let seen = (side.turn * matches.points[i]).xy();
                    let u = side.directions[i];
                    assert!(u.dot(&seen) > 0.0 && (u.x * seen.y - u.y * seen.x).abs() < 1e-9 * seen.norm());
                }
            }
        }
    }

    #[test]
    fn the_heaviest_stretch_wins() {
        let vote = |from, to, weight| Vote { from, to, weight };
        assert_eq!(heaviest(&[]), None);
        assert_eq!(heaviest(&[vote(1.0, 2.0, 1.0)]), Some(1.5));
        let votes = [vote(0.0, 4.0, 1.0), vote(3.0, 5.0, 1.0), vote(10.0, 11.0, 1.5)];
        assert_eq!(heaviest(&votes), Some(3.5));
        assert_eq!(heaviest(&[vote(0.0, 4.0, 1.0), vote(3.0, 5.0, 1.0), vote(10.0, 11.0, 3.0)]), Some(10.5));
    }

    #[test]
    fn empty_side_leaves_only_the_depth_free() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut problem = exact(&mut rng, Pencils::paper(640, 480));
        let Correspondences::Anchored { pencils, lines } = &mut problem.observations else { unreachable!() };
        let keep: Vec<usize> = (0..80).filter(|i| lines[*i].0 == Anchor::FIRST).collect();
        *lines = keep.iter().map(|&i| lines[i]).collect();
        let at = pencils.position(Anchor::FIRST).expect("at the edge");
        let ray = CAMERA.unproject(at).homogeneous().normalize();
        problem.points = keep.iter().map(|&i| problem.points[i]).collect();
        problem.keypoints = (0..keep.len()).collect();
        let matches = Matches::new(&problem, 0.2);
        let mut vote = RadialVote::new(&matches, 1.0).expect("one side is enough");
        let mut models = Vec::new();
        for _ in 0..20 {
            vote.hypothesize(&matches, &mut rng, &mut models);
        }
        let right = |m: &&CameraFromWorld| {
            let off = m.translation() - ray * ray.dot(m.translation());
            m.rotation_error_degrees(&CameraFromWorld::identity()) < 0.1 && off.norm() < 0.02
        };
        assert!(models.iter().filter(right).count() >= 10, "of {}", models.len());
        // Too few lines to test a pose.
        problem.points.truncate(6);
        problem.keypoints.truncate(6);
        let Correspondences::Anchored { lines, .. } = &mut problem.observations else { unreachable!() };
        lines.truncate(6);
        assert!(RadialVote::new(&Matches::new(&problem, 0.2), 1.0).is_none());
    }
}
