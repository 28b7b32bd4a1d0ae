//! The prior-only baseline: the best answer from the single line of a keypoint, without neighbours and without content.
//!
//! Each measure has its own best answer: [`prior_only`] for bits (the mean logarithm of the error), [`prior_median`]
//! for median errors in pixels. So what an attack gains over it comes from content alone.
//! - **Line in a random direction:** every position on it has the same probability, because the direction is
//!   independent of the keypoint: the chord's centre, for both measures.
//! - **Line of a pencil:** a wedge of angle `dφ` holds the area `r dr dφ` at distance `r` from the anchor, so the
//!   density of uniform keypoints is proportional to `r`. If the anchor's sectors leave several spans, the probability
//!   of each is proportional to the area of its part of the wedge. The answer is the position before which a share of
//!   this probability lies, [`SHARE_FOR_BITS`] or [`SHARE_FOR_PIXELS`].
//! - **One of two lines:** where both lines cross, which is right in one coordinate; for pixels moved to the centre of
//!   the image by the share [`TO_CENTER`].
//! - **Known position:** the position itself.
//!
//! The shares are fitted on 240 photographs of other places (`study privacy fit-baseline`); they differ from ½ because
//! keypoints are not uniform over the image. [`expected_positions`] has the smallest mean squared error for uniform
//! keypoints and is best for neither measure.

use veiloc_geometry::nalgebra::Vector2;
use veiloc_geometry::{Anchor, Pixel, PixelLine};

use crate::observation::{Observation, PencilRow};

/// A part of a line that can hold the keypoint: `origin + t · direction`, `near ≤ t ≤ far`, pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownSegment {
    /// The anchor, for a line that begins there; otherwise the point nearest to the image's centre.
    pub origin: Pixel,
    /// Unit direction; zero for a known position.
    pub direction: Vector2<f64>,
    /// Start of the segment. `near > far` when the line misses the image.
    pub near: f64,
    /// End of the segment.
    pub far: f64,
    /// The anchor, for a line of a pencil.
    pub anchor: Option<Anchor>,
    /// Density of the keypoint at `t`, up to one factor for the observation: the first value plus `t` times the
    /// second.
    pub growth: [f64; 2],
    /// Probability that the keypoint is in this segment, among all segments of the same observation.
    pub share: f64,
}

impl KnownSegment {
    /// The candidate segments of an observation: one for a line, two for a permuted position, one per span of a
    /// line of a pencil.
    pub fn of(observation: &Observation, width: u32, height: u32) -> Vec<Self> {
        match observation {
            Observation::Line(line) => vec![Self::of_line(line, width, height)],
            Observation::EitherLine(lines) => {
                lines.iter().map(|l| Self { share: 0.5, ..Self::of_line(l, width, height) }).collect()
            }
            Observation::Pencil(row) => Self::of_row(row),
            Observation::Known(pixel) => vec![Self::point(*pixel)],
        }
    }

    /// The segment from the first candidate to the last on the same line; `None` for one of two lines.
    pub fn hull(observation: &Observation, width: u32, height: u32) -> Option<Self> {
        let candidates = Self::of(observation, width, height);
        match (observation, candidates.as_slice()) {
            (Observation::EitherLine(_), _) => None,
            (_, [first, .., last]) => Some(Self { far: last.far, share: 1.0, ..*first }),
            (_, [only]) => Some(*only),
            (_, []) => None,
        }
    }

    /// A known position: a segment of length zero.
    fn point(pixel: Pixel) -> Self {
        Self {
            origin: pixel,
            direction: Vector2::zeros(),
            near: 0.0,
            far: 0.0,
            anchor: None,
            growth: [1.0, 0.0],
            share: 1.0,
        }
    }

    fn of_row(row: &PencilRow) -> Vec<Self> {
        let line = &row.line;
        let whole = Self {
            origin: line.origin,
            direction: line.direction,
            near: 1.0,
            far: 0.0,
            anchor: Some(row.anchor),
            growth: [line.offset, line.slope],
            share: 1.0,
        };
        if row.spans().is_empty() {
            return vec![whole];
        }
        let mut all: Vec<Self> =
            row.spans().iter().map(|s| Self { near: s.near, far: s.far, ..whole }).collect();
        let total: f64 = all.iter().map(Self::mass).sum();
        for segment in &mut all {
            segment.share = if total > 0.0 { segment.mass() / total } else { 1.0 / row.spans().len() as f64 };
        }
        all
    }

