//! A layout: positions of the anchors and assignment of viewing directions to them, independent of the camera.
//!
//! Everything is in the frame of an upright camera, the **layout frame**: `x` right, `y` down, `z` ahead. In the
//! paper's scheme that is the camera itself; for later frames of a session it is the camera of the first one, and their
//! orientation is the rotation against it.

use nalgebra::{Vector2, Vector3};

/// An anchor of a layout, by index.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Anchor(u8);

impl Anchor {
    /// Maximum number of anchors of a layout.
    pub const MAX_COUNT: usize = 4;
    /// The first.
    pub const FIRST: Self = Self(0);
    /// The second; every layout has one.
    pub const SECOND: Self = Self(1);
    /// The two of the paper's layout.
    pub const BOTH: [Self; 2] = [Self::FIRST, Self::SECOND];

    /// The anchor with this index; `None` from [`Self::MAX_COUNT`] on.
    pub const fn new(index: usize) -> Option<Self> {
        if index < Self::MAX_COUNT { Some(Self(index as u8)) } else { None }
    }

    /// Its index, from 0.
    pub const fn index(self) -> usize {
        self.0 as usize
    }

    /// The first `count` anchors.
    pub fn first(count: usize) -> impl ExactSizeIterator<Item = Self> + DoubleEndedIterator + Clone {
        (0..count.min(Self::MAX_COUNT) as u8).map(Self)
    }
}

/// Position of an anchor in the image plane of the layout frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum AnchorPosition {
    /// Offset from the image's centre, in image heights: `[right, down]`.
    At([f64; 2]),
    /// At infinity, in the direction of this angle (radians, from right towards down): its lines are parallel.
    Toward(f64),
}

/// Equal sectors about an axis in the image plane, between planes through the camera's centre that contain the axis. In
/// the image they are stripes along the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sectors {
    /// Direction of the axis in the image, radians from right towards down.
    pub axis: f64,
    /// Number of sectors in the full circle; a multiple of the number of anchors.
    pub count: u16,
    /// Start of the first, as a share of a sector: 0 is the image's centre.
    pub shift: f64,
}

impl Sectors {
    /// Unit vectors of the layout frame at angle 0 and at a quarter turn about the axis.
    pub(super) fn frame(&self) -> [Vector3<f64>; 2] {
        let [sin, cos] = exact_sin_cos(self.axis);
        [Vector3::z(), Vector3::new(-sin, cos, 0.0)]
    }
}

/// Anchors and the sectors assigned to them.
///
/// A direction in sector `i` (and sector `j` of the second family, if there is one) is assigned to anchor `(i + j) mod
/// n`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layout {
    anchors: [AnchorPosition; Anchor::MAX_COUNT],
    count: usize,
    sectors: Sectors,
    across: Option<Sectors>,
    /// Whether each direction may have any anchor.
    is_random: bool,
}

impl Layout {
    /// Two to four anchors and one or two families of sectors.
    ///
    /// `None` when a number is not finite, or when the count of a family is 0 or not a multiple of the number of
    /// anchors.
    pub fn new(anchors: &[AnchorPosition], sectors: Sectors, across: Option<Sectors>) -> Option<Self> {
        let count = anchors.len();
        let finite = |place: &AnchorPosition| match place {
            AnchorPosition::At(at) => at.iter().all(|x| x.is_finite()),
            AnchorPosition::Toward(angle) => angle.is_finite(),
        };
        let closes = |s: &Sectors| {
            s.axis.is_finite()
                && (0.0..1.0).contains(&s.shift)
                && s.count > 0
                && usize::from(s.count).is_multiple_of(count)
        };
        let fits = (2..=Anchor::MAX_COUNT).contains(&count)
            && anchors.iter().all(finite)
            && closes(&sectors)
            && across.as_ref().is_none_or(closes);
        let mut all = [anchors.first().copied().unwrap_or(AnchorPosition::Toward(0.0)); Anchor::MAX_COUNT];
        fits.then(|| {
            all[..count].copy_from_slice(anchors);
            Self { anchors: all, count, sectors, across, is_random: false }
        })
    }

    /// The paper's layout: a dividing line through the image's centre in the direction `angle` (radians from right
    /// towards down; π/2 is the vertical midline), with the anchors on it, `s·H/2` from the centre. With `d` its
    /// direction, the first anchor is at `-d` and is assigned the side where `d × (x − c) ≥ 0`: for the vertical
    /// midline the left half has the anchor at the top edge, the right half the one at the bottom edge.
    ///
    /// `None` unless `s` is positive and both numbers are finite.
    pub fn halves(angle: f64, s: f64) -> Option<Self> {
        let [sin, cos] = exact_sin_cos(angle);
        let at = |sign: f64| AnchorPosition::At([sign * 0.5 * s * cos, sign * 0.5 * s * sin]);
        let sectors = Sectors { axis: angle, count: 2, shift: 0.0 };
        (s > 0.0).then(|| Self::new(&[at(-1.0), at(1.0)], sectors, None)).flatten()
    }

    /// These anchors, each keypoint assigned to one of them at random, whatever its sector: as in ray clouds (Moon et al.,
    /// CVPR 2024), for tables of attacks.
    #[must_use]
    pub const fn with_random_assignment(mut self) -> Self {
        self.is_random = true;
        self
    }

    /// Whether each direction may have any anchor ([`Self::with_random_assignment`]).
    pub const fn is_random(&self) -> bool {
        self.is_random
    }

    /// The anchors' positions.
    pub fn anchors(&self) -> &[AnchorPosition] {
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
            AnchorPosition::At(at) => {
                let at = Vector2::from(at) * (height / focal);
                Vector3::new(at.x, at.y, 1.0).normalize()
            }
            AnchorPosition::Toward(angle) => {
                let [sin, cos] = exact_sin_cos(angle);
                Vector3::new(cos, sin, 0.0)
            }
        }
    }
}

/// Sine and cosine, exact for quarter turns, so that a keypoint exactly on a midline is recognized.
fn exact_sin_cos(angle: f64) -> [f64; 2] {
    let (sin, cos) = angle.sin_cos();
    [sin, cos].map(|x| if x.abs() < 1e-15 { 0.0 } else { x })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn invalid_layouts_are_rejected() {
        let anchors =
            [AnchorPosition::At([0.0, -0.5]), AnchorPosition::Toward(0.3), AnchorPosition::Toward(1.0)];
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
        assert!(Layout::new(&[AnchorPosition::At([f64::NAN, 0.0]); 2], sectors(2), None).is_none());
        assert!(Layout::new(&[AnchorPosition::Toward(f64::INFINITY); 2], sectors(2), None).is_none());
        for (angle, s) in [(f64::NAN, 1.0), (0.0, 0.0), (0.0, -1.0), (0.0, f64::INFINITY)] {
            assert!(Layout::halves(angle, s).is_none());
        }
    }

    #[test]
    fn anchors_of_the_paper_are_on_the_edges() {
        let layout = Layout::halves(FRAC_PI_2, 1.0).expect("finite");
        assert_eq!(layout.anchors(), [AnchorPosition::At([0.0, -0.5]), AnchorPosition::At([0.0, 0.5])]);
    }
}
