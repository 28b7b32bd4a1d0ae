//! A layout: where the anchors are and how the directions of sight are shared among them, before any camera is chosen.
//!
//! Everything is told in the frame of an upright camera, the **layout frame**: `x` right, `y` down, `z` ahead. In the paper's
//! scheme that is the camera itself; for the later frames of a session it is the camera of the first one, and their
//! orientation says how they are turned against it.

use nalgebra::{Vector2, Vector3};

/// One of the anchors of a layout, by number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Anchor(u8);

impl Anchor {
    /// Anchors that a layout has at most.
    pub const MOST: usize = 4;
    /// The first.
    pub const FIRST: Self = Self(0);
    /// The second: every layout has one.
    pub const SECOND: Self = Self(1);
    /// The two of the paper's layout.
    pub const BOTH: [Self; 2] = [Self::FIRST, Self::SECOND];

    /// The anchor of this number; `None` from [`Self::MOST`] on.
    pub const fn new(index: usize) -> Option<Self> {
        if index < Self::MOST { Some(Self(index as u8)) } else { None }
    }

    /// Its number, from 0.
    pub const fn index(self) -> usize {
        self.0 as usize
    }

    /// The first so many.
    pub fn first(count: usize) -> impl ExactSizeIterator<Item = Self> + DoubleEndedIterator + Clone {
        (0..count.min(Self::MOST) as u8).map(Self)
    }
}

/// Where an anchor lies on the image plane of the layout frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum AnchorPlace {
    /// This far from the image's centre, in image heights: `[right, down]`.
    At([f64; 2]),
    /// Infinitely far, in the direction of this angle (radians, from right towards down): its lines are parallel.
    Toward(f64),
}

/// Equal sectors about an axis that lies in the image plane: planes through the camera's centre that all hold the axis. In the
/// image they are stripes along the axis, and there are so many in the whole circle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sectors {
    /// Direction of the axis in the image, radians from right towards down.
    pub axis: f64,
    /// How many there are in the whole circle; even or otherwise a multiple of the number of anchors.
    pub count: u16,
    /// Where the first begins, as a share of a sector: 0 begins at the image's centre.
    pub shift: f64,
}

impl Sectors {
    /// Unit vectors of the layout frame from which angles about the axis are counted, and a quarter turn on.
    pub(super) fn frame(&self) -> [Vector3<f64>; 2] {
        let [sin, cos] = exact_sin_cos(self.axis);
        [Vector3::z(), Vector3::new(-sin, cos, 0.0)]
    }
}

/// Anchors and the sectors that are joined to them.
///
/// A direction in sector `i` (and sector `j` of the second family, if there is one) is joined to anchor `(i + j) mod n`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layout {
    anchors: [AnchorPlace; Anchor::MOST],
    count: usize,
    sectors: Sectors,
    across: Option<Sectors>,
}

impl Layout {
    /// Two to four anchors and one or two families of sectors.
    ///
    /// `None` when a number is not finite, or when a family does not close: its count must be a multiple of the number of
    /// anchors, and not 0.
    pub fn new(anchors: &[AnchorPlace], sectors: Sectors, across: Option<Sectors>) -> Option<Self> {
        let count = anchors.len();
        let finite = |place: &AnchorPlace| match place {
            AnchorPlace::At(at) => at.iter().all(|x| x.is_finite()),
            AnchorPlace::Toward(angle) => angle.is_finite(),
        };
        let closes = |s: &Sectors| {
            s.axis.is_finite()
                && (0.0..1.0).contains(&s.shift)
                && s.count > 0
                && usize::from(s.count).is_multiple_of(count)
        };
        let fits = (2..=Anchor::MOST).contains(&count)
            && anchors.iter().all(finite)
            && closes(&sectors)
            && across.as_ref().is_none_or(closes);
        let mut all = [anchors.first().copied().unwrap_or(AnchorPlace::Toward(0.0)); Anchor::MOST];
        fits.then(|| {
            all[..count].copy_from_slice(anchors);
            Self { anchors: all, count, sectors, across }
        })
    }