    fn of_line(line: &PixelLine, width: u32, height: u32) -> Self {
        let center = Pixel::new(f64::from(width) / 2.0, f64::from(height) / 2.0);
        let origin = line.closest_point(center);
        let direction = line.direction();
        let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
        let axes = [(origin.u, direction.x, f64::from(width)), (origin.v, direction.y, f64::from(height))];
        for (at, step, size) in axes {
            if step.abs() > 1e-12 {
                let (a, b) = (-at / step, (size - at) / step);
                near = near.max(a.min(b));
                far = far.min(a.max(b));
            } else if !(-1e-9..=size + 1e-9).contains(&at) {
                far = f64::NEG_INFINITY;
            }
        }
        Self { origin, direction, near, far, anchor: None, growth: [1.0, 0.0], share: 1.0 }
    }

    /// Density of the keypoint at `t`, up to one factor for the observation.
    pub fn likelihood(&self, t: f64) -> f64 {
        (self.growth[0] + self.growth[1] * t).max(0.0)
    }

    /// The integral of [`Self::likelihood`].
    fn mass(&self) -> f64 {
        (self.far - self.near) * self.likelihood(f64::midpoint(self.near, self.far))
    }

    /// The distance before which this share of the probability lies, 0 to 1; 0 when the line misses the image.
    fn quantile(&self, share: f64) -> f64 {
        if self.is_empty() {
            return 0.0;
        }
        let [offset, slope] = self.growth;
        let mass = share * self.mass();
        let linear = self.near + share * (self.far - self.near);
        // The integral of the density from `near` to `t` is `offset (t − near) + slope/2 (t² − near²)`.
        let constant = offset * self.near + 0.5 * slope * self.near * self.near + mass;
        let root = (offset * offset + 2.0 * slope * constant).sqrt();
        let found = (root - offset) / slope;
        if found.is_finite() { found.clamp(self.near, self.far) } else { linear }
    }

    /// The position at distance `t` from the origin.
    pub fn at(&self, t: f64) -> Pixel {
        Pixel::new(self.origin.u + t * self.direction.x, self.origin.v + t * self.direction.y)
    }

    /// True when the line does not meet the image.
    pub fn is_empty(&self) -> bool {
        // Written so that NaN is empty.
        !(self.near <= self.far && self.near.is_finite() && self.far.is_finite())
    }

    /// The expected distance from the origin; 0 when the line misses the image.
    pub fn expected(&self) -> f64 {
        if self.is_empty() {
            return 0.0;
        }
        let (a, b) = (self.near, self.far);
        let middle = f64::midpoint(a, b);
        let mass = self.mass();
        // ∫ t (g₀ + g₁ t) dt over ∫ (g₀ + g₁ t) dt: the centre plus a term for the growth.
        if mass > 0.0 { middle + self.growth[1] * (b - a).powi(3) / (12.0 * mass) } else { middle }
    }
}

/// Share of the probability nearer to the anchor than the answer, for bits.
const SHARE_FOR_BITS: f64 = 0.52;
/// The same for median errors.
const SHARE_FOR_PIXELS: f64 = 0.58;
/// How far the crossing of two lines is moved to the centre of the image, for median errors.
const TO_CENTER: f64 = 0.2;

/// The answer for each keypoint, given its own observation alone, with the smallest mean logarithm of the error: the
/// zero of all figures in bits.
///
/// `width`, `height`: the image, pixels. For a line that misses the image the result is its point nearest to the
/// centre; for a line of a pencil it is the anchor.
pub fn prior_only(observations: &[Observation], width: u32, height: u32) -> Vec<Pixel> {
    observations.iter().map(|o| answer(o, SHARE_FOR_BITS, 0.0, width, height)).collect()
}

/// The answer for each keypoint, given its own observation alone, with the smallest median error; otherwise as
/// [`prior_only`].
pub fn prior_median(observations: &[Observation], width: u32, height: u32) -> Vec<Pixel> {
    observations.iter().map(|o| answer(o, SHARE_FOR_PIXELS, TO_CENTER, width, height)).collect()
}

fn answer(observation: &Observation, share: f64, to_center: f64, width: u32, height: u32) -> Pixel {
    let segments = KnownSegment::of(observation, width, height);
    match observation {
        Observation::EitherLine([first, second]) => {
            let center = Vector2::new(f64::from(width), f64::from(height)) / 2.0;
            let crossing = first.intersection(second).map(|p| p.vector());
            let crossing = crossing.unwrap_or_else(|| expected_position(observation, width, height).vector());
            let at = crossing + to_center * (center - crossing);
            Pixel::new(at.x, at.y)
        }
        Observation::Line(_) => segments[0].at(segments[0].expected()),
        Observation::Pencil(_) => {
            let mut left = share;
            let within = segments.iter().find(|segment| {
                let found = left <= segment.share;
                left -= if found { 0.0 } else { segment.share };
                found
            });
            // Rounding may leave a little.
            let segment = within.unwrap_or(&segments[segments.len() - 1]);
            segment.at(segment.quantile((left / segment.share).min(1.0)))
        }
        Observation::Known(pixel) => *pixel,
    }
}

