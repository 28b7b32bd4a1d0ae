//! The wire code of one keypoint beside its descriptor: a few bits, and their meaning.
//!
//! Lengths are multiples of a quarter pixel from the centre of the image, plus 2^15, in 16 bits. Angles are codes of
//! [`AngleBits`]. Each kind of scheme has its own row type, and none of a line scheme can hold a position.

use std::f64::consts::FRAC_PI_2;

use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{Anchor, Pinhole, Pixel, PixelLine};

use crate::bits::{BitReader, BitWriter};
use crate::{AnchoredLine, AngleBits, LayoutTurn, Observations, QueryError, Scheme};

/// Steps of a length per pixel.
const STEPS_PER_PIXEL: f64 = 4.0;
/// The code of the length zero.
const ZERO_LENGTH: i32 = 1 << 15;
/// Bits of a length.
const LENGTH_BITS: u32 = 16;

/// Row of `points` and `coordinate-permutation`: a position relative to the centre of the image, quarter pixels.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct PositionRow {
    u: u16,
    v: u16,
}

impl PositionRow {
    /// The row for a position relative to the centre of the image, pixels; `None` beyond ±8191 or not finite.
    pub fn new(u: f64, v: f64) -> Option<Self> {
        Some(Self { u: length_code(u)?, v: length_code(v)? })
    }

    fn pixel(self, [width, height]: [u32; 2]) -> Pixel {
        Pixel::new(length_of(self.u) + f64::from(width) / 2.0, length_of(self.v) + f64::from(height) / 2.0)
    }
}

/// Row of `random-lines`: the line `−sin θ · u + cos θ · v = offset`, origin in the centre of the image.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct LineRow {
    angle: u16,
    offset: u16,
}

impl LineRow {
    /// The row of the line with this angle code through a position relative to the centre of the image, pixels.
    ///
    /// The angle is chosen first and is independent of the position (rule L9). `None` for an angle code that is too
    /// large or an offset beyond ±8191 pixels.
    pub fn through(bits: AngleBits, angle: u16, u: f64, v: f64) -> Option<Self> {
        let (sin, cos) = bits.angle_of(angle).sin_cos();
        let offset = length_code(cos * v - sin * u)?;
        (u32::from(angle) < bits.levels()).then_some(Self { angle, offset })
    }

    fn line(self, bits: AngleBits, [width, height]: [u32; 2]) -> PixelLine {
        let (sin, cos) = bits.angle_of(self.angle).sin_cos();
        let center = Pixel::new(f64::from(width) / 2.0, f64::from(height) / 2.0);
        let c = -(length_of(self.offset) - sin * center.u + cos * center.v);
        PixelLine::from_homogeneous(Vector3::new(-sin, cos, c)).expect("the normal has unit length")
    }
}

/// Row of `dcl`: the anchor, and the angle of a half-plane about its direction, over the whole circle
/// ([`Pencils::angle_of`](veiloc_geometry::Pencils::angle_of)).
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct AnchoredRow {
    anchor: Anchor,
    angle: u32,
}

impl AnchoredRow {
    /// The row of a line of an anchor with this angle, radians of any turn.
    pub fn new(bits: AngleBits, anchor: Anchor, angle: f64) -> Self {
        Self { anchor, angle: bits.code_on_circle(angle) }
    }
}

/// Bits of an angle over the full circle.
const fn circle_bits(bits: AngleBits) -> u32 {
    bits.get() as u32 + 1
}

/// Bits that encode one of `anchors` anchors.
const fn anchor_bits(anchors: usize) -> u32 {
    if anchors > 2 { 2 } else { 1 }
}

/// The rows of a sealed query by scheme, `[N]`, without their descriptors.
#[derive(Clone, PartialEq, Eq)]
pub enum Rows {
    /// Of `points`.
    Points(Vec<PositionRow>),
    /// Of `random-lines`.
    RandomLines(Vec<LineRow>),
    /// Of `coordinate-permutation`.
    CoordinatePermutation(Vec<PositionRow>),
    /// Of `dcl`.
    Dcl(Vec<AnchoredRow>),
}

// L8.
impl std::fmt::Debug for Rows {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let name = match self {
            Self::Points(_) => "Points",
            Self::RandomLines(_) => "RandomLines",
            Self::CoordinatePermutation(_) => "CoordinatePermutation",
            Self::Dcl(_) => "Dcl",
        };
        write!(f, "Rows::{name}({})", self.len())
    }
}

