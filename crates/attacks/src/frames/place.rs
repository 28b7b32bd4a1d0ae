//! Where on its own line a keypoint is, by the lines of other frames.

use veiloc_geometry::nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use veiloc_geometry::{Pinhole, Pixel};

use super::{Frame, FramesOptions, Sighted};
use crate::observation::Observation;
use crate::prior::KnownSegment;

/// Another frame as the attacked one sees it: `x_other = rotation · x + translation` from camera to camera.
pub(super) struct Sight {
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
    camera: Pinhole,
}

impl Sight {
    pub(super) fn new(first: &Frame<'_>, other: &Frame<'_>) -> Self {
        let relative = other.cam_from_world.compose(&first.cam_from_world.inverse());
        Self {
            rotation: *relative.rotation().matrix(),
            translation: *relative.translation(),
            camera: other.camera,
        }
    }
}

/// One frame's line of the keypoint.
struct Plane<'a> {
    sight: &'a Sight,
    /// `(a, b, c)` of unit normal, pixels.
    line: Vector3<f64>,
    /// Where a half-line begins, and whereto it runs.
    half: Option<(Pixel, Vector2<f64>)>,
}

impl Plane<'_> {
    /// The depth in the attacked frame at which the viewing ray `b` (z = 1) meets the plane.
    fn depth(&self, b: Vector3<f64>) -> f64 {
        let normal = self.normal();
        -normal.dot(&self.sight.translation) / normal.dot(&(self.sight.rotation * b))
    }

    /// `Kᵀ l`.
    fn normal(&self) -> Vector3<f64> {
        let (c, l) = (&self.sight.camera, &self.line);
        Vector3::new(c.focal[0] * l.x, c.focal[1] * l.y, c.principal[0] * l.x + c.principal[1] * l.y + l.z)
    }

    /// Signed distance of the projection from the line, pixels; `None` behind the camera, outside the image or on
    /// the wrong side of the anchor.
    fn distance(&self, x: Vector3<f64>) -> Option<f64> {
        let seen = self.sight.rotation * x + self.sight.translation;
        if seen.z <= 1e-9 {
            return None;
        }
        let c = &self.sight.camera;
        let at = Pixel::new(
            c.focal[0] * seen.x / seen.z + c.principal[0],
            c.focal[1] * seen.y / seen.z + c.principal[1],
        );
        let ahead =
            self.half.is_none_or(|(anchor, direction)| direction.dot(&(at.vector() - anchor.vector())) > 0.0);
        (ahead && c.contains(at, MARGIN)).then(|| self.line.x * at.u + self.line.y * at.v + self.line.z)
    }
}

/// Pixels that a projection may lie outside the image.
const MARGIN: f64 = 3.0;
/// Step of the sweep along the line, pixels.
const STEP: f64 = 1.5;
/// Standard deviations within which a frame agrees.
const AGREES: f64 = 2.5;

/// The attacked keypoint.
pub(super) struct Own {
    camera: Pinhole,
    segments: [Option<KnownSegment>; 2],
}

/// A point of the own line at a depth, and how likely that is.
#[derive(Clone, Copy)]
struct Hypothesis {
    segment: KnownSegment,
    t: f64,
    z: f64,
    log: f64,
}

impl Own {
    pub(super) fn new(first: &Frame<'_>, i: usize) -> Self {
        let camera = first.camera;
        Self { camera, segments: KnownSegment::of(&first.observations[i], camera.width, camera.height) }
    }

    fn ray(&self, pixel: Pixel) -> Vector3<f64> {
        let p = self.camera.unproject(pixel);
        Vector3::new(p.x, p.y, 1.0)
    }

    pub(super) fn sighted(&self, seen: &[(&Sight, &Observation)], options: &FramesOptions) -> Sighted {
        let frames: Vec<Vec<Plane<'_>>> = seen.iter().map(|(s, o)| planes(s, o)).collect();
        let matched = frames.len();
        let sweep: Vec<Hypothesis> =
            self.segments.iter().flatten().flat_map(|s| self.sweep(s, &frames, options)).collect();
        let Some(best) = sweep.iter().copied().reduce(|a, b| if b.log > a.log { b } else { a }) else {
            return Sighted::UNSEEN;
        };
        let refined = self.refine(best, &frames, options);
        if let Some((t, agreeing, sigma_px)) = refined.filter(|r| r.2 < SHARP) {
            let by_chance = by_chance(matched, agreeing, self.camera.width, options);
            return Sighted { pixel: Some(best.segment.at(t)), matched, agreeing, sigma_px, by_chance };
        }
        // Not fixed: the mean, which errs least whatever is true.
        let (mut sum, mut weight) = (Vector2::zeros(), 0.0);
        for h in &sweep {
            let w = (h.log - best.log).exp();
            sum += w * h.segment.at(h.t).vector();
            weight += w;
        }
        let mean = sum / weight;
        let agreeing = refined.map_or(0, |r| r.1);
        let sigma_px = refined.map_or(f64::INFINITY, |r| r.2);
        let pixel = Some(Pixel::new(mean.x, mean.y));
        Sighted { pixel, matched, agreeing, sigma_px, by_chance: f64::INFINITY }
    }

