//! `dcl`, Dual Convergent Lines: a keypoint becomes the line through it and the anchor of its part of the image.
//!
//! Paper, Sec. 4.1 "Construction procedure". An image of `W × H` is cut by its midline into two halves `R1` (left) and
//! `R2` (right), and two anchors lie on that line, `a1 = (W/2, 0)` and `a2 = (W/2, H)`:
//!
//! ```text
//! l_i = line(x_i, a1)  if x_i in R1
//!       line(x_i, a2)  if x_i in R2
//! ```
//!
//! Lines of neighbours then meet in their anchor, which is far from the keypoints, or are nearly parallel across the
//! midline; the geometry-recovery attack (Sec. 4.2, Proposition 1) errs with either. Other partitions and anchors are
//! layouts of the same kind ([`DclLayout`]; anchors and parts as geometry: [`Pencils`]); the default has strips.
//!
//! A row holds the anchor and one angle about it ([`AnchoredRow`]), never a scaled line, whose norm would be `‖x − a‖`
//! (rule L1). The wire rounds the angle (rule L2); a session quantizes it on a grid before (rule L10).

use rand::Rng;
use veiloc_geometry::{Anchor, Pencils, Pinhole, Pixel};
use veiloc_protocol::{AnchoredRow, AngleBits, DclLayout, LayoutTurn, Rows};

use crate::grid::AngleGrid;
use crate::rule::FrameRule;

/// Keypoints nearer than this to an anchor, pixels, have no useful angle and are dropped.
const ANCHOR_CLEARANCE: f64 = 1.0;

/// Anchor and angle of a keypoint's `dcl` row, before the wire rounds the angle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct AnchorAngle {
    pub(crate) anchor: Anchor,
    /// Angle of its half-plane, `[0, 2π)`.
    pub(crate) angle: f64,
}

/// Computes `dcl` rows from positions.
pub(crate) struct DclLift<'a> {
    pencils: Pencils,
    grid: Option<&'a AngleGrid>,
    bits: AngleBits,
}

impl<'a> DclLift<'a> {
    pub(crate) fn new(layout: DclLayout, camera: &Pinhole, rule: &'a FrameRule, bits: AngleBits) -> Self {
        Self { pencils: pencils(layout, camera, rule.turn), grid: rule.grid.as_ref(), bits }
    }

    /// Anchor and angle of a position.
    fn anchor_angle(&self, pixel: Pixel) -> AnchorAngle {
        let anchor = self.pencils.anchor_of(pixel);
        let angle = self.pencils.angle_of(anchor, pixel);
        AnchorAngle { anchor, angle: self.grid.map_or(angle, |grid| grid.middle(anchor, angle)) }
    }

    /// Anchor and angle of each position.
    pub(crate) fn anchor_angles(&self, dithered: &[Pixel]) -> Vec<AnchorAngle> {
        dithered.iter().map(|pixel| self.anchor_angle(*pixel)).collect()
    }

    /// An anchor at random, and the angle about it, of each position: for tables of attacks.
    pub(crate) fn of_random_anchors<R: Rng + ?Sized>(
        &self,
        dithered: &[Pixel],
        rng: &mut R,
    ) -> Vec<AnchorAngle> {
        let of = |pixel: &Pixel| {
            let anchor = Anchor::BOTH[usize::from(rng.random::<bool>())];
            AnchorAngle { anchor, angle: self.pencils.angle_of(anchor, *pixel) }
        };
        dithered.iter().map(of).collect()
    }

    /// The rows of these anchors and angles. `[N]`
    pub(crate) fn rows(&self, anchor_angle: &[AnchorAngle]) -> Rows {
        Rows::Dcl(
            anchor_angle
                .iter()
                .map(|anchor_angle| AnchoredRow::new(self.bits, anchor_angle.anchor, anchor_angle.angle))
                .collect(),
        )
    }

    /// Whether a position is far enough from all anchors, and at least `band` radians (about their axis) from sector
    /// borders.
    pub(crate) fn is_clear(&self, pixel: Pixel, band: f64) -> bool {
        let pencils = &self.pencils;
        pencils.anchors().all(|anchor| pencils.distance(anchor, pixel) > ANCHOR_CLEARANCE)
            && (band <= 0.0 || pencils.clearance(pixel) >= band * pencils.camera().mean_focal())
    }
}

/// The pencils of a layout in the device's camera.
pub(crate) fn pencils(layout: DclLayout, camera: &Pinhole, turn: LayoutTurn) -> Pencils {
    layout.pencils(camera, turn).expect("the camera has a size and a focal length")
}
