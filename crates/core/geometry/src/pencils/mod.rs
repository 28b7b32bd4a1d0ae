//! The pencils of Dual Convergent Lines: positions of the anchors, the anchor of each keypoint, and the angles of
//! lines.
//!
//! An anchor is a **direction** in space. The planes that contain it and the camera's centre intersect the image in
//! lines through the anchor's image: a **pencil**. Viewing directions are divided among the pencils ([`Sectors`]), and
//! the line of a keypoint is defined by its anchor and one angle: the angle of its half-plane about the anchor's
//! direction, in `[0, 2π)`. It is a half-plane because the keypoint is on one side of the anchor, and only the part of
//! it inside the anchor's sectors can contain the keypoint ([`Pencils::spans`]).
//!
//! The paper's scheme is [`Layout::halves`]: two anchors on a dividing line, whose half-planes fill one half of the
//! image each.

mod layout;

use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};

pub use layout::{Anchor, AnchorPosition, Layout, Sectors};

use crate::intrinsics::Pinhole;
use crate::line::PixelLine;
use crate::pixel::Pixel;

/// The pencils of a layout in the image of one camera.
///
/// All positions are in pixels: bearings are those of the device's own camera, and with another assumed focal length
/// the lines are still the same.
#[derive(Debug, Clone, PartialEq)]
pub struct Pencils {
    size: [f64; 2],
    focal: f64,
    /// By anchor.
    all: Vec<Pencil>,
    sectors: PlacedSectors,
    across: Option<PlacedSectors>,
    /// Whether a keypoint anywhere may have any anchor.
    is_random: bool,
}

/// An anchor and the axes about it; functionals act on `(u, v, 1)`.
#[derive(Debug, Clone, PartialEq)]
struct Pencil {
    /// `K d`: the image of the anchor, homogeneous; scaled so that distances from it are pixels.
    anchor: Vector3<f64>,
    /// Unit direction of the anchor, of angle 0 and of a quarter turn, camera frame.
    frame: [Vector3<f64>; 3],
    /// Component of a pixel's bearing along the last two.
    zero: Vector3<f64>,
    quarter: Vector3<f64>,
}

/// A family of sectors; `zero` and `quarter` as in [`Pencil`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlacedSectors {
    /// `cos` of the angle of a pixel `(u, v, 1)` about the axis, times a positive factor.
    pub zero: Vector3<f64>,
    /// `sin` of it, times the same factor.
    pub quarter: Vector3<f64>,
    /// Sectors in the full circle.
    pub count: f64,
    /// Start of the first, in sectors.
    pub shift: f64,
}

impl PlacedSectors {
    /// The sector of a pixel, plus the position in it as a fraction.
    pub fn position(&self, pixel: &Vector3<f64>) -> f64 {
        self.quarter.dot(pixel).atan2(self.zero.dot(pixel)) * (self.count / TAU) + self.shift
    }
}

/// The part of a line that can contain the keypoint: `origin + t · direction`, `near ≤ t ≤ far`, pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span {
    /// Start.
    pub near: f64,
    /// End.
    pub far: f64,
}

/// A range of angles about an anchor, radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arc {
    /// Start.
    pub from: f64,
    /// Extent; 2π is the full circle.
    pub length: f64,
}

impl Arc {
    /// Position of an angle in the arc, 0 to 1; outside of it below 0 or above 1.
    pub fn share(&self, angle: f64) -> f64 {
        // Relative to the middle, so that angles outside the arc stay on their side.
        let middle = self.from + 0.5 * self.length;
        0.5 + ((angle - middle + PI).rem_euclid(TAU) - PI) / self.length
    }
}

/// A line of a pencil in the image: the pixels `origin + t · direction`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PencilLine {
    /// The anchor's image if it is nearer than [`PencilLine::MAX_DISTANCE`]; otherwise the line's point nearest to the
    /// image's centre.
    pub origin: Pixel,
    /// Unit direction; away from the anchor if the origin is the anchor.
    pub direction: Vector2<f64>,
    /// [`Pencils::distance`] is `offset + slope · t`.
    pub offset: f64,
    /// See `offset`.
    pub slope: f64,
}