    /// For each step along the segment the likeliest depth that a frame proposes.
    fn sweep(
        &self,
        segment: &KnownSegment,
        frames: &[Vec<Plane<'_>>],
        options: &FramesOptions,
    ) -> Vec<Hypothesis> {
        if segment.is_empty() {
            return Vec::new();
        }
        let steps = ((segment.far - segment.near) / STEP).ceil().max(1.0) as usize;
        let mut all = Vec::with_capacity(steps);
        for step in 0..steps {
            let t = segment.near + (segment.far - segment.near) * (step as f64 + 0.5) / steps as f64;
            let ray = self.ray(segment.at(t));
            let prior = if segment.radial { t.max(1e-3).ln() } else { 0.0 };
            let proposed = frames.iter().flatten().map(|p| p.depth(ray));
            let [least, most] = options.depths;
            let best = proposed
                .filter(|z| *z >= least && *z <= most)
                .map(|z| (log_likelihood(ray * z, frames, options), z))
                .max_by(|a, b| a.0.total_cmp(&b.0));
            // No frame has a depth for it within the limits: they are all wrong, whatever the depth.
            let (log, z) =
                best.unwrap_or((frames.len() as f64 * options.wrong.ln(), f64::midpoint(least, most)));
            all.push(Hypothesis { segment: *segment, t, z, log: log + prior });
        }
        all
    }

    /// Least squares over `t` and `ln z` on the frames that agree: the new `t`, how many agree, and the standard
    /// deviation of `t`, which is infinite when they do not fix it. `None` when none agrees.
    fn refine(
        &self,
        start: Hypothesis,
        frames: &[Vec<Plane<'_>>],
        options: &FramesOptions,
    ) -> Option<(f64, usize, f64)> {
        let (mut t, mut log_z) = (start.t, start.z.ln());
        let at = |t: f64, log_z: f64| self.ray(start.segment.at(t)) * log_z.exp();
        let limit = AGREES * options.noise_px;
        let mut answer = None;
        for _ in 0..ROUNDS {
            let x = at(t, log_z);
            let agreeing: Vec<(&Plane<'_>, f64)> =
                frames.iter().filter_map(|p| nearest(p, x)).filter(|a| a.1.abs() <= limit).collect();
            if agreeing.is_empty() {
                return answer;
            }
            let (mut normal, mut gradient) = (Matrix2::zeros(), Vector2::zeros());
            for (plane, e) in &agreeing {
                // Both ways, so that a direction in which nothing changes is seen as such.
                let slope = |back: Vector3<f64>, forth: Vector3<f64>, step: f64| {
                    let ends = plane.distance(back).zip(plane.distance(forth));
                    ends.map(|(back, forth)| (forth - back) / (2.0 * step))
                };
                let by_t = slope(at(t - 0.1, log_z), at(t + 0.1, log_z), 0.1);
                let by_z = slope(at(t, log_z - 1e-3), at(t, log_z + 1e-3), 1e-3);
                // At the edge of sight nothing is said: half a gradient would pass for knowledge.
                let Some(j) = by_t.zip(by_z).map(|(t, z)| Vector2::new(t, z)) else { continue };
                normal += j * j.transpose();
                gradient += j * *e;
            }
            // The variance of t once z is free: the Schur complement.
            let [tt, tz, zz] = [normal[(0, 0)], normal[(0, 1)], normal[(1, 1)]];
            let information = if zz > 0.0 { tt - tz * tz / zz } else { 0.0 };
            let fixed = information > 1e-6 * tt.max(1e-12) && agreeing.len() > 1;
            let sigma = if fixed { options.noise_px / information.sqrt() } else { f64::INFINITY };
            answer = Some((t, agreeing.len(), sigma));
            if !fixed {
                return answer;
            }
            let Some(step) = normal.try_inverse().map(|inverse| inverse * gradient) else { return answer };
            t = (t - step.x.clamp(-LONGEST, LONGEST)).clamp(start.segment.near, start.segment.far);
            log_z = (log_z - step.y.clamp(-0.2, 0.2)).clamp(options.depths[0].ln(), options.depths[1].ln());
        }
        answer
    }
}

/// Of a point in the attacked camera's frame, each frame right within the noise or wrong.
fn log_likelihood(x: Vector3<f64>, frames: &[Vec<Plane<'_>>], options: &FramesOptions) -> f64 {
    let right = |e: f64| (1.0 - options.wrong) * (-0.5 * (e / options.noise_px).powi(2)).exp();
    let one = |planes: &Vec<Plane<'_>>| (nearest(planes, x).map_or(0.0, |e| right(e.1)) + options.wrong).ln();
    frames.iter().map(one).sum()
}

const ROUNDS: usize = 8;
const LONGEST: f64 = 10.0;
/// A place fixed less well than this, pixels, is answered by the mean along the line.
const SHARP: f64 = 40.0;

fn planes<'a>(sight: &'a Sight, observation: &Observation) -> Vec<Plane<'a>> {
    let half = match *observation {
        Observation::HalfLine { anchor, direction } => Some((anchor, direction)),
        _ => None,
    };
    let lines = observation.lines().into_iter().flatten();
    lines.map(|line| Plane { sight, line: *line.coefficients(), half }).collect()
}

/// Of a frame's candidate lines the one nearest to where `x` is seen, and how far off it is, pixels.
fn nearest<'a, 'b>(planes: &'a [Plane<'b>], x: Vector3<f64>) -> Option<(&'a Plane<'b>, f64)> {
    let all = planes.iter().filter_map(|p| p.distance(x).map(|e| (p, e)));
    all.min_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
}

/// Expected number of agreements of so many among wrong matches: each choice of two fixes a place, and each of the
/// others runs through it with the probability that a line of its side of the image comes so near.
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
