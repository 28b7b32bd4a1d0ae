//! The correspondences as the estimators use them: residuals in pixels, their derivatives, and their likelihood.
//!
//! # The likelihood
//! For each correspondence the logarithm of the likelihood ratio between "right, with noise" and "wrong, random". With
//! `γ` the probability that it is right, `e` the distance in pixels of the projection from the observation and `σ` the
//! scale of the noise,
//!
//! | kind | observed | spread of wrong ones | log likelihood ratio |
//! |---|---|---|---|
//! | points | position | the image, `1/(W H)` | `logit γ + log(W H / (2π σ²)) − 3 log(1 + e²/(4σ²))` |
//! | lines | offset, given the direction | its chord's share of the image, `L/(W H)` | `logit γ + log(c W H / (L σ)) − 3 log(1 + e²/(5σ²))` |
//! | anchored | angle about the anchor | the arc in which the image is seen, `1/α` | `logit γ + log(c α r / σ) − 3 log(1 + e²/(5σ²))` |
//!
//! The noise is a Student t distribution with four (points, in the plane) or five (lines) degrees of freedom, with `c =
//! 8 / (3 π √5)`: most keypoints are precise and a few are not, and under a Gaussian the few would dominate. On
//! keypoints with Gaussian noise it costs 2 % (`research/study/bound.py`). Further, `r` is the movement of the line at the
//! projection in pixels per radian, which grows with the distance from the anchor: an angle observed far from the
//! anchor contributes more than one near it, and the collapse of the scene into an anchor contributes nothing. The
//! ratio counts only when the point is in front of the camera, inside the image and, for anchored lines, in a sector of
//! the anchor (each with a small margin).

use std::collections::HashMap;
use std::hash::Hash;
use std::sync::Arc;

use veiloc_geometry::nalgebra::{Vector2, Vector3, Vector6};
use veiloc_geometry::{Anchor, CameraFromWorld, Pinhole, Pixel, PixelLine};

use crate::likelihood::camera::{CAMERA, DistortedCamera};
use crate::likelihood::outlier_density;
use crate::likelihood::problem::{Correspondences, MatchViewpoint, PoseProblem};
use crate::likelihood::visibility::visibility;

/// Degrees of freedom of the noise of points. With the two dimensions of the plane they make the exponent 3.
const POINT_FREEDOM: f64 = 4.0;

/// Degrees of freedom of the noise across a line. With the one dimension they make the exponent 3.
const LINE_FREEDOM: f64 = 5.0;

/// Priors are limited to this distance from 0 and 1: no single match may decide.
const PRIOR_LIMIT: f64 = 1e-3;

/// Inlier prior of a match that cannot be seen: far below the effect of any residual.
const UNSEEN_PRIOR: f64 = 1e-30;

/// How far outside the image, or over the border of a sector, a projection may lie, as a share of the image's width.
const MARGIN: f64 = 0.01;

/// The correspondences of one problem that has passed its check: the input of all scores and samplers. Copies for another
/// camera share what does not depend on it.
#[derive(Debug, Clone)]
pub struct Matches<'a> {
    /// The camera of the observations, without distortion.
    pub camera: Pinhole,
    /// The observations of the problem, all of one kind.
    pub observations: &'a Correspondences,
    /// Keypoint of each, numbered from 0 in order of first appearance, `[N]`.
    pub keypoint: Arc<[usize]>,
    /// How many keypoints there are.
    pub keypoints: usize,
    /// From where each was seen when the map was made, `[N]`, if known.
    seen_from: Option<&'a [MatchViewpoint]>,
    /// Map point of each, numbered from 0: points with equal coordinates are one.
    point_index: Arc<[usize]>,
    /// Covariance of each map point, `[N]`, world frame, if known.
    point_covariances: Option<&'a [[[f64; 3]; 3]]>,
    /// Map points, world frame, map units, `[N]`.
    pub points: Arc<[Vector3<f64>]>,
    /// Lines: `(a, b, c)` of unit normal in pixels. Points: `(u, v, 1)`. `[N]`.
    pub observed: Arc<[Vector3<f64>]>,
    /// Anchor of each line, `[N]`; `First` for all when there are no anchors.
    pub anchor: Arc<[Anchor]>,
    /// The part of each log likelihood ratio that does not depend on `σ`, `e` and the distance from the anchor, `[N]`.
    pub log_likelihood_const: Arc<[f64]>,
    /// Its exponential, `[N]`.
    likelihood_const: Arc<[f64]>,
    /// Prior probability that each is right, `[N]`: the sampling weight.
    pub inlier_prior: Arc<[f64]>,
    /// Logarithm of the density of the query's observations at each observation relative to an even spread, `[N]`:
    /// [`Self::log_likelihood_const`] would be smaller by this if wrong matches followed the query's observations. Used
    /// for the evidence only.
    pub log_clutter_density: Arc<[f64]>,
}