    /// The paper's layout: a dividing line through the image's centre in the direction `angle` (radians from right towards
    /// down; π/2 is the vertical midline), the anchors on it, `s·H/2` from the centre. With `d` its direction the first
    /// anchor sits against `d` and serves the side where `d × (x − c) ≥ 0`: for the vertical midline left of it to the top
    /// edge, right of it to the bottom edge.
    ///
    /// `None` unless `s` is positive and both numbers are finite.
    pub fn halves(angle: f64, s: f64) -> Option<Self> {
        let [sin, cos] = exact_sin_cos(angle);
        let at = |sign: f64| AnchorPlace::At([sign * 0.5 * s * cos, sign * 0.5 * s * sin]);
        let sectors = Sectors { axis: angle, count: 2, shift: 0.0 };
        (s > 0.0).then(|| Self::new(&[at(-1.0), at(1.0)], sectors, None)).flatten()
    }

    /// The anchors' places.
    pub fn anchors(&self) -> &[AnchorPlace] {
        &self.anchors[..self.count]
    }

    /// The sectors.
    pub const fn sectors(&self) -> &Sectors {
        &self.sectors
    }

    /// The second family of sectors.
    pub const fn across(&self) -> Option<&Sectors> {
        self.across.as_ref()
    }

    /// Directions of the anchors in the layout frame for a camera of this focal length (pixels) and image height.
    pub(super) fn direction(&self, anchor: Anchor, focal: f64, height: f64) -> Vector3<f64> {
        match self.anchors[anchor.index()] {
            AnchorPlace::At(at) => {
                let at = Vector2::from(at) * (height / focal);
                Vector3::new(at.x, at.y, 1.0).normalize()
            }
            AnchorPlace::Toward(angle) => {
                let [sin, cos] = exact_sin_cos(angle);
                Vector3::new(cos, sin, 0.0)
            }
        }
    }
}

/// Sine and cosine, exact for quarter turns, so that a keypoint exactly on a midline is recognised as such.
fn exact_sin_cos(angle: f64) -> [f64; 2] {
    let (sin, cos) = angle.sin_cos();
    [sin, cos].map(|x| if x.abs() < 1e-15 { 0.0 } else { x })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn layouts_that_make_no_sense_are_refused() {
        let anchors = [AnchorPlace::At([0.0, -0.5]), AnchorPlace::Toward(0.3), AnchorPlace::Toward(1.0)];
        let sectors = |count| Sectors { axis: 1.0, count, shift: 0.25 };
        assert!(Layout::new(&anchors, sectors(6), Some(sectors(3))).is_some());
        assert!(Layout::new(&anchors[..1], sectors(6), None).is_none());
        assert!(Layout::new(&[anchors[0]; 5], sectors(10), None).is_none());
        for count in [0, 4, 7] {
            assert!(Layout::new(&anchors, sectors(count), None).is_none());
            assert!(Layout::new(&anchors, sectors(6), Some(sectors(count))).is_none());
        }
        for shift in [-0.1, 1.0, f64::NAN] {
            assert!(Layout::new(&anchors, Sectors { shift, ..sectors(6) }, None).is_none());
        }
        assert!(Layout::new(&[AnchorPlace::At([f64::NAN, 0.0]); 2], sectors(2), None).is_none());
        assert!(Layout::new(&[AnchorPlace::Toward(f64::INFINITY); 2], sectors(2), None).is_none());
        for (angle, s) in [(f64::NAN, 1.0), (0.0, 0.0), (0.0, -1.0), (0.0, f64::INFINITY)] {
            assert!(Layout::halves(angle, s).is_none());
        }
    }

    #[test]
    fn the_papers_anchors_are_on_its_edges() {
        let layout = Layout::halves(FRAC_PI_2, 1.0).expect("finite");
        assert_eq!(layout.anchors(), [AnchorPlace::At([0.0, -0.5]), AnchorPlace::At([0.0, 0.5])]);
    }
}