impl PencilLine {
    /// Anchors farther from the image's centre than this, pixels, are not used as the origin of lines, for numerical
    /// precision.
    pub const MAX_DISTANCE: f64 = 1e5;

    /// The pixel at `t`.
    pub fn at(&self, t: f64) -> Pixel {
        Pixel::new(self.origin.u + t * self.direction.x, self.origin.v + t * self.direction.y)
    }
}

impl Pencils {
    /// The pencils of a layout for an image with its principal point at the centre, this focal length (pixels), and the
    /// rotation `cam_from_layout`: the identity if the layout is fixed in the image.
    ///
    /// `None` unless the focal length is positive and finite.
    pub fn new(
        size: [u32; 2],
        focal: f64,
        layout: &Layout,
        cam_from_layout: &Rotation3<f64>,
    ) -> Option<Self> {
        if !(focal.is_finite() && focal > 0.0 && size[0] > 0 && size[1] > 0) {
            return None;
        }
        let size = size.map(f64::from);
        // Bearings of pixels in the camera frame, as a matrix on (u, v, 1), with z = f: components are in pixels.
        let bearing = Matrix3::new(1.0, 0.0, -0.5 * size[0], 0.0, 1.0, -0.5 * size[1], 0.0, 0.0, focal);
        let on_pixels = |direction: &Vector3<f64>| bearing.transpose() * direction;
        let pencil = |anchor: Anchor| {
            let d = layout.direction(anchor, focal, size[1]);
            // Angles start at the viewing direction of the layout, or at its vertical for an anchor there.
            let from = if d.z.abs() > MAX_FORWARD_COSINE { Vector3::y() } else { Vector3::z() };
            let zero = (from - d * d.dot(&from)).normalize();
            let frame = [d, zero, d.cross(&zero)].map(|axis| cam_from_layout * axis);
            let at = Vector3::new(
                focal * frame[0].x + 0.5 * size[0] * frame[0].z,
                focal * frame[0].y + 0.5 * size[1] * frame[0].z,
                frame[0].z,
            );
            // In pixels, if the anchor is a finite position.
            let scale = at.z.abs().max(at.xy().norm() / PencilLine::MAX_DISTANCE);
            Pencil { anchor: at / scale, frame, zero: on_pixels(&frame[1]), quarter: on_pixels(&frame[2]) }
        };
        let sectors = |sectors: &Sectors| {
            let [zero, quarter] = sectors.frame().map(|axis| on_pixels(&(cam_from_layout * axis)));
            PlacedSectors { zero, quarter, count: f64::from(sectors.count), shift: sectors.shift }
        };
        Some(Self {
            size,
            focal,
            all: Anchor::first(layout.anchors().len()).map(pencil).collect(),
            sectors: sectors(layout.sectors()),
            across: layout.across().map(sectors),
            is_random: layout.is_random(),
        })
    }

    /// The paper's pencils: vertical midline, `s = 1`, for an image of this size, fixed in it.
    ///
    /// Lines and sides do not depend on the focal length; the longer side is used.
    pub fn paper(width: u32, height: u32) -> Self {
        let layout = Layout::halves(std::f64::consts::FRAC_PI_2, 1.0).expect("finite");
        Self::of_image([width, height], &layout)
    }

    /// A layout fixed in an image of which only the size is known; the focal length is its longer side.
    pub fn of_image([width, height]: [u32; 2], layout: &Layout) -> Self {
        let size = [width.max(1), height.max(1)];
        Self::new(size, f64::from(size[0].max(size[1])), layout, &Rotation3::identity()).expect("positive")
    }

    /// Number of anchors.
    pub const fn len(&self) -> usize {
        self.all.len()
    }

    /// Always false: there are at least two.
    pub const fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// All anchors, in order.
    pub fn anchors(&self) -> impl ExactSizeIterator<Item = Anchor> + Clone + use<> {
        Anchor::first(self.all.len())
    }