/// One correspondence under one pose.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Residual {
    /// Projection of the point, pixels.
    pub(crate) pixel: Vector2<f64>,
    /// Pixels; lines have one, points two (the second is 0 for lines).
    pub(crate) error: [f64; 2],
    /// Derivative of each by the six numbers of [`CameraFromWorld::perturbed`].
    pub(crate) jacobian: [[f64; 6]; 2],
    /// Distance from the anchor, pixels; 1 without anchors.
    pub(crate) radius: f64,
    /// Derivative of its logarithm.
    pub(crate) radius_jacobian: [f64; 6],
    /// Derivative of each error by the camera, [`CameraChange`](crate::likelihood::CameraChange); the first is by the
    /// logarithm of the focal length.
    pub(crate) by_camera: [[f64; CAMERA]; 2],
    /// The same for the logarithm of the distance.
    pub(crate) radius_by_camera: [f64; CAMERA],
}

/// One correspondence in the soft likelihood.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LikelihoodTerm {
    /// Likelihood ratio between right and wrong.
    pub(crate) ratio: f64,
    /// Probability that it is right: also the weight of `−log r`.
    pub(crate) right: f64,
    /// Weight of each squared residual.
    pub(crate) weight: f64,
}

/// Scale of the noise as the soft likelihood uses it ([`Matches::at_noise`]).
#[derive(Debug, Clone, Copy)]
pub(crate) struct NoiseScale {
    /// Divisor of the squared residual.
    divisor: f64,
    /// The noise-dependent factor of the likelihood ratio.
    factor: f64,
}

/// `Σ log(1 + ratio)` as the logarithm of products: a logarithm for each match would take as long as all the rest of it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SumOfLogs {
    log: f64,
    product: f64,
}

impl SumOfLogs {
    /// Before the next factor the product is at most this; a ratio is at most 1e30 or so.
    const MOST: f64 = 1e200;

    pub(crate) const fn new() -> Self {
        Self { log: 0.0, product: 1.0 }
    }

    pub(crate) fn add(&mut self, ratio: f64) {
        self.product *= 1.0 + ratio;
        if !(self.product < Self::MOST) {
            *self = Self { log: self.sum(), product: 1.0 };
        }
    }

    pub(crate) fn sum(&self) -> f64 {
        self.log + self.product.ln()
    }
}

impl Residual {
    /// Gradient of the loss of this match by the pose.
    pub(crate) fn score(&self, term: &LikelihoodTerm) -> Vector6<f64> {
        let [first, second] = self.jacobian.map(Vector6::from);
        (first * self.error[0] + second * self.error[1]) * term.weight
            - Vector6::from(self.radius_jacobian) * term.right
    }

    pub(crate) fn squared(&self) -> f64 {
        self.error[0] * self.error[0] + self.error[1] * self.error[1]
    }
}