/// The mean of the candidates' positions, weighted by their shares.
pub(crate) fn mean(candidates: &[KnownSegment], at: impl Fn(&KnownSegment) -> (Pixel, f64)) -> Pixel {
    let (mut sum, mut weight) = (Vector2::zeros(), 0.0);
    for segment in candidates {
        let (pixel, share) = at(segment);
        sum += pixel.vector() * share;
        weight += share;
    }
    Pixel::new(sum.x / weight, sum.y / weight)
}

/// The expected position of each keypoint given its own observation alone, for uniform keypoints.
///
/// Lines that miss the image as for [`prior_only`]. Of two lines it is the mean of both expected positions.
pub fn expected_positions(observations: &[Observation], width: u32, height: u32) -> Vec<Pixel> {
    observations.iter().map(|o| expected_position(o, width, height)).collect()
}

fn expected_position(observation: &Observation, width: u32, height: u32) -> Pixel {
    mean(&KnownSegment::of(observation, width, height), |segment| {
        (segment.at(segment.expected()), segment.share)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use veiloc_geometry::{AnchorPosition, Layout, Pencils, Sectors, Span};

    /// The mean of uniform keypoints whose observation is close to the given one, by Monte Carlo.
    #[test]
    fn half_line_prior_equals_monte_carlo_mean() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for s in [1.0, 2.0] {
            let pencils = Pencils::of_image(
                [640, 480],
                &Layout::halves(std::f64::consts::FRAC_PI_2, s).expect("finite"),
            );
            let start = pencils.position(Anchor::FIRST).expect("about the image");
            for phi in [0.15_f64, 0.3, 0.5] {
                // Left of straight down.
                let ahead = Pixel::new(start.u - 200.0 * phi.sin(), start.v + 200.0 * phi.cos());
                let angle = pencils.angle_of(Anchor::FIRST, ahead);
                let (mut sum, mut n) = (0.0, 0);
                for _ in 0..400_000 {
                    let p = Pixel::new(rng.random_range(0.0..320.0), rng.random_range(0.0..480.0));
                    if (pencils.angle_of(Anchor::FIRST, p) - angle).abs() < 0.02 {
                        sum += p.distance(&start);
                        n += 1;
                    }
                }
                let observation = Observation::anchored(&pencils, Anchor::FIRST, angle);
                let answer = KnownSegment::of(&observation, 640, 480)[0].expected();
                let drawn = sum / f64::from(n);
                assert!((answer - drawn).abs() < 5.0, "s {s} φ {phi}: {answer} against {drawn}");
            }
        }
    }

    /// Stripes with anchors outside the image and at infinity: the mean of random keypoints with nearly the same
    /// angle; each of them lies in one of the spans.
    #[test]
    fn stripes_prior_equals_monte_carlo_mean() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let sectors = Sectors { axis: 1.17, count: 24, shift: 0.3 };
        let mut several = 0;
        for place in
            [AnchorPosition::At([0.2, -0.3]), AnchorPosition::At([1.5, 0.4]), AnchorPosition::Toward(0.4)]
        {
            let layout =
                Layout::new(&[place, AnchorPosition::Toward(1.6)], sectors, None).expect("it closes");
            let pencils = Pencils::of_image([640, 480], &layout);
            let near = 0.003;
            for seen in [Pixel::new(200.0, 150.0), Pixel::new(330.0, 300.0), Pixel::new(500.0, 90.0)] {
                let angle = pencils.angle_of(Anchor::FIRST, seen);
                let observation = Observation::anchored(&pencils, Anchor::FIRST, angle);
                let segments = KnownSegment::of(&observation, 640, 480);
                several += usize::from(segments.len() > 1);
                let (mut sum, mut n) = (Vector2::zeros(), 0.0);
                for _ in 0..600_000 {
                    let p = Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0));
                    let is_near = (pencils.angle_of(Anchor::FIRST, p) - angle).abs() < near;
                    if is_near && pencils.anchor_of(p) == Anchor::FIRST {
                        (sum, n) = (sum + p.vector(), n + 1.0);
                        let Observation::Pencil(row) = observation else { panic!("a pencil") };
                        assert!(row.holds(p, 6.0), "{p:?} {segments:?}");
                    }
                }
                let (drawn, answer) = (sum / n, expected_positions(&[observation], 640, 480)[0]);
                assert!(n > 100.0 && (answer.vector() - drawn).norm() < 14.0, "{place:?} {answer:?} {drawn}");
            }
        }
        assert!(several >= 3, "{several}");
    }

    #[test]
    fn spans_are_joined_at_smallest_gaps() {
        let line = Pencils::paper(640, 480).along(Anchor::FIRST, 0.3).expect("in sight");
        let ends =
            [[0.0, 1.0], [5.0, 6.0], [6.5, 7.0], [9.0, 10.0], [20.0, 21.0], [30.0, 31.0], [40.0, 41.0]];
        let mut spans: Vec<Span> = ends.iter().map(|[near, far]| Span { near: *near, far: *far }).collect();
        spans.extend([Span { near: 43.0, far: 44.0 }, Span { near: 60.0, far: 61.0 }]);
        let row = PencilRow::new(Anchor::FIRST, line, spans);
        assert_eq!(row.spans().len(), PencilRow::MAX_SPANS);
        assert_eq!(row.spans()[1], Span { near: 5.0, far: 7.0 });
        assert!(
            row.holds(line.at(6.2), 0.0) && !row.holds(line.at(8.0), 0.5) && row.holds(line.at(8.0), 1.5)
        );
    }

    #[test]
    fn prior_of_chords_and_permuted_positions() {
        let line = Observation::Line(PixelLine::through(Pixel::new(100.0, 7.0), 0.0));
        let permuted = Observation::permuted(Pixel::new(100.0, 40.0));
        let outside = Observation::Line(PixelLine::through(Pixel::new(0.0, -50.0), 0.0));
        let answers = expected_positions(&[line, permuted, outside], 640, 480);
        assert!(answers[0].distance(&Pixel::new(320.0, 7.0)) < 1e-9);
        // The mean of (100, 240), from the vertical line, and (320, 40), from the horizontal one.
        assert!(answers[1].distance(&Pixel::new(210.0, 140.0)) < 1e-9);
        assert!(answers[2].distance(&Pixel::new(320.0, -50.0)) < 1e-9);
        // The best answers: the same on a line, and the crossing of two.
        let best = prior_only(&[line, permuted, outside], 640, 480);
        assert_eq!([best[0], best[2]], [answers[0], answers[2]]);
        assert!(best[1].distance(&Pixel::new(100.0, 40.0)) < 1e-9);
        let median = prior_median(&[line, permuted, outside], 640, 480);
        assert!(median[1].distance(&Pixel::new(144.0, 80.0)) < 1e-9);
        let known = Observation::Known(Pixel::new(3.0, 4.0));
        assert_eq!(prior_only(&[known], 640, 480), [Pixel::new(3.0, 4.0)]);
    }

    /// Half of uniform keypoints with nearly one angle are nearer to the anchor than the quantile of one half, also with
    /// several spans.
    #[test]
    fn quantiles_divide_the_probability() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let sectors = Sectors { axis: 1.17, count: 24, shift: 0.3 };
        let place = AnchorPosition::At([0.2, -0.3]);
        let stripes = Layout::new(&[place, AnchorPosition::Toward(1.6)], sectors, None).expect("it closes");
        let halves = Layout::halves(std::f64::consts::FRAC_PI_2, 1.0).expect("finite");
        for (layout, seen) in [(stripes, Pixel::new(330.0, 300.0)), (halves, Pixel::new(120.0, 300.0))] {
            let pencils = Pencils::of_image([640, 480], &layout);
            let angle = pencils.angle_of(Anchor::FIRST, seen);
            let observation = Observation::anchored(&pencils, Anchor::FIRST, angle);
            let origin = KnownSegment::of(&observation, 640, 480)[0].origin;
            let mut distances = Vec::new();
            for _ in 0..400_000 {
                let p = Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0));
                let is_near = (pencils.angle_of(Anchor::FIRST, p) - angle).abs() < 0.004;
                if is_near && pencils.anchor_of(p) == Anchor::FIRST {
                    distances.push(p.distance(&origin));
                }
            }
            for share in [0.1, 0.5, 0.9] {
                let at = answer(&observation, share, 0.0, 640, 480).distance(&origin);
                let nearer = distances.iter().filter(|d| **d < at).count() as f64 / distances.len() as f64;
                assert!(distances.len() > 100 && (nearer - share).abs() < 0.08, "{share}: {nearer}");
            }
        }
    }
}
