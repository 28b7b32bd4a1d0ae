//! Frames as cameras of phones give them: bytes with a row stride, in the orientation of the sensor.

use veiloc_geometry::QuarterTurns;

use crate::gray::luma;
use crate::{FeatureError, GrayImage, Mask};

/// The bytes of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PixelFormat {
    /// One byte: a gray image, or the first plane of YUV 420 (Android's `YUV_420_888`, Apple's
    /// `420YpCbCr8BiPlanar`). The planes of the colours are not needed.
    Gray,
    /// Red, green, blue, and a fourth byte that is ignored.
    Rgba,
    /// Blue, green, red, and a fourth byte that is ignored.
    Bgra,
}

impl PixelFormat {
    /// Bytes of a pixel.
    pub const fn bytes(self) -> usize {
        match self {
            Self::Gray => 1,
            Self::Rgba | Self::Bgra => 4,
        }
    }
}

/// A frame of a camera, whose bytes stay where the camera wrote them.
///
/// ```
/// use veiloc_features::{CameraFrame, PixelFormat};
/// use veiloc_geometry::QuarterTurns;
///
/// // The first plane of YUV 420: 3 x 2 pixels in rows of 4 bytes. The last row may end with its last pixel.
/// let plane = [0, 51, 102, 255, 153, 204, 255];
/// let frame = CameraFrame::new(PixelFormat::Gray, (3, 2), &plane, 4)?;
/// assert_eq!(frame.gray().data(), [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]);
/// // Clockwise: the first column becomes the first row, read from below.
/// let upright = frame.turned(QuarterTurns::from_degrees(90).expect("a quarter"));
/// assert_eq!((upright.gray().width(), upright.gray().data()), (2, [0.6, 0.0, 0.8, 0.2, 1.0, 0.4].as_slice()));
/// # Ok::<(), veiloc_features::FeatureError>(())
/// ```
#[derive(Clone, Copy)]
pub struct CameraFrame<'a> {
    format: PixelFormat,
    size: (u32, u32),
    bytes: &'a [u8],
    stride: usize,
    turns: QuarterTurns,
    hidden: Option<&'a Mask>,
}

// Image content must never reach a log (rule L8).
impl std::fmt::Debug for CameraFrame<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (width, height) = self.size;
        write!(f, "CameraFrame({width}x{height}, {:?}, {}°)", self.format, self.turns.degrees())
    }
}

impl<'a> CameraFrame<'a> {
    /// A frame of `size` (width, height, pixels) whose rows begin every `row_stride` bytes; 0 when rows follow each
    /// other without a gap. `bytes` reach at least to the end of the last row's last pixel.
    ///
    /// # Errors
    /// [`FeatureError::Empty`], [`FeatureError::Stride`], or [`FeatureError::Length`] when there are too few bytes.
    pub fn new(
        format: PixelFormat,
        size: (u32, u32),
        bytes: &'a [u8],
        row_stride: usize,
    ) -> Result<Self, FeatureError> {
        let (width, height) = size;
        if width == 0 || height == 0 {
            return Err(FeatureError::Empty { width, height });
        }
        let row = (width as usize).saturating_mul(format.bytes());
        let stride = if row_stride == 0 { row } else { row_stride };
        if stride < row {
            return Err(FeatureError::Stride { row, stride });
        }
        let expected = stride.saturating_mul(height as usize - 1).saturating_add(row);
        if bytes.len() < expected {
            return Err(FeatureError::Length { width, height, expected, actual: bytes.len() });
        }
        Ok(Self { format, size, bytes, stride, turns: QuarterTurns::NONE, hidden: None })
    }

    /// The frame that [`Self::gray`] turns clockwise, so that it stands upright. Its camera is
    /// [`Intrinsics::turned`](veiloc_geometry::Intrinsics::turned), and poses are those of the turned camera.
    #[must_use]
    pub const fn turned(self, turns: QuarterTurns) -> Self {
        Self { turns, ..self }
    }

    /// The frame with a mask of hidden pixels, as [`FrameMask::of_frame`](crate::FrameMask::of_frame) makes it: of the frame before it
    /// is turned. An [`Image`](crate::Image) of it holds nothing of what is hidden.
    ///
    /// # Errors
    /// [`FeatureError::MaskSize`] for a mask of another size.
    pub fn hiding(self, mask: Option<&'a Mask>) -> Result<Self, FeatureError> {
        mask.map_or(Ok(()), |mask| mask.check_size(self.size))?;
        Ok(Self { hidden: mask, ..self })
    }