impl<'a> Matches<'a> {
    /// The problem must have passed [`PoseProblem::check`]. Without a prior, each correspondence is right with
    /// probability `expected_inlier_ratio`.
    pub fn new(problem: &'a PoseProblem, expected_inlier_ratio: f64) -> Self {
        let camera = problem.camera;
        let n = problem.points.len();
        let area = f64::from(camera.width) * f64::from(camera.height);
        // Density of the noise across a line at its middle, in units of 1/σ: the `c` of the table.
        let peak = 8.0 / (3.0 * std::f64::consts::PI * LINE_FREEDOM.sqrt());
        let mut anchor = vec![Anchor::FIRST; n];
        let (observed, spread): (Vec<Vector3<f64>>, Vec<f64>) = match &problem.observations {
            Correspondences::Points { pixels } => {
                (pixels.iter().map(|p| p.homogeneous()).collect(), vec![area / std::f64::consts::TAU; n])
            }
            Correspondences::Lines { lines } => (
                lines.iter().map(|l| *l.coefficients()).collect(),
                lines.iter().map(|l| area * peak / chord_length(l, &camera)).collect(),
            ),
            Correspondences::Anchored { pencils, lines } => {
                anchor = lines.iter().map(|(a, _)| *a).collect();
                let arcs: Vec<f64> = pencils.anchors().map(|a| pencils.arc(a).length).collect();
                let line = |(a, angle): &(Anchor, f64)| {
                    *pencils
                        .line(*a, *angle)
                        .expect("lines that miss the image plane are refused")
                        .coefficients()
                };
                // The part of `r` that is common to all projections on one line; the other part is their distance from
                // the anchor.
                let spread = |(a, angle): &(Anchor, f64)| {
                    arcs[a.index()] * peak * pencils.pixels_per_radian(*a, *angle)
                };
                (lines.iter().map(line).collect(), lines.iter().map(spread).collect())
            }
        };
        let prior = |i: usize| {
            let p = problem.prior.as_ref().map_or(expected_inlier_ratio, |p| p[i]);
            p.clamp(PRIOR_LIMIT, 1.0 - PRIOR_LIMIT)
        };
        let log_likelihood_const: Arc<[f64]> =
            (0..n).map(|i| (prior(i) / (1.0 - prior(i))).ln() + spread[i].ln()).collect();
        let (keypoint, keypoints) = numbered(&problem.keypoints);
        let (point_index, _) =
            numbered(&problem.points.iter().map(|p| p.coords.map(f64::to_bits)).collect::<Vec<_>>());
        Self {
            camera,
            observations: &problem.observations,
            keypoint,
            keypoints,
            seen_from: problem.seen_from.as_deref(),
            point_index,
            point_covariances: problem.point_covariances.as_deref(),
            points: problem.points.iter().map(|p| p.coords).collect(),
            observed: observed.into(),
            anchor: anchor.into(),
            likelihood_const: log_likelihood_const.iter().map(|log| log.exp()).collect(),
            log_likelihood_const,
            inlier_prior: (0..n).map(prior).collect(),
            log_clutter_density: outlier_density::log_density(&problem.observations, &camera).into(),
        }
    }

    /// These correspondences as this pose can see them: those that it cannot see get a negligible prior.
    pub fn visible_from(&self, pose: &CameraFromWorld) -> Self {
        if self.seen_from.is_none() {
            return self.clone();
        }
        let visible: Vec<f64> = (0..self.len()).map(|i| self.visibility(i, pose).max(UNSEEN_PRIOR)).collect();
        let both = |(known, visible): (&f64, &f64)| known + visible.ln();
        Self {
            log_likelihood_const: self.log_likelihood_const.iter().zip(&visible).map(both).collect(),
            likelihood_const: self
                .likelihood_const
                .iter()
                .zip(&visible)
                .map(|(known, v)| known * v)
                .collect(),
            ..self.clone()
        }
    }

    /// Share of each correspondence, `[N]`, when they are right with these probabilities: the correspondences of one
    /// keypoint or of one map point have a common error and count as one.
    pub(crate) fn shares(&self, right: &[f64]) -> Vec<f64> {
        let sums = |of: &[usize]| {
            let mut sums = vec![0.0_f64; of.iter().max().map_or(0, |most| most + 1)];
            of.iter().zip(right).for_each(|(k, r)| sums[*k] += r);
            sums
        };
        let (by_keypoint, by_point) = (sums(&self.keypoint), sums(&self.point_index));
        let crowd = |i: usize| by_keypoint[self.keypoint[i]].max(by_point[self.point_index[i]]);
        (0..self.len()).map(|i| crowd(i).max(1.0).recip()).collect()
    }

    /// Covariance of the map point of a correspondence, if known.
    pub(crate) fn point_covariance(&self, i: usize) -> Option<&[[f64; 3]; 3]> {
        self.point_covariances.map(|all| &all[i])
    }

    /// These correspondences seen by a camera with the focal length multiplied by a factor.
    pub fn with_focal(&self, factor: f64) -> Self {
        Self { camera: self.camera_with_focal(factor), ..self.clone() }
    }