    /// Width and height of the image, pixels.
    pub const fn size(&self) -> [f64; 2] {
        self.size
    }

    /// The sectors, and the second family of them.
    pub const fn sectors(&self) -> (&PlacedSectors, Option<&PlacedSectors>) {
        (&self.sectors, self.across.as_ref())
    }

    /// Position of an anchor in the image plane, `(u, v, 1)` times a factor; the last component is 0 at infinity.
    /// [`Self::distance`] is the distance between `(u, v)` times the last component and the first two.
    pub fn homogeneous(&self, anchor: Anchor) -> &Vector3<f64> {
        &self.all[anchor.index()].anchor
    }

    /// Position of an anchor; `None` when it is farther than [`PencilLine::MAX_DISTANCE`].
    pub fn position(&self, anchor: Anchor) -> Option<Pixel> {
        let at = self.homogeneous(anchor);
        let pixel = Pixel::new(at.x / at.z, at.y / at.z);
        (at.z.abs() > 1e-9 && pixel.distance(&self.center()) < PencilLine::MAX_DISTANCE).then_some(pixel)
    }

    /// Distance of a pixel from the anchor, pixels; at most [`PencilLine::MAX_DISTANCE`].
    pub fn distance(&self, anchor: Anchor, pixel: Pixel) -> f64 {
        let at = self.homogeneous(anchor);
        (pixel.vector() * at.z - at.xy()).norm()
    }

    /// The anchor of a keypoint at this pixel; of a random assignment the one that its sector would have.
    pub fn anchor_of(&self, pixel: Pixel) -> Anchor {
        let pixel = pixel.homogeneous();
        let sector = self.sectors.position(&pixel).floor()
            + self.across.as_ref().map_or(0.0, |across| across.position(&pixel).floor());
        Anchor::first(self.len()).nth(sector.rem_euclid(self.len() as f64) as usize).unwrap_or(Anchor::FIRST)
    }

    /// Whether a row of this anchor can have its keypoint at this pixel, or at most `margin` pixels from it.
    pub fn admits(&self, anchor: Anchor, pixel: Pixel, margin: f64) -> bool {
        if self.is_random {
            return true;
        }
        let pixel = pixel.homogeneous();
        if self.across.is_none() && self.sectors.count == 2.0 && self.sectors.shift == 0.0 && self.len() == 2
        {
            // Two halves: on its own side, or within the margin of the plane between them. Avoids the arc tangent.
            let (sin, cos) = (margin / self.focal).sin_cos();
            let over = self.sectors.zero.dot(&pixel).abs() * sin;
            let side = self.sectors.quarter.dot(&pixel) * cos;
            return if anchor == Anchor::FIRST { side >= -over } else { side < over };
        }
        let ends = |sectors: &PlacedSectors| {
            let (position, margin) = (sectors.position(&pixel), self.in_sectors(sectors, margin));
            [position - margin, position + margin].map(f64::floor)
        };
        let (own, across) = (ends(&self.sectors), self.across.as_ref().map_or([0.0; 2], ends));
        let count = self.len() as f64;
        let is_own = |a: f64, b: f64| (a + b).rem_euclid(count) as usize == anchor.index();
        own.iter().any(|a| across.iter().any(|b| is_own(*a, *b)))
    }

    /// Distance of a pixel from the nearest border of a sector, in pixels of the middle of the image.
    pub fn clearance(&self, pixel: Pixel) -> f64 {
        if self.is_random {
            return f64::INFINITY;
        }
        let of = |sectors: &PlacedSectors| {
            let position = sectors.position(&pixel.homogeneous());
            (position - position.round()).abs() * TAU / sectors.count * self.focal
        };
        of(&self.sectors).min(self.across.as_ref().map_or(f64::INFINITY, of))
    }

    /// Pixels in the middle of the image as a share of a sector. Of a random assignment half a sector, which reaches the
    /// sectors of both anchors from everywhere.
    pub fn in_sectors(&self, sectors: &PlacedSectors, pixels: f64) -> f64 {
        if self.is_random {
            return 0.5;
        }
        pixels / self.focal * sectors.count / TAU
    }

