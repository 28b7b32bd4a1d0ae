//! Posterior of a keypoint's position on its own line, given the lines of other frames: the integral over depth.

use crate::{KnownSegment, Observation};
use veiloc_geometry::nalgebra::{Matrix2, Vector2, Vector3};
use veiloc_geometry::{Pinhole, Pixel};

use crate::multi_view::depth::DepthPrior;
use crate::multi_view::frame::{Frame, FramesOptions, NEAR_PX, TriangulatedKeypoint};
use crate::multi_view::ray_plane::{Plane, PlaneResidual, RayPlane, RelativeFrame};

/// Step of the sweep along the line, in standard deviations of the noise, and its bounds, pixels.
const STEP: f64 = 0.6;
const STEPS: [f64; 2] = [0.25, 1.5];
/// Step over depth, in standard deviations of the projection's noise: a sum over such steps approximates the integral
/// of a Gaussian to 0.1 %.
const FINE: f64 = 0.8;
/// Number of standard deviations beyond which a match is treated as wrong; bounds the step size.
const BEYOND: f64 = 5.0;
/// Largest distance of an agreeing frame, standard deviations.
const AGREES: f64 = 2.5;
/// The maximum is refined when half of the probability lies within this distance, pixels.
const SHARP: f64 = 6.0;
const ROUNDS: usize = 10;
const MAX_LENGTH: f64 = 10.0;

/// The attacked keypoint.
pub(crate) struct AttackedKeypoint {
    camera: Pinhole,
    segments: Vec<KnownSegment>,
}

/// A position on the keypoint's own line.
#[derive(Clone, Copy)]
struct PosteriorNode {
    segment: KnownSegment,
    t: f64,
    /// Probability of this position and its part of the line, up to a common factor.
    weight: f64,
    /// The likeliest log depth at this position.
    log_depth: f64,
}

impl AttackedKeypoint {
    pub(crate) fn new(first: &Frame<'_>, i: usize) -> Self {
        let camera = first.camera;
        Self { camera, segments: KnownSegment::of(&first.observations[i], camera.width, camera.height) }
    }

    fn ray(&self, pixel: Pixel) -> Vector3<f64> {
        let p = self.camera.unproject(pixel);
        Vector3::new(p.x, p.y, 1.0)
    }

    pub(crate) fn triangulate(
        &self,
        matched_frames: &[(&RelativeFrame, &Observation)],
        depths: &DepthPrior,
        options: &FramesOptions,
    ) -> TriangulatedKeypoint {
        let frames: Vec<Vec<Plane<'_>>> = matched_frames.iter().map(|(s, o)| s.planes(o)).collect();
        let matched = frames.len();
        let nodes: Vec<PosteriorNode> =
            self.segments.iter().flat_map(|s| self.sweep(s, &frames, depths, options)).collect();
        let total: f64 = nodes.iter().map(|n| n.weight).sum();
        let best = nodes.iter().copied().reduce(|a, b| if b.weight > a.weight { b } else { a });
        let Some(best) = best.filter(|_| total > 0.0 && total.is_finite()) else {
            return TriangulatedKeypoint::NO_MATCH;
        };
        let middle = self.median(&nodes, total);
        let near = |p: Pixel, within: f64| {
            let inside = |n: &&PosteriorNode| n.segment.at(n.t).distance(&p) <= within;
            nodes.iter().filter(inside).map(|n| n.weight).sum::<f64>() / total
        };
        let (mut t, mut log_depth) = (best.t, best.log_depth);
        let mut pixel = middle;
        if near(middle, SHARP) > 0.5 && best.segment.at(best.t).distance(&middle) < SHARP {
            (t, log_depth) = self.refined(&best, &frames, depths, options);
            pixel = best.segment.at(t);
        }
        let variance = nodes.iter().map(|n| n.weight * n.segment.at(n.t).distance(&pixel).powi(2));
        let x = self.ray(best.segment.at(t));
        let agreeing = frames.iter().filter(|f| agrees(f, x, log_depth, options)).count();
        TriangulatedKeypoint {
            pixel: Some(pixel),
            matched,
            agreeing,
            sigma_px: (variance.sum::<f64>() / total).sqrt(),
            within: near(pixel, NEAR_PX),
            by_chance: by_chance(matched, agreeing, self.camera.width, options),
        }
    }