    /// These correspondences seen by another camera.
    pub fn with_camera(&self, camera: Pinhole) -> Self {
        Self { camera, ..self.clone() }
    }

    /// The camera with the focal length multiplied by a factor.
    pub(crate) fn camera_with_focal(&self, factor: f64) -> Pinhole {
        Pinhole { focal: self.camera.focal.map(|f| f * factor), ..self.camera }
    }

    /// Visibility factor of a correspondence from this pose, 0 to 1.
    pub fn visibility(&self, i: usize, pose: &CameraFromWorld) -> f64 {
        let Some(seen_from) = self.seen_from else { return 1.0 };
        let center = pose.rotation().inverse() * -pose.translation();
        visibility(&self.points[i], &seen_from[i], &center, self.camera.focal[0])
    }

    /// Keypoint and map point of a correspondence, equal for the two lines that one keypoint was sent as.
    pub(crate) fn pair(&self, i: usize) -> (usize, usize) {
        (self.keypoint[i], self.point_index[i])
    }

    /// How many correspondences there are.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// True when there is none.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// How many keypoints these correspondences belong to.
    pub fn keypoints_among(&self, correspondences: impl Iterator<Item = usize>) -> usize {
        let mut seen = vec![false; self.keypoints];
        correspondences.filter(|&i| !std::mem::replace(&mut seen[self.keypoint[i]], true)).count()
    }

    /// Residuals of one correspondence: two for points, one for lines.
    pub const fn residuals(&self) -> usize {
        self.observations.residuals()
    }

    /// Divisor of the squared residual in the likelihood, for unit noise.
    pub const fn freedom(&self) -> f64 {
        match self.observations {
            Correspondences::Points { .. } => POINT_FREEDOM,
            Correspondences::Lines { .. } | Correspondences::Anchored { .. } => LINE_FREEDOM,
        }
    }

    /// The noise-dependent part of the log likelihood (noise in pixels), to add to [`Self::log_likelihood_const`].
    pub fn noise_term(&self, noise: f64) -> f64 {
        -(self.residuals() as f64) * noise.ln()
    }

    /// This scale of the noise, pixels, for [`Self::likelihood_term`].
    pub(crate) fn at_noise(&self, noise: f64) -> NoiseScale {
        NoiseScale { divisor: self.freedom() * noise * noise, factor: self.noise_term(noise).exp() }
    }

    /// The part of one correspondence in the soft likelihood.
    pub(crate) fn likelihood_term(
        &self,
        i: usize,
        residual: &Residual,
        noise: &NoiseScale,
    ) -> LikelihoodTerm {
        let squared = residual.squared();
        let tail = 1.0 + squared / noise.divisor;
        let ratio = self.likelihood_const[i] * noise.factor * residual.radius / (tail * tail * tail);
        let right = ratio / (1.0 + ratio);
        LikelihoodTerm { ratio, right, weight: 6.0 * right / (noise.divisor + squared) }
    }

    /// Margin of the gates, pixels.
    pub fn margin(&self) -> f64 {
        MARGIN * f64::from(self.camera.width)
    }

    /// Whether the observation is possible at this projection: inside the image, in a sector of its anchor.
    fn admits(&self, i: usize, pixel: &Vector2<f64>) -> bool {
        let margin = self.margin();
        let pixel = Pixel::new(pixel.x, pixel.y);
        let is_own = match self.observations {
            Correspondences::Anchored { pencils, .. } => pencils.admits(self.anchor[i], pixel, margin),
            Correspondences::Points { .. } | Correspondences::Lines { .. } => true,
        };
        is_own && self.camera.contains(pixel, margin)
    }

    /// Residual with derivatives; `None` behind the camera or, when `gated`, where the point cannot be visible.
    #[inline]
    pub(crate) fn residual(&self, i: usize, pose: &CameraFromWorld, gated: bool) -> Option<Residual> {
        self.residual_of(&DistortedCamera::undistorted(self.camera), i, pose, gated)
    }