    /// The angle in `[0, 2π)` of the half-plane of an anchor that contains a pixel.
    pub fn angle_of(&self, anchor: Anchor, pixel: Pixel) -> f64 {
        let (pencil, pixel) = (&self.all[anchor.index()], pixel.homogeneous());
        let angle = pencil.quarter.dot(&pixel).atan2(pencil.zero.dot(&pixel)).rem_euclid(TAU);
        if angle < TAU { angle } else { 0.0 }
    }

    /// The whole line in the image that contains the half-plane of this angle; `None` if the image plane does not meet
    /// it.
    pub fn line(&self, anchor: Anchor, angle: f64) -> Option<PixelLine> {
        PixelLine::from_homogeneous(self.normal(anchor, angle))
    }

    /// The half-plane's side of its plane: a pixel of the line is in the half-plane when this is positive on `(u, v,
    /// 1)`.
    pub fn ahead(&self, anchor: Anchor, angle: f64) -> Vector3<f64> {
        let pencil = &self.all[anchor.index()];
        let (sin, cos) = angle.sin_cos();
        pencil.zero * cos + pencil.quarter * sin
    }

    /// Normal of the plane on pixels: the derivative of [`Self::ahead`] by the angle.
    fn normal(&self, anchor: Anchor, angle: f64) -> Vector3<f64> {
        let pencil = &self.all[anchor.index()];
        let (sin, cos) = angle.sin_cos();
        pencil.quarter * cos - pencil.zero * sin
    }

    /// Displacement of the line of this angle per radian, in pixels per pixel of [`Self::distance`].
    pub fn pixels_per_radian(&self, anchor: Anchor, angle: f64) -> f64 {
        // The line moves at a pixel by ahead·x / |normal_xy| per radian; that and the distance are linear along the
        // line.
        let (normal, ahead) = (self.normal(anchor, angle), self.ahead(anchor, angle));
        let Some(line) = PixelLine::from_homogeneous(normal) else { return 0.0 };
        let foot = line.closest_point(self.center());
        let far = Pixel::new(
            foot.u + self.size[0] * line.direction().x,
            foot.v + self.size[0] * line.direction().y,
        );
        let ratio = |pixel: Pixel| {
            ahead.dot(&pixel.homogeneous()).abs() / normal.xy().norm() / self.distance(anchor, pixel)
        };
        // Both are zero at the anchor itself: use the farther one of two pixels.
        if self.distance(anchor, far) > self.distance(anchor, foot) { ratio(far) } else { ratio(foot) }
    }

    /// The angles of the half-planes of an anchor that meet the image.
    pub fn arc(&self, anchor: Anchor) -> Arc {
        if self.position(anchor).is_some_and(|position| self.camera().contains(position, -1e-6)) {
            return Arc { from: 0.0, length: TAU };
        }
        // From outside, the image fills one arc about the middle's angle; its ends are corners.
        let middle = self.angle_of(anchor, self.center());
        let [w, h] = self.size;
        let off = [[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]]
            .map(|[u, v]| (self.angle_of(anchor, Pixel::new(u, v)) - middle + PI).rem_euclid(TAU) - PI);
        let (least, most) = off.iter().fold((0.0_f64, 0.0_f64), |(a, b), x| (a.min(*x), b.max(*x)));
        Arc { from: middle + least, length: most - least }
    }

    /// The line of this angle with distances along it; `None` as [`Self::line`].
    pub fn along(&self, anchor: Anchor, angle: f64) -> Option<PencilLine> {
        let line = self.line(anchor, angle)?;
        let (at, ahead) = (self.homogeneous(anchor), self.ahead(anchor, angle));
        let direction =
            if ahead.xy().dot(&line.direction()) < 0.0 { -line.direction() } else { line.direction() };
        if let Some(origin) = self.position(anchor) {
            return Some(PencilLine { origin, direction, offset: 0.0, slope: at.z.abs() });
        }
        let origin = line.closest_point(self.center());
        // Far away: the distance from the anchor changes with its component along the line.
        let offset = self.distance(anchor, origin);
        let slope = at.z * direction.dot(&(origin.vector() * at.z - at.xy())) / offset;
        Some(PencilLine { origin, direction, offset, slope })
    }