impl Rows {
    /// How many there are.
    pub const fn len(&self) -> usize {
        match self {
            Self::Points(rows) | Self::CoordinatePermutation(rows) => rows.len(),
            Self::RandomLines(rows) => rows.len(),
            Self::Dcl(rows) => rows.len(),
        }
    }

    /// True when there are none.
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The first `count` rows, or all if there are fewer.
    pub(crate) fn first(&self, count: usize) -> Self {
        let count = count.min(self.len());
        match self {
            Self::Points(rows) => Self::Points(rows[..count].to_vec()),
            Self::RandomLines(rows) => Self::RandomLines(rows[..count].to_vec()),
            Self::CoordinatePermutation(rows) => Self::CoordinatePermutation(rows[..count].to_vec()),
            Self::Dcl(rows) => Self::Dcl(rows[..count].to_vec()),
        }
    }

    /// Whether these are rows of this scheme.
    pub const fn belong_to(&self, scheme: Scheme) -> bool {
        matches!(
            (self, scheme),
            (Self::Points(_), Scheme::Points)
                | (Self::RandomLines(_), Scheme::RandomLines)
                | (Self::CoordinatePermutation(_), Scheme::CoordinatePermutation)
                | (Self::Dcl(_), Scheme::Dcl(_))
        )
    }

    /// The observations of the rows in an image of this camera. `None` when they are not of this scheme, or the camera
    /// is invalid.
    ///
    /// `turn`: rotation of the layout of `dcl` relative to the camera.
    pub fn observations(
        &self,
        scheme: Scheme,
        bits: AngleBits,
        camera: &Pinhole,
        turn: LayoutTurn,
    ) -> Option<Observations> {
        let size = [camera.width, camera.height];
        Some(match (self, scheme) {
            (Self::Points(rows), Scheme::Points) => {
                Observations::Points(rows.iter().map(|row| row.pixel(size)).collect())
            }
            (Self::RandomLines(rows), Scheme::RandomLines) => {
                Observations::Lines(rows.iter().map(|row| row.line(bits, size)).collect())
            }
            (Self::CoordinatePermutation(rows), Scheme::CoordinatePermutation) => {
                let either = |row: &PositionRow| {
                    let sent = row.pixel(size);
                    [PixelLine::through(sent, 0.0), PixelLine::through(sent, FRAC_PI_2)]
                };
                Observations::EitherLine(rows.iter().map(either).collect())
            }
            (Self::Dcl(rows), Scheme::Dcl(layout)) => {
                let pencils = layout.pencils(camera, turn)?;
                let line = |row: &AnchoredRow| AnchoredLine {
                    anchor: row.anchor,
                    angle: bits.angle_on_circle(row.angle),
                };
                Observations::Anchored { pencils, lines: rows.iter().map(line).collect() }
            }
            (Self::Points(_) | Self::RandomLines(_) | Self::CoordinatePermutation(_) | Self::Dcl(_), _) => {
                return None;
            }
        })
    }

    /// Bits of one row.
    pub(crate) fn bits_per_row(scheme: Scheme, bits: AngleBits) -> u32 {
        match scheme {
            Scheme::Points | Scheme::CoordinatePermutation => 2 * LENGTH_BITS,
            Scheme::RandomLines => u32::from(bits.get()) + LENGTH_BITS,
            Scheme::Dcl(layout) => anchor_bits(layout.anchors()) + circle_bits(bits),
        }
    }

    /// Packs the rows one after another, most significant bit first. The number of rows is a multiple of eight in every
    /// size class, so the last byte is full.
    pub(crate) fn pack(&self, scheme: Scheme, bits: AngleBits) -> Vec<u8> {
        let angle_bits = u32::from(bits.get());
        let mut writer = BitWriter::with_capacity(self.len() * 4);
        match self {
            Self::Points(rows) | Self::CoordinatePermutation(rows) => {
                for row in rows {
                    writer.write(row.u.into(), LENGTH_BITS);
                    writer.write(row.v.into(), LENGTH_BITS);
                }
            }
            Self::RandomLines(rows) => {
                for row in rows {
                    writer.write(row.angle.into(), angle_bits);
                    writer.write(row.offset.into(), LENGTH_BITS);
                }
            }
            Self::Dcl(rows) => {
                let of_anchor = Self::bits_per_row(scheme, bits) - circle_bits(bits);
                for row in rows {
                    writer.write(row.anchor.index() as u32, of_anchor);
                    writer.write(row.angle, circle_bits(bits));
                }
            }
        }
        writer.finish()
    }