    /// The same for another camera. Inlined, because most callers need a part of the derivatives.
    #[inline(always)]
    pub(crate) fn residual_of(
        &self,
        camera: &DistortedCamera,
        i: usize,
        pose: &CameraFromWorld,
        gated: bool,
    ) -> Option<Residual> {
        let c = &camera.pinhole;
        let p = pose.rotation() * self.points[i] + pose.translation();
        if !(p.z > 0.0) {
            return None;
        }
        let plane = Vector2::new(p.x / p.z, p.y / p.z);
        let (distorted, by_plane) = camera.distort(&plane);
        let pixel = Vector2::new(
            c.focal[0] * distorted.x + c.principal[0],
            c.focal[1] * distorted.y + c.principal[1],
        );
        if gated && !self.admits(i, &pixel) {
            return None;
        }
        // Gradients of u and v by the point in the camera frame.
        let gradient = |axis: usize| {
            let (x, y) = (by_plane[(axis, 0)], by_plane[(axis, 1)]);
            Vector3::new(x, y, -(x * plane.x + y * plane.y)) * (c.focal[axis] / p.z)
        };
        let (du, dv) = (gradient(0), gradient(1));
        let chart = |g: Vector3<f64>| {
            let turn = p.cross(&g);
            [turn.x, turn.y, turn.z, g.x, g.y, g.z]
        };
        let o = &self.observed[i];
        let mut residual = Residual {
            pixel,
            error: [0.0; 2],
            jacobian: [[0.0; 6]; 2],
            radius: 1.0,
            radius_jacobian: [0.0; 6],
            by_camera: [[0.0; CAMERA]; 2],
            radius_by_camera: [0.0; CAMERA],
        };
        let by_change = camera.pixel_by_change(&plane, &distorted);
        match self.observations {
            Correspondences::Points { .. } => {
                residual.error = [pixel.x - o.x, pixel.y - o.y];
                residual.jacobian = [chart(du), chart(dv)];
                residual.by_camera = [by_change.map(|d| d.x), by_change.map(|d| d.y)];
            }
            Correspondences::Lines { .. } | Correspondences::Anchored { .. } => {
                residual.error[0] = o.x * pixel.x + o.y * pixel.y + o.z;
                residual.jacobian[0] = chart(du * o.x + dv * o.y);
                residual.by_camera[0] = by_change.map(|d| o.x * d.x + o.y * d.y);
            }
        }
        if let Correspondences::Anchored { pencils, .. } = self.observations {
            let anchor = pencils.homogeneous(self.anchor[i]);
            let from_anchor = pixel * anchor.z - anchor.xy();
            let squared = from_anchor.norm_squared().max(1e-12);
            residual.radius = squared.sqrt();
            let slope = from_anchor * (anchor.z / squared);
            residual.radius_jacobian = chart(du * slope.x + dv * slope.y);
            residual.radius_by_camera = by_change.map(|d| d.dot(&slope));
        }
        Some(residual)
    }

    /// Squared distance of the projection from the observation, pixels squared; `None` behind the camera.
    pub fn squared_error(&self, i: usize, pose: &CameraFromWorld) -> Option<f64> {
        let p = pose.rotation() * self.points[i] + pose.translation();
        pixel_of(&self.camera, &p).map(|pixel| self.squared_distance(i, &pixel))
    }

    /// Squared distance of a pixel from the observation.
    fn squared_distance(&self, i: usize, pixel: &Vector2<f64>) -> f64 {
        let o = &self.observed[i];
        match self.observations {
            Correspondences::Points { .. } => (pixel.x - o.x).powi(2) + (pixel.y - o.y).powi(2),
            Correspondences::Lines { .. } | Correspondences::Anchored { .. } => {
                (o.x * pixel.x + o.y * pixel.y + o.z).powi(2)
            }
        }
    }

    /// The log likelihood ratio at this scale of the noise, pixels; `None` where the point cannot be visible.
    pub(crate) fn log_likelihood_ratio(&self, i: usize, pose: &CameraFromWorld, noise: f64) -> Option<f64> {
        self.log_likelihood_ratio_at(i, &(pose.rotation() * self.points[i] + pose.translation()), noise)
    }

    /// The log likelihood ratios of all correspondences, `[N]`; `−∞` where the point cannot be visible.
    pub fn log_likelihood_ratios(&self, pose: &CameraFromWorld, noise: f64) -> Vec<f64> {
        let of = |i| self.log_likelihood_ratio(i, pose, noise).unwrap_or(f64::NEG_INFINITY);
        (0..self.len()).map(of).collect()
    }

