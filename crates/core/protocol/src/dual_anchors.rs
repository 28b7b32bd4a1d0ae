//! The two anchors of Dual Convergent Lines as versions 1 to 3 of the wire tell lines of them: by an angle in the image over
//! the half circle.
//!
//! The image is cut by a **dividing line** through its centre. Both anchors lie on that line, at the distance
//! `s·H/2` from the centre, one on either side. With `d` the unit direction of the dividing line, the first anchor
//! sits against `d` and serves the side where `d × (x − c) ≥ 0`; the second sits along `d` and serves the other
//! side. For the vertical midline (`d` pointing down) that is the paper's choice: left of the line to the top
//! anchor `(W/2, 0)`, right of it to the bottom anchor `(W/2, H)`; a keypoint exactly on the line to the first.
//!
//! The line of a keypoint is then told by its anchor and one angle: `φ ∈ [0, π]`, measured at the anchor from the
//! direction towards the image's centre, turning into the anchor's own side. The half circle is all there is,
//! because the keypoint is known to lie on the anchor's side: a line of DCL is a half-line.

use veiloc_geometry::nalgebra::Vector2;
use veiloc_geometry::{Anchor, Pixel};

/// The anchors and dividing line of one image size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DualAnchors {
    center: Vector2<f64>,
    direction: Vector2<f64>,
    distance: f64,
}

impl DualAnchors {
    /// For an image of this size, a dividing line through its centre in the direction `angle` (radians from the
    /// `u` axis towards `v`; π/2 is the vertical midline), and anchors `s·H/2` from the centre.
    ///
    /// `None` unless `s` is positive and both numbers are finite.
    pub fn new(width: u32, height: u32, angle: f64, s: f64) -> Option<Self> {
        if !(angle.is_finite() && s.is_finite() && s > 0.0) {
            return None;
        }
        let (sin, cos) = angle.sin_cos();
        // Exact axes for the two midlines, so that a keypoint exactly on them is recognised as such.
        let snap = |x: f64| if x.abs() < 1e-15 { 0.0 } else { x };
        Some(Self {
            center: Vector2::new(f64::from(width) / 2.0, f64::from(height) / 2.0),
            direction: Vector2::new(snap(cos), snap(sin)),
            distance: s * f64::from(height) / 2.0,
        })
    }

    /// The paper's default: vertical midline, `s = 1`.
    pub fn vertical(width: u32, height: u32) -> Self {
        Self {
            center: Vector2::new(f64::from(width) / 2.0, f64::from(height) / 2.0),
            direction: Vector2::new(0.0, 1.0),
            distance: f64::from(height) / 2.0,
        }
    }

    /// Where an anchor is.
    pub fn position(&self, anchor: Anchor) -> Pixel {
        let p = self.center - self.toward_center(anchor) * self.distance;
        Pixel::new(p.x, p.y)
    }

    /// Distance of a pixel from the dividing line, positive on the first anchor's side.
    pub fn signed_side(&self, pixel: Pixel) -> f64 {
        cross(self.direction, pixel.vector() - self.center)
    }

    /// The anchor a keypoint at this pixel is joined to.
    pub fn anchor_of(&self, pixel: Pixel) -> Anchor {
        if self.signed_side(pixel) >= 0.0 { Anchor::FIRST } else { Anchor::SECOND }
    }

    /// The angle `φ ∈ [0, π]` of the half-line from `anchor` to a pixel on its side.
    pub fn angle_of(&self, anchor: Anchor, pixel: Pixel) -> f64 {
        let d = self.toward_center(anchor);
        let p = self.position(anchor);
        let x = pixel.vector() - p.vector();
        cross(d, x).max(0.0).atan2(d.dot(&x))
    }

    /// Unit direction, in the image, of the half-line with angle `φ` from `anchor`.
    pub fn ray_direction(&self, anchor: Anchor, angle: f64) -> Vector2<f64> {
        let d = self.toward_center(anchor);
        let (sin, cos) = angle.sin_cos();
        // `n` is `d` turned by a quarter towards the anchor's own side: cross(d, n) = 1.
        let n = Vector2::new(-d.y, d.x);
        d * cos + n * sin
    }

    fn toward_center(&self, anchor: Anchor) -> Vector2<f64> {
        if anchor == Anchor::FIRST { self.direction } else { -self.direction }
    }
}

fn cross(a: Vector2<f64>, b: Vector2<f64>) -> f64 {
    a.x * b.y - a.y * b.x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_the_papers() {
        let dcl = DualAnchors::vertical(640, 480);
        assert_eq!(dcl, DualAnchors::new(640, 480, std::f64::consts::FRAC_PI_2, 1.0).expect("finite"));
        assert_eq!(dcl.position(Anchor::FIRST), Pixel::new(320.0, 0.0));
        assert_eq!(dcl.position(Anchor::SECOND), Pixel::new(320.0, 480.0));
        assert_eq!(dcl.anchor_of(Pixel::new(10.0, 300.0)), Anchor::FIRST);
        assert_eq!(dcl.anchor_of(Pixel::new(600.0, 300.0)), Anchor::SECOND);
        assert_eq!(dcl.anchor_of(Pixel::new(320.0, 123.0)), Anchor::FIRST);
    }

    #[test]
    fn every_keypoint_lies_on_its_half_line() {
        for angle in [0.0, 0.4, 1.1, std::f64::consts::FRAC_PI_2, 2.5] {
            for s in [1.0, 2.0, 3.0] {
                let dcl = DualAnchors::new(640, 480, angle, s).expect("finite");
                for i in 0..64 {
                    let x = Pixel::new(f64::from(i * 97 % 640) + 0.3, f64::from(i * 53 % 480) + 0.7);
                    let anchor = dcl.anchor_of(x);
                    let phi = dcl.angle_of(anchor, x);
                    assert!((0.0..=std::f64::consts::PI).contains(&phi));
                    let r = x.distance(&dcl.position(anchor));
                    let p = dcl.position(anchor).vector() + dcl.ray_direction(anchor, phi) * r;
                    assert!((p - x.vector()).norm() < 1e-9);
                }
            }
        }
        assert!(DualAnchors::new(640, 480, f64::NAN, 1.0).is_none());
        assert!(DualAnchors::new(640, 480, 0.0, 0.0).is_none());
    }
}