    /// The mask of its hidden pixels, before the turn.
    pub const fn hidden(&self) -> Option<&'a Mask> {
        self.hidden
    }

    /// Width and height before the turn, pixels.
    pub const fn size(&self) -> (u32, u32) {
        self.size
    }

    /// The turn.
    pub const fn turns(&self) -> QuarterTurns {
        self.turns
    }

    /// The gray image, turned: the same samples as [`GrayImage::from_luma8`] and [`GrayImage::from_rgba8`] make. The
    /// only memory that it takes is that of the result.
    pub fn gray(&self) -> GrayImage {
        let (width, height) = self.size;
        let (columns, rows) = self.turns.size_of(self.size);
        let mut data = Vec::with_capacity(columns as usize * rows as usize);
        match self.turns.count() {
            0 => (0..height).for_each(|y| data.extend(self.row(y))),
            2 => (0..height).rev().for_each(|y| data.extend(self.row(y).rev())),
            1 => (0..width).for_each(|x| data.extend((0..height).rev().map(|y| self.sample(x, y)))),
            _ => (0..width).rev().for_each(|x| data.extend((0..height).map(|y| self.sample(x, y)))),
        }
        GrayImage::from_samples(columns, rows, data)
    }

    /// The gray bytes before the turn, `[height, width]` without gaps. A frame of them gives the same samples; those of
    /// colours are rounded.
    pub fn gray_bytes(&self) -> Vec<u8> {
        (0..self.size.1).flat_map(|y| self.row(y)).map(|sample| (sample * 255.0).round() as u8).collect()
    }

    /// Mean square of the Laplacian of the gray bytes, or the green ones: comparable between frames of one view. Blur
    /// lowers it; 0 for a frame of one shade, and for one that is less than three pixels wide or high.
    ///
    /// Hidden pixels and their neighbours do not count. Of a frame whose longer side is `n` times 480 pixels, every `n`th pixel of every `n`th row is taken.
    pub fn sharpness(&self) -> f64 {
        let [width, height] = [self.size.0, self.size.1].map(|side| side as usize);
        let step = (width.max(height) / 480).max(1);
        let (pixel, green) = (self.format.bytes(), usize::from(self.format != PixelFormat::Gray));
        let row = |y: usize| &self.bytes[y * self.stride..][..width * pixel];
        let (mut sum, mut count) = (0_u64, 0_u32);
        for y in (1..height.saturating_sub(1)).step_by(step) {
            let rows = [y - 1, y, y + 1].map(row);
            for x in (1..width.saturating_sub(1)).step_by(step) {
                let at = |row: usize, x: usize| i32::from(rows[row][x * pixel + green]);
                let around = at(0, x) + at(1, x - 1) + at(1, x + 1) + at(2, x);
                // Which frame is sealed must not depend on what is hidden.
                if self.hidden.is_some_and(|mask| mask.touches(x as f64 + 0.5, y as f64 + 0.5, 1.0)) {
                    continue;
                }
                sum += u64::from((around - 4 * at(1, x)).unsigned_abs().pow(2));
                count += 1;
            }
        }
        sum as f64 / f64::from(count.max(1))
    }

    /// The samples of a row, before the turn.
    fn row(&self, y: u32) -> impl DoubleEndedIterator<Item = f32> + '_ {
        let pixel = self.format.bytes();
        let bytes = &self.bytes[y as usize * self.stride..][..self.size.0 as usize * pixel];
        bytes.chunks_exact(pixel).map(|bytes| self.gray_of(bytes))
    }

    /// The sample of a pixel, before the turn.
    fn sample(&self, x: u32, y: u32) -> f32 {
        let pixel = self.format.bytes();
        self.gray_of(&self.bytes[y as usize * self.stride + x as usize * pixel..][..pixel])
    }

    fn gray_of(&self, pixel: &[u8]) -> f32 {
        match *pixel {
            [red, green, blue, _] if self.format == PixelFormat::Rgba => luma(red, green, blue),
            [blue, green, red, _] => luma(red, green, blue),
            _ => f32::from(pixel[0]) / 255.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Image;

    /// Colour bytes `[4, 5, 4]` without a pattern.
    fn rgba() -> Vec<u8> {
        (0..80_u32).map(|i| (i * 37 % 251) as u8).collect()
    }

    #[test]
    fn strides_and_byte_orders_do_not_change_the_samples() {
        let bytes = rgba();
        let expected = GrayImage::from_rgba8(5, 4, &bytes).expect("a frame");
        let tight = CameraFrame::new(PixelFormat::Rgba, (5, 4), &bytes, 0).expect("a frame");
        assert_eq!(tight.gray(), expected);
        let mut padded: Vec<u8> =
            bytes.chunks(20).flat_map(|row| row.iter().copied().chain([99; 7])).collect();
        padded.truncate(padded.len() - 7);
        let padded = CameraFrame::new(PixelFormat::Rgba, (5, 4), &padded, 27).expect("a frame");
        assert_eq!(padded.gray(), expected);
        let swapped: Vec<u8> = bytes.chunks(4).flat_map(|p| [p[2], p[1], p[0], p[3]]).collect();
        let bgra = CameraFrame::new(PixelFormat::Bgra, (5, 4), &swapped, 20).expect("a frame");
        assert_eq!(bgra.gray(), expected);
    }

    #[test]
    fn gray_bytes_are_those_of_the_image_before_the_turn() {
        let bytes = rgba();
        let quarter = QuarterTurns::from_degrees(90).expect("a quarter");
        let colour = CameraFrame::new(PixelFormat::Bgra, (5, 4), &bytes, 0).expect("a frame");
        let gray = colour.turned(quarter).gray_bytes();
        let rounded: Vec<u8> = colour.gray().data().iter().map(|v| (v * 255.0).round() as u8).collect();
        assert_eq!(gray, rounded);
        // Of gray bytes nothing is lost.
        let padded: Vec<u8> = gray.chunks(5).flat_map(|row| row.iter().copied().chain([9; 3])).collect();
        let frame = CameraFrame::new(PixelFormat::Gray, (5, 4), &padded, 8).expect("a frame");
        assert_eq!(frame.gray_bytes(), gray);
    }

    #[test]
    fn blur_in_any_direction_lowers_the_sharpness() {
        let bytes: Vec<u8> = (0..64 * 48_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        let frame = |bytes: &[u8]| {
            CameraFrame::new(PixelFormat::Gray, (64, 48), bytes, 0).expect("a frame").sharpness()
        };
        let sharp = frame(&bytes);
        for offset in [1, 64, 65] {
            let moved = bytes.iter().zip(bytes[offset..].iter().chain(&bytes[..offset]));
            let blurred: Vec<u8> = moved.map(|(a, b)| a.midpoint(*b)).collect();
            assert!(frame(&blurred) < 0.8 * sharp, "{offset}: {} of {sharp}", frame(&blurred));
        }
        assert_eq!(frame(&vec![7; 64 * 48]), 0.0);
        let narrow = CameraFrame::new(PixelFormat::Gray, (2, 40), &bytes, 0).expect("a frame");
        assert_eq!(narrow.sharpness(), 0.0);
    }

    #[test]
    fn four_quarter_turns_are_none() {
        let bytes = rgba();
        let quarter = QuarterTurns::from_degrees(90).expect("a quarter");
        let bytes_of = |image: &GrayImage| -> Vec<u8> {
            image.data().iter().map(|v| (v * 255.0).round() as u8).collect()
        };
        let original = CameraFrame::new(PixelFormat::Gray, (10, 8), &bytes, 0).expect("a frame");
        let mut image = original.gray();
        for turns in 1..=4 {
            let bytes = bytes_of(&image);
            let frame = CameraFrame::new(PixelFormat::Gray, (image.width(), image.height()), &bytes, 0);
            image = frame.expect("a frame").turned(quarter).gray();
            let at_once = QuarterTurns::from_degrees(90 * turns).expect("quarters");
            assert_eq!(image, original.turned(at_once).gray(), "{turns}");
        }
    }

    #[test]
    fn nothing_hidden_reaches_an_image_however_it_is_turned() {
        let shown: Vec<u8> = (0..64 * 48_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        let mask = Mask::new(64, 48, |x, y| x < 20 && y > 30 || x == 50).expect("a mask");
        let other: Vec<u8> = (0..64 * 48_u32)
            .zip(&shown)
            .map(|(i, value)| if mask.hides(i % 64, i / 64) { !value } else { *value })
            .collect();
        for degrees in [0, 90, 180, 270] {
            let turns = QuarterTurns::from_degrees(degrees).expect("quarters");
            let [a, b] = [&shown, &other].map(|bytes| {
                let frame = CameraFrame::new(PixelFormat::Gray, (64, 48), bytes, 0).expect("a frame");
                frame.hiding(Some(&mask)).expect("of its size").turned(turns)
            });
            assert_eq!(Image::from(&a).gray(), Image::from(&b).gray(), "{degrees}");
            assert_eq!(a.sharpness(), b.sharpness());
            // What is not hidden is as it was.
            let whole =
                CameraFrame::new(PixelFormat::Gray, (64, 48), &shown, 0).expect("a frame").turned(turns);
            let (gray, image, turned) = (whole.gray(), Image::from(&a), mask.turned(turns));
            let width = gray.width() as usize;
            for (at, (own, kept)) in gray.data().iter().zip(image.gray().data()).enumerate() {
                let is_hidden = turned.hides((at % width) as u32, (at / width) as u32);
                assert!(is_hidden || own == kept, "{degrees} {at}");
            }
            assert_eq!(turned.share(), mask.share());
        }
        let frame = CameraFrame::new(PixelFormat::Gray, (48, 64), &shown, 0).expect("a frame");
        assert!(matches!(frame.hiding(Some(&mask)), Err(FeatureError::MaskSize { .. })));
    }

    #[test]
    fn wrong_sizes_are_rejected() {
        let bytes = [0; 80];
        let frame = |size, bytes, stride| CameraFrame::new(PixelFormat::Rgba, size, bytes, stride).err();
        assert!(matches!(frame((0, 4), &bytes, 0), Some(FeatureError::Empty { .. })));
        assert!(matches!(frame((5, 4), &bytes, 19), Some(FeatureError::Stride { row: 20, stride: 19 })));
        let short = frame((5, 4), &bytes[..79], 0);
        assert!(matches!(short, Some(FeatureError::Length { expected: 80, actual: 79, .. })));
        assert!(frame((u32::MAX, u32::MAX), &bytes, usize::MAX).is_some());
        assert!(frame((5, 4), &bytes, 0).is_none());
    }
}