    /// The same for a correspondence whose point is at `p` in the camera frame, map units.
    pub fn log_likelihood_ratio_at(&self, i: usize, p: &Vector3<f64>, noise: f64) -> Option<f64> {
        let pixel = pixel_of(&self.camera, p)?;
        if !self.admits(i, &pixel) {
            return None;
        }
        let log_radius = match self.observations {
            Correspondences::Anchored { pencils, .. } => {
                pencils.distance(self.anchor[i], Pixel::new(pixel.x, pixel.y)).max(1e-6).ln()
            }
            Correspondences::Points { .. } | Correspondences::Lines { .. } => 0.0,
        };
        let squared = self.squared_distance(i, &pixel);
        let tail = 3.0 * (squared / (self.freedom() * noise * noise)).ln_1p();
        Some(self.log_likelihood_const[i] + self.noise_term(noise) + log_radius - tail)
    }
}

/// Projection of a point of the camera frame; `None` when it is not in front.
fn pixel_of(c: &Pinhole, p: &Vector3<f64>) -> Option<Vector2<f64>> {
    (p.z > 0.0).then(|| {
        Vector2::new(c.focal[0] * p.x / p.z + c.principal[0], c.focal[1] * p.y / p.z + c.principal[1])
    })
}

/// The keypoints numbered from 0 in order of first appearance, and their count: the original ids have no influence, not
/// even on the order of sums.
fn numbered<T: Copy + Eq + Hash>(keypoints: &[T]) -> (Arc<[usize]>, usize) {
    let mut known: HashMap<T, usize> = HashMap::with_capacity(keypoints.len());
    let numbered = keypoints
        .iter()
        .map(|keypoint| {
            let next = known.len();
            *known.entry(*keypoint).or_insert(next)
        })
        .collect();
    (numbered, known.len())
}