    /// The parts of the line of this angle that can contain its keypoint: inside the image, in the half-plane, in
    /// sectors of the anchor. Sorted by `t` of [`Self::along`]; may be empty.
    pub fn spans(&self, anchor: Anchor, angle: f64) -> Vec<Span> {
        let Some(line) = self.along(anchor, angle) else { return Vec::new() };
        let Some(whole) = self.in_image(&line, &self.ahead(anchor, angle)) else { return Vec::new() };
        let mut cuts = vec![whole.near, whole.far];
        for sectors in std::iter::once(&self.sectors).chain(&self.across) {
            let of = |functional: &Vector3<f64>| {
                let slope = functional.xy().dot(&line.direction);
                (functional.dot(&line.origin.homogeneous()), slope)
            };
            let (zero, quarter) = (of(&sectors.zero), of(&sectors.quarter));
            for sector in 0..sectors.count as usize {
                let (sin, cos) = ((sector as f64 - sectors.shift) * TAU / sectors.count).sin_cos();
                let (offset, slope) = (cos * quarter.0 - sin * zero.0, cos * quarter.1 - sin * zero.1);
                let t = -offset / slope;
                if t > whole.near && t < whole.far {
                    cuts.push(t);
                }
            }
        }
        cuts.sort_unstable_by(f64::total_cmp);
        let mut spans: Vec<Span> = Vec::new();
        for ends in cuts.windows(2) {
            let (near, far) = (ends[0], ends[1]);
            let is_own = || self.is_random || self.anchor_of(line.at(f64::midpoint(near, far))) == anchor;
            if far - near > 1e-9 && is_own() {
                match spans.last_mut() {
                    Some(last) if last.far == near => last.far = far,
                    _ => spans.push(Span { near, far }),
                }
            }
        }
        spans
    }

    /// The part of a line in the image and on its own side of the anchor.
    fn in_image(&self, line: &PencilLine, ahead: &Vector3<f64>) -> Option<Span> {
        let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
        let mut cut = |offset: f64, slope: f64| {
            // offset + t·slope ≥ 0
            if slope.abs() < 1e-12 {
                if offset < -1e-9 {
                    far = f64::NEG_INFINITY;
                }
            } else if slope > 0.0 {
                near = near.max(-offset / slope);
            } else {
                far = far.min(-offset / slope);
            }
        };
        cut(line.origin.u, line.direction.x);
        cut(self.size[0] - line.origin.u, -line.direction.x);
        cut(line.origin.v, line.direction.y);
        cut(self.size[1] - line.origin.v, -line.direction.y);
        let scale = ahead.norm().max(f64::MIN_POSITIVE);
        let ahead = ahead / scale;
        cut(ahead.dot(&line.origin.homogeneous()), ahead.xy().dot(&line.direction));
        (near < far).then_some(Span { near, far })
    }

    fn center(&self) -> Pixel {
        Pixel::new(0.5 * self.size[0], 0.5 * self.size[1])
    }

    /// Unit directions of an anchor, of angle 0 and of a quarter turn about it, in the frame of the device's camera.
    pub fn frame(&self, anchor: Anchor) -> &[Vector3<f64>; 3] {
        &self.all[anchor.index()].frame
    }

    /// The camera of the pencils' bearings.
    pub fn camera(&self) -> Pinhole {
        Pinhole {
            width: self.size[0] as u32,
            height: self.size[1] as u32,
            focal: [self.focal; 2],
            principal: [0.5 * self.size[0], 0.5 * self.size[1]],
        }
    }
}

/// For anchors nearer to the viewing direction than this cosine, angles start at the vertical.
const MAX_FORWARD_COSINE: f64 = 0.995;

#[cfg(test)]
mod tests;