    /// Reads `count` rows from bytes whose length the caller has checked.
    pub(crate) fn unpack(scheme: Scheme, bits: AngleBits, count: usize, bytes: &[u8]) -> Self {
        let angle_bits = u32::from(bits.get());
        let mut reader = BitReader::new(bytes);
        let mut position =
            || PositionRow { u: reader.read(LENGTH_BITS) as u16, v: reader.read(LENGTH_BITS) as u16 };
        match scheme {
            Scheme::Points => Self::Points((0..count).map(|_| position()).collect()),
            Scheme::CoordinatePermutation => {
                Self::CoordinatePermutation((0..count).map(|_| position()).collect())
            }
            Scheme::RandomLines => {
                let mut row = || LineRow {
                    angle: reader.read(angle_bits) as u16,
                    offset: reader.read(LENGTH_BITS) as u16,
                };
                Self::RandomLines((0..count).map(|_| row()).collect())
            }
            Scheme::Dcl(layout) => {
                let mut row = || AnchoredRow {
                    anchor: Anchor::new(reader.read(anchor_bits(layout.anchors())) as usize)
                        .expect("two bits encode four anchors"),
                    angle: reader.read(circle_bits(bits)),
                };
                Self::Dcl((0..count).map(|_| row()).collect())
            }
        }
    }

    /// Checks that every code is possible for an image of this camera.
    pub(crate) fn check(
        &self,
        scheme: Scheme,
        bits: AngleBits,
        camera: &Pinhole,
        turn: LayoutTurn,
    ) -> Result<(), QueryError> {
        let (width, height) = (camera.width, camera.height);
        // A dithered position can lie up to half a pixel outside; rounding adds an eighth.
        let limit = |size: f64| (size / 2.0 + 1.0) * STEPS_PER_PIXEL;
        let (wide, high) = (limit(f64::from(width)), limit(f64::from(height)));
        let within = |code: u16, limit: f64| f64::from((i32::from(code) - ZERO_LENGTH).abs()) <= limit;
        let angle_ok = |angle: u16| u32::from(angle) < bits.levels();
        let bad = match self {
            Self::Points(rows) | Self::CoordinatePermutation(rows) => {
                rows.iter().position(|row| !(within(row.u, wide) && within(row.v, high)))
            }
            Self::RandomLines(rows) => {
                rows.iter().position(|row| !(within(row.offset, wide.hypot(high)) && angle_ok(row.angle)))
            }
            Self::Dcl(rows) => {
                let Scheme::Dcl(layout) = scheme else { return Err(QueryError::Row { row: 0 }) };
                let pencils = layout.pencils(camera, turn).ok_or(QueryError::Row { row: 0 })?;
                let possible = |row: &AnchoredRow| {
                    row.angle < bits.levels_of_circle()
                        && row.anchor.index() < layout.anchors()
                        && pencils.line(row.anchor, bits.angle_on_circle(row.angle)).is_some()
                };
                rows.iter().position(|row| !possible(row))
            }
        };
        bad.map_or(Ok(()), |row| Err(QueryError::Row { row }))
    }
}

/// Nearest code of a length, pixels.
fn length_code(pixels: f64) -> Option<u16> {
    let code = (pixels * STEPS_PER_PIXEL).round() + f64::from(ZERO_LENGTH);
    (1.0..=65535.0).contains(&code).then_some(code as u16)
}

fn length_of(code: u16) -> f64 {
    f64::from(i32::from(code) - ZERO_LENGTH) / STEPS_PER_PIXEL
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_round_trip() {
        for pixels in [0.0, 0.25, -0.25, 320.0, -8191.75, 8191.75] {
            assert_eq!(length_of(length_code(pixels).expect("in range")), pixels);
        }
        for pixels in [8192.5, -8193.0, f64::NAN, f64::INFINITY] {
            assert_eq!(length_code(pixels), None);
        }
    }

    #[test]
    fn random_line_passes_its_keypoint_within_rounding() {
        let (bits, size) = (AngleBits::default(), [640, 480]);
        for i in 0..4096_u16 {
            let (u, v) = (f64::from(i % 63) * 10.1 - 315.0, f64::from(i % 47) * 10.1 - 235.0);
            let row = LineRow::through(bits, i, u, v).expect("in range");
            let distance = row.line(bits, size).signed_distance(Pixel::new(u + 320.0, v + 240.0));
            assert!(distance.abs() <= 0.125 + 1e-9, "{i} {distance}");
        }
        assert!(LineRow::through(bits, 4096, 0.0, 0.0).is_none());
    }
}