    /// The median of the posterior, which has the smallest expected error; for two segments the geometric median.
    fn median(&self, nodes: &[PosteriorNode], total: f64) -> Pixel {
        if self.segments.len() == 1 {
            let mut sum = 0.0;
            for n in nodes {
                let before = sum;
                sum += n.weight;
                if sum >= 0.5 * total {
                    // Interpolated within the node's part of the line, to avoid an error of up to half a step.
                    let part = (n.segment.far - n.segment.near) / nodes.len() as f64;
                    let share = ((0.5 * total - before) / n.weight).clamp(0.0, 1.0);
                    return n.segment.at(n.t + part * (share - 0.5));
                }
            }
        }
        let mut at = Vector2::zeros();
        for round in 0..40 {
            let (mut sum, mut weight) = (Vector2::zeros(), 0.0);
            for n in nodes {
                let p = n.segment.at(n.t).vector();
                let w = n.weight / if round == 0 { 1.0 } else { (p - at).norm().max(0.5) };
                sum += w * p;
                weight += w;
            }
            at = sum / weight;
        }
        Pixel::new(at.x, at.y)
    }

    /// The posterior along one segment.
    fn sweep(
        &self,
        segment: &KnownSegment,
        frames: &[Vec<Plane<'_>>],
        depths: &DepthPrior,
        options: &FramesOptions,
    ) -> Vec<PosteriorNode> {
        if segment.is_empty() {
            return Vec::new();
        }
        let length = segment.far - segment.near;
        let step = (STEP * options.noise_px).clamp(STEPS[0], STEPS[1]);
        let steps = (length / step).ceil().max(1.0) as usize;
        let part = length / steps as f64;
        // Two candidate lines have equal prior probability, independent of their lengths.
        let share = part / length.max(1e-9);
        let mut ray_planes: Vec<RayPlane<'_, '_>> = Vec::with_capacity(frames.len());
        let node = |step: usize| {
            let t = segment.near + part * (step as f64 + 0.5);
            let pixel = segment.at(t);
            let ray = self.ray(pixel);
            ray_planes.clear();
            ray_planes.extend(frames.iter().flatten().map(|p| p.along(ray)));
            let prior = if segment.anchor.is_some() { part * segment.likelihood(t).max(1e-3) } else { share };
            let (likelihood, log_depth) = over_depth(&ray_planes, frames, depths, pixel, options);
            PosteriorNode { segment: *segment, t, weight: prior * likelihood, log_depth }
        };
        (0..steps).map(node).collect()
    }

    /// Least squares over `t` and log depth on the frames that agree with the node.
    fn refined(
        &self,
        start: &PosteriorNode,
        frames: &[Vec<Plane<'_>>],
        depths: &DepthPrior,
        options: &FramesOptions,
    ) -> (f64, f64) {
        let segment = start.segment;
        let (mut t, mut s) = (start.t, start.log_depth);
        for _ in 0..ROUNDS {
            let (mut normal, mut gradient) = (Matrix2::zeros(), Vector2::zeros());
            for planes in frames {
                let ray = |t: f64| self.ray(segment.at(t));
                let Some((plane, residual)) = nearest(planes, ray(t), s) else { continue };
                if residual.distance.abs() > AGREES * options.noise_px {
                    continue;
                }
                let at = |t: f64| plane.along(ray(t)).at((-s).exp()).distance;
                let j = Vector2::new((at(t + 0.1) - at(t - 0.1)) / 0.2, residual.depth_derivative);
                if j.iter().all(|x| x.is_finite()) {
                    normal += j * j.transpose();
                    gradient += j * residual.distance;
                }
            }
            // Damping: a depth without effect on the projections stays as it is.
            normal += Matrix2::new(1e-9, 0.0, 0.0, 1e-6 * options.noise_px.powi(2));
            let Some(mut step) = normal.try_inverse().map(|inverse| inverse * gradient) else { break };
            // At a depth limit only the position is refined.
            if (s <= depths.limits[0] && step.y >= 0.0) || (s >= depths.limits[1] && step.y <= 0.0) {
                step = Vector2::new(gradient.x / normal[(0, 0)], 0.0);
            }
            let moved = (t - step.x.clamp(-MAX_LENGTH, MAX_LENGTH)).clamp(segment.near, segment.far);
            if (moved - start.t).abs() > 2.0 * SHARP {
                // The iteration left the maximum it started from.
                return (start.t, start.log_depth);
            }
            t = moved;
            s = (s - step.y.clamp(-0.2, 0.2)).clamp(depths.limits[0], depths.limits[1]);
        }
        (t, s)
    }
}

/// The likelihood of all frames' lines at one position of the attacked frame, integrated over depth with its prior,
/// relative to all matches being wrong; and the likeliest log depth.
///
/// Trapezoidal rule with steps that follow the planes: near a plane no projection moves by more than a fraction of
/// the noise per step, and no step crosses a plane.
fn over_depth(
    ray_planes: &[RayPlane<'_, '_>],
    frames: &[Vec<Plane<'_>>],
    depths: &DepthPrior,
    pixel: Pixel,
    options: &FramesOptions,
) -> (f64, f64) {
    let sigma = options.noise_px;
    let peak = (1.0 - options.wrong) / (sigma * (2.0 * std::f64::consts::PI).sqrt());
    let bins = depths.at(pixel);
    let [first, last] = depths.limits;
    let longest = depths.longest_step();
    let (mut sum, mut best, mut best_depth) = (0.0, -1.0, first);
    let (mut s, mut step, mut before) = (first, 0.0, 0.0);
    loop {
        let reciprocal = (-s).exp();
        let mut next = longest;
        let mut value = 1.0;
        let mut all = ray_planes.iter();
        for planes in frames {
            let mut right = 0.0;
            for crossing in all.by_ref().take(planes.len()) {
                let PlaneResidual { distance, depth_derivative, spread } = crossing.at(reciprocal);
                let far = distance.abs();
                if far.is_finite() && depth_derivative != 0.0 {
                    next = next.min((far - BEYOND * sigma).max(FINE * sigma) / depth_derivative.abs());
                }
                if far < BEYOND * sigma {
                    right += spread * (-0.5 * (far / sigma).powi(2)).exp();
                }
            }
            value *= options.wrong + peak * right;
        }
        value *= depths.density(bins, s);
        sum += 0.5 * step * (before + value);
        if value > best {
            (best, best_depth) = (value, s);
        }
        if s >= last {
            // The depth limits are equal.
            return (if last > first { sum } else { value }, best_depth);
        }
        step = next.max(SHORTEST).min(last - s);
        s = if step >= last - s { last } else { s + step };
        before = value;
    }
}

/// Shortest step of the log depth: a plane through the attacked camera itself would require ever shorter steps.
const SHORTEST: f64 = 1e-3;

/// The candidate line of a frame that is nearest to the projection of the ray's point.
fn nearest<'a, 'b>(
    planes: &'a [Plane<'b>],
    ray: Vector3<f64>,
    log_depth: f64,
) -> Option<(&'a Plane<'b>, PlaneResidual)> {
    let residual =
        planes.iter().map(|p| (p, p.along(ray).at((-log_depth).exp()))).filter(|(_, s)| s.spread > 0.0);
    residual.min_by(|a, b| a.1.distance.abs().total_cmp(&b.1.distance.abs()))
}

fn agrees(planes: &[Plane<'_>], ray: Vector3<f64>, log_depth: f64, options: &FramesOptions) -> bool {
    nearest(planes, ray, log_depth).is_some_and(|(_, s)| s.distance.abs() <= AGREES * options.noise_px)
}

/// Expected number of such agreements among wrong matches: each pair of matches determines a point, and each other
/// line passes through it with the probability that a random line on its side of the image comes that near.
fn by_chance(matched: usize, agreeing: usize, width: u32, options: &FramesOptions) -> f64 {
    if agreeing < 3 {
        return f64::INFINITY;
    }
    let p = (2.0 * AGREES * options.noise_px / (0.5 * f64::from(width))).min(1.0);
    let others = matched - 2;
    let mut tail = 0.0;
    for k in agreeing - 2..=others {
        let choose = (0..k).map(|i| (others - i) as f64 / (i + 1) as f64).product::<f64>();
        tail += choose * p.powi(k as i32) * (1.0 - p).powi((others - k) as i32);
    }
    tail * (matched * (matched - 1)) as f64 / 2.0
}
