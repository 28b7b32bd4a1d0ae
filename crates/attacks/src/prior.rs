//! What is known of a keypoint before any neighbour is asked: a piece of a line, and where on it to bet.
//!
//! Keypoints are taken to be spread evenly over the image. The bet is the expected position given what was sent,
//! which has the smallest mean squared error of all bets.
//! - **Line in a random direction:** every keypoint on it is as likely, the direction having been drawn without
//!   looking: uniform along the chord in the image, so the chord's middle.
//! - **Half-line from an anchor:** a wedge of angle `dφ` holds the area `r dr dφ` at distance `r`, so far keypoints
//!   are likelier in proportion to `r`; between the distances `a` and `b` where the half-line is in the image the
//!   expected distance is `⅔ (b³ − a³)/(b² − a²)`. The half-line is on its anchor's own side by construction.
//! - **Either of two lines:** the mean of what each would say, both being as likely.
//! - **Known position:** itself.

use veiloc_geometry::nalgebra::Vector2;
use veiloc_geometry::{Pixel, PixelLine};

use crate::observation::Observation;

/// The part of a line or half-line that lies in the image: `origin + t · direction`, `near ≤ t ≤ far`, pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownSegment {
    /// The anchor of a half-line; of a line, its point nearest to the image's centre.
    pub origin: Pixel,
    /// Unit direction; zero for a known position.
    pub direction: Vector2<f64>,
    /// Where the image begins. `near > far` when the line misses the image.
    pub near: f64,
    /// Where it ends.
    pub far: f64,
    /// Whether likelihood grows with the distance from `origin` (a half-line from an anchor).
    pub radial: bool,
}

impl KnownSegment {
    /// The candidates of an observation: one, or two for a permuted position.
    pub fn of(observation: &Observation, width: u32, height: u32) -> [Option<Self>; 2] {
        match *observation {
            Observation::Line(line) => [Some(Self::of_line(&line, width, height)), None],
            Observation::EitherLine([a, b]) => {
                [Some(Self::of_line(&a, width, height)), Some(Self::of_line(&b, width, height))]
            }
            Observation::HalfLine { anchor, direction } => {
                [Some(Self::clipped(anchor, direction, 0.0, true, width, height)), None]
            }
            Observation::Known(pixel) => [Some(Self::point(pixel)), None],
        }
    }

    /// A position that is known: a segment without length.
    fn point(pixel: Pixel) -> Self {
        Self { origin: pixel, direction: Vector2::zeros(), near: 0.0, far: 0.0, radial: false }
    }

    fn of_line(line: &PixelLine, width: u32, height: u32) -> Self {
        let center = Pixel::new(f64::from(width) / 2.0, f64::from(height) / 2.0);
        let origin = line.closest_point(center);
        Self::clipped(origin, line.direction(), f64::NEG_INFINITY, false, width, height)
    }

    fn clipped(
        origin: Pixel,
        direction: Vector2<f64>,
        begin: f64,
        radial: bool,
        width: u32,
        height: u32,
    ) -> Self {
        let (mut near, mut far) = (begin, f64::INFINITY);
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
        Self { origin, direction, near, far, radial }
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
        if self.radial && a + b > 0.0 {
            2.0 / 3.0 * (a * a + a * b + b * b) / (a + b)
        } else {
            f64::midpoint(a, b)
        }
    }
}

/// The expected position of each keypoint when nothing is known but its own observation (module docs).
///
/// `width`, `height`: the image, pixels. A line that misses the image answers its point nearest to the centre,
/// a half-line its anchor.
pub fn prior_only(observations: &[Observation], width: u32, height: u32) -> Vec<Pixel> {
    observations
        .iter()
        .map(|o| {
            let points = KnownSegment::of(o, width, height).map(|s| s.map(|s| s.at(s.expected())));
            match points {
                [Some(a), Some(b)] => Pixel::new(f64::midpoint(a.u, b.u), f64::midpoint(a.v, b.v)),
                [Some(a), None] | [None, Some(a)] => a,
                [None, None] => Pixel::new(f64::NAN, f64::NAN),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use veiloc_geometry::{Anchor, Layout, Pencils};

    /// The mean of evenly spread keypoints whose observation is nearly the given one, found by drawing.
    #[test]
    fn half_line_answers_the_mean_of_keypoints_in_a_thin_wedge() {
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
                let answer = KnownSegment::of(&observation, 640, 480)[0].expect("one").expected();
                let drawn = sum / f64::from(n);
                assert!((answer - drawn).abs() < 5.0, "s {s} φ {phi}: {answer} against {drawn}");
            }
        }
    }

    #[test]
    fn chords_and_permuted_positions() {
        let line = Observation::Line(PixelLine::through(Pixel::new(100.0, 7.0), 0.0));
        let permuted = Observation::permuted(Pixel::new(100.0, 40.0));
        let outside = Observation::Line(PixelLine::through(Pixel::new(0.0, -50.0), 0.0));
        let answers = prior_only(&[line, permuted, outside], 640, 480);
        assert!(answers[0].distance(&Pixel::new(320.0, 7.0)) < 1e-9);
        // The mean of (100, 240), from the vertical line, and (320, 40), from the horizontal one.
        assert!(answers[1].distance(&Pixel::new(210.0, 140.0)) < 1e-9);
        assert!(answers[2].distance(&Pixel::new(320.0, -50.0)) < 1e-9);
    }
}