/// Length of a line inside the image, at least one pixel.
fn chord_length(line: &PixelLine, camera: &Pinhole) -> f64 {
    let (w, h) = (f64::from(camera.width), f64::from(camera.height));
    let foot = line.closest_point(Pixel::new(w / 2.0, h / 2.0));
    let along = line.direction();
    // Clip foot + s·along against both pairs of sides.
    let mut span = (f64::NEG_INFINITY, f64::INFINITY);
    for (at, d, size) in [(foot.u, along.x, w), (foot.v, along.y, h)] {
        if d.abs() > 1e-12 {
            let (a, b) = (-at / d, (size - at) / d);
            span = (span.0.max(a.min(b)), span.1.min(a.max(b)));
        } else if !(0.0..=size).contains(&at) {
            return 1.0;
        }
    }
    (span.1 - span.0).max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::likelihood::CameraChange;
    use crate::likelihood::test_data::observe;
    use veiloc_geometry::nalgebra::Rotation3;
    use veiloc_geometry::{Pencils, Point3, Rigid3};

    fn problem(kind: usize) -> PoseProblem {
        let camera = Pinhole { width: 640, height: 480, focal: [500.0, 510.0], principal: [310.0, 250.0] };
        let pencils = Pencils::paper(640, 480);
        let pixels: Vec<Pixel> = (0..30)
            .map(|i| Pixel::new(f64::from(i * 97 % 640) + 0.3, f64::from(i * 53 % 480) + 0.7))
            .collect();
        let points = pixels
            .iter()
            .enumerate()
            .map(|(i, p)| Point3::from_vector(camera.unproject(*p).homogeneous() * (2.0 + 0.1 * i as f64)))
            .collect();
        let mut angles = (0..).map(f64::from);
        let observations = observe(kind, pixels, &pencils, || angles.next().unwrap_or(0.0));
        let keypoints = (0..30).collect();
        PoseProblem::new(camera, observations, keypoints, points)
    }

    fn near_identity() -> CameraFromWorld {
        Rigid3::new(Rotation3::from_euler_angles(0.01, -0.02, 0.015), Vector3::new(0.02, -0.03, 0.05))
    }

    #[test]
    fn jacobians_agree_with_finite_differences() {
        for kind in 0..3 {
            let problem = problem(kind);
            let matches = Matches::new(&problem, 0.2);
            let pose = near_identity();
            for i in 0..matches.len() {
                let here = matches.residual(i, &pose, false).expect("in front");
                for k in 0..6 {
                    let h = 1e-6;
                    let at = |s: f64| {
                        let mut step = [0.0; 6];
                        step[k] = s;
                        matches.residual(i, &pose.perturbed(&step), false).expect("in front")
                    };
                    let (plus, minus) = (at(h), at(-h));
                    for row in 0..2 {
                        let numeric = (plus.error[row] - minus.error[row]) / (2.0 * h);
                        let given = here.jacobian[row][k];
                        assert!((numeric - given).abs() < 1e-4 * (1.0 + given.abs()), "{numeric} {given}");
                    }
                    let numeric = (plus.radius / minus.radius).ln() / (2.0 * h);
                    let given = here.radius_jacobian[k];
                    assert!((numeric - given).abs() < 1e-4 * (1.0 + given.abs()), "{numeric} {given}");
                }
            }
        }
    }

    #[test]
    fn derivatives_by_camera_agree_with_finite_differences() {
        let at = CameraChange([0.02, -0.03, 0.004, 0.01, -0.02, -0.05]);
        for kind in 0..3 {
            let problem = problem(kind);
            let matches = Matches::new(&problem, 0.2);
            let pose = near_identity();
            let with = |change: &CameraChange, i: usize| {
                let camera = DistortedCamera::changed(&matches.camera, change);
                matches.residual_of(&camera, i, &pose, false).expect("in front")
            };
            for i in 0..matches.len() {
                let here = with(&at, i);
                for k in 0..CAMERA {
                    let h = 1e-6;
                    let moved = |s: f64| {
                        let mut change = at;
                        change.0[k] += s;
                        with(&change, i)
                    };
                    let (plus, minus) = (moved(h), moved(-h));
                    for row in 0..2 {
                        let numeric = (plus.error[row] - minus.error[row]) / (2.0 * h);
                        let given = here.by_camera[row][k];
                        assert!(
                            (numeric - given).abs() < 1e-3 * (1.0 + given.abs()),
                            "{k} {numeric} {given}"
                        );
                    }
                    let numeric = (plus.radius / minus.radius).ln() / (2.0 * h);
                    let given = here.radius_by_camera[k];
                    assert!((numeric - given).abs() < 1e-3 * (1.0 + given.abs()), "{k} {numeric} {given}");
                }
            }
        }
    }

    #[test]
    fn anchored_likelihood_matches_the_formula() {
        let problem = problem(2);
        let matches = Matches::new(&problem, 0.25);
        let pencils = Pencils::paper(640, 480);
        for i in 0..matches.len() {
            let pixel = problem.camera.project(
                veiloc_geometry::PlanePoint::from_camera_point(&Point3::from_vector(matches.points[i]))
                    .expect("front"),
            );
            // How far the line moves there, by a small rotation of it.
            let anchor = pencils.anchor_of(pixel);
            let turned = pencils.line(anchor, pencils.angle_of(anchor, pixel) + 1e-6).expect("in sight");
            let r = turned.signed_distance(pixel).abs() / 1e-6;
            let expected = (0.25_f64 / 0.75).ln() + (8.0 * r / (3.0 * 5.0_f64.sqrt() * 1.5)).ln();
            let found = matches.log_likelihood_ratio(i, &CameraFromWorld::identity(), 1.5).expect("visible");
            assert!((found - expected).abs() < 1e-4, "{found} {expected}");
        }
    }

    #[test]
    fn chords() {
        let camera = Pinhole { width: 640, height: 480, focal: [1.0; 2], principal: [0.0; 2] };
        let line = |u, v, angle| chord_length(&PixelLine::through(Pixel::new(u, v), angle), &camera);
        assert!((line(5.0, 100.0, 0.0) - 640.0).abs() < 1e-9);
        assert!((line(5.0, 100.0, std::f64::consts::FRAC_PI_2) - 480.0).abs() < 1e-9);
        assert!((line(0.0, 0.0, 3.0_f64.atan2(4.0)) - 800.0).abs() < 1e-9);
        assert_eq!(line(-50.0, -50.0, -std::f64::consts::FRAC_PI_4), 1.0);
        assert_eq!(line(0.0, 600.0, 0.0), 1.0);
    }
}
