//! Masks: parts of an image that must not be revealed.
//!
//! Hidden pixels are replaced by an extrapolation of their surroundings ([`GrayImage::without`]) before any other step,
//! so that nothing depends on them: two images that differ only under the mask have equal features. Keypoints whose
//! window touches the mask are then dropped: the mask's border causes some, and their descriptors would show its
//! course.

use std::path::{Path, PathBuf};

use image::DynamicImage;
use veiloc_geometry::QuarterTurns;

use crate::load::decode;
use crate::{FeatureError, GrayImage};

/// The hidden pixels of an image. At least one pixel is hidden, and at least one is visible.
#[derive(Clone, PartialEq, Eq)]
pub struct Mask {
    width: u32,
    height: u32,
    /// Hidden columns `[from, to)` of all rows, row after row, rising.
    spans: Vec<[u32; 2]>,
    /// `[height + 1]`: index in `spans` at which each row begins.
    rows: Vec<usize>,
    /// The file it was read from, for messages.
    file: Option<PathBuf>,
}

// The position of people must not be logged (rule L8).
impl std::fmt::Debug for Mask {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Mask({}x{})", self.width, self.height)
    }
}

impl Mask {
    /// Pixels for which `hides(column, row)` is true are hidden.
    ///
    /// # Errors
    /// [`FeatureError::Empty`] for a size of 0; [`FeatureError::HidesNothing`] and [`FeatureError::HidesAll`], which
    /// are certainly mistakes: an inverted mask, or that of another image.
    pub fn new(width: u32, height: u32, hides: impl FnMut(u32, u32) -> bool) -> Result<Self, FeatureError> {
        if width == 0 || height == 0 {
            return Err(FeatureError::Empty { width, height });
        }
        let mask = Self::of(width, height, hides);
        match mask.share() {
            0.0 => Err(FeatureError::HidesNothing { mask: None }),
            1.0 => Err(FeatureError::HidesAll { mask: None }),
            _ => Ok(mask),
        }
    }

    /// The same without checks.
    fn of(width: u32, height: u32, mut hides: impl FnMut(u32, u32) -> bool) -> Self {
        let (mut spans, mut rows) = (Vec::new(), vec![0]);
        for row in 0..height {
            let mut begun = None;
            for column in 0..width {
                match (begun, hides(column, row)) {
                    (None, true) => begun = Some(column),
                    (Some(from), false) => {
                        spans.push([from, column]);
                        begun = None;
                    }
                    (None, false) | (Some(_), true) => {}
                }
            }
            spans.extend(begun.map(|from| [from, width]));
            rows.push(spans.len());
        }
        Self { width, height, spans, rows, file: None }
    }

    /// Columns.
    pub const fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub const fn height(&self) -> u32 {
        self.height
    }

    /// Share of the pixels that are hidden, above 0 and below 1.
    pub fn share(&self) -> f64 {
        let hidden: f64 = self.spans.iter().map(|[from, to]| f64::from(to - from)).sum();
        hidden / (f64::from(self.width) * f64::from(self.height))
    }

    /// The number of connected hidden regions; pixels that touch at a side or a corner are connected.
    #[cfg(feature = "learned")]
    pub(crate) fn regions(&self) -> usize {
        // Spans as a forest: each has the index of another span of its region, or its own.
        let mut above: Vec<usize> = (0..self.spans.len()).collect();
        let root = |above: &[usize], mut at: usize| {
            while above[at] != at {
                at = above[at];
            }
            at
        };
        for rows in self.rows.windows(3) {
            for (upper, lower) in
                (rows[0]..rows[1]).flat_map(|upper| (rows[1]..rows[2]).map(move |lower| (upper, lower)))
            {
                let ([from, to], [begin, end]) = (self.spans[upper], self.spans[lower]);
                if from <= end && begin <= to {
                    let (one, other) = (root(&above, upper), root(&above, lower));
                    above[one.max(other)] = one.min(other);
                }
            }
        }
        above.iter().enumerate().filter(|(at, above)| at == *above).count()
    }

    /// Whether a pixel is hidden; pixels outside are not.
    pub fn hides(&self, column: u32, row: u32) -> bool {
        self.touches_row(row, column, column)
    }

    /// The union of two masks of equal size.
    ///
    /// # Errors
    /// [`FeatureError::MaskSize`] when the sizes differ; [`FeatureError::HidesAll`] when both together hide everything.
    pub fn and(&self, other: &Self) -> Result<Self, FeatureError> {
        self.check_size((other.width, other.height))?;
        Self::new(self.width, self.height, |x, y| self.hides(x, y) || other.hides(x, y))
    }

    /// The mask of a frame that is turned ([`CameraFrame::turned`](crate::CameraFrame::turned)).
    #[must_use]
    pub(crate) fn turned(&self, turns: QuarterTurns) -> Self {
        let size = (self.width, self.height);
        let (width, height) = turns.size_of(size);
        Self::of(width, height, |x, y| {
            let (x, y) = turns.source_of(size, (x, y));
            self.hides(x, y)
        })
    }

    /// Whether anything hidden lies within `radius` pixels of a position (COLMAP's pixels).
    pub(crate) fn touches(&self, u: f64, v: f64, radius: f64) -> bool {
        let row_of = |at: f64| at.floor().clamp(0.0, f64::from(self.height - 1)) as u32;
        (row_of(v - radius)..=row_of(v + radius)).any(|row| {
            let top = f64::from(row);
            let off = (top - v).max(v - top - 1.0).max(0.0);
            let half = (radius * radius - off * off).max(0.0).sqrt();
            let column = |at: f64| at.floor().clamp(-1.0, f64::from(self.width));
            let (from, to) = (column(u - half), column(u + half));
            to >= 0.0 && self.touches_row(row, from.max(0.0) as u32, to as u32)
        })
    }

    /// Whether any of the columns `from..=to` of a row is hidden.
    fn touches_row(&self, row: u32, from: u32, to: u32) -> bool {
        let Some([begin, end]) = self.rows.get(row as usize..).and_then(|rows| rows.first_chunk()) else {
            return false;
        };
        let spans = &self.spans[*begin..*end];
        let at = spans.partition_point(|span| span[1] <= from);
        spans.get(at).is_some_and(|span| span[0] <= to)
    }

    pub(crate) fn check_size(&self, image: (u32, u32)) -> Result<(), FeatureError> {
        let mask = (self.width, self.height);
        if mask == image {
            return Ok(());
        }
        Err(FeatureError::MaskSize { file: self.file.clone(), mask, image })
    }
}

/// Reads a mask, an image file of the image's size: **black hides**, as in COLMAP's masks. Pixels darker than half are
/// hidden, so that soft edges and JPEG noise do not hide too little.
///
/// # Errors
/// As [`crate::load_gray`]; [`FeatureError::MaskTransparent`] for one with transparent pixels, whose meaning is
/// undefined; [`FeatureError::HidesNothing`] and [`FeatureError::HidesAll`].
pub fn load_mask(path: &Path) -> Result<Mask, FeatureError> {
    let image = decode(path)?;
    if is_transparent(&image) {
        return Err(FeatureError::MaskTransparent { mask: path.into() });
    }
    let gray = image.into_luma16();
    match Mask::new(gray.width(), gray.height(), |x, y| gray.get_pixel(x, y).0[0] < 0x8000) {
        Ok(mask) => Ok(Mask { file: Some(path.into()), ..mask }),
        Err(FeatureError::HidesNothing { .. }) => Err(FeatureError::HidesNothing { mask: Some(path.into()) }),
        Err(FeatureError::HidesAll { .. }) => Err(FeatureError::HidesAll { mask: Some(path.into()) }),
        Err(other) => Err(other),
    }
}

fn is_transparent(image: &DynamicImage) -> bool {
    image.color().has_alpha() && image.to_rgba16().pixels().any(|pixel| pixel.0[3] != u16::MAX)
}

impl GrayImage {
    /// The image with hidden pixels replaced by an extrapolation of their surroundings: the mean of visible pixels
    /// around, from a larger area the deeper a pixel lies under the mask, without an edge at the mask's border.
    ///
    /// # Errors
    /// [`FeatureError::MaskSize`] for a mask of another size.
    pub fn without(&self, mask: &Mask) -> Result<Self, FeatureError> {
        mask.check_size((self.width(), self.height()))?;
        Ok(self.filled_under(mask))
    }

    /// The same for a mask of the image's size.
    pub(crate) fn filled_under(&self, mask: &Mask) -> Self {
        let samples = self.data().iter().enumerate().map(|(at, &sample)| {
            let (column, row) = (at as u32 % self.width(), at as u32 / self.width());
            (!mask.hides(column, row)).then_some(sample)
        });
        let finest = Level { width: self.width(), height: self.height(), samples: samples.collect() };
        Self::from_samples(self.width(), self.height(), finest.filled())
    }
}

/// An image with missing samples.
struct Level {
    width: u32,
    height: u32,
    samples: Vec<Option<f32>>,
}

impl Level {
    /// All samples, with the missing ones filled from an image of half the size.
    fn filled(&self) -> Vec<f32> {
        if self.samples.iter().all(Option::is_some) || self.width.max(self.height) == 1 {
            // A mask leaves at least one visible pixel, so the coarsest level has a sample.
            return self.samples.iter().map(|sample| sample.unwrap_or(0.0)).collect();
        }
        let coarse = self.halved();
        let (around, size) = (coarse.filled(), [coarse.width, coarse.height]);
        let missing = |at: usize| bilinear(&around, size, at as u32 % self.width, at as u32 / self.width);
        self.samples.iter().enumerate().map(|(at, sample)| sample.unwrap_or_else(|| missing(at))).collect()
    }

    /// Half the size; a sample is the mean of the up to four that are present.
    fn halved(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mut samples = Vec::with_capacity(width as usize * height as usize);
        for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            let (mut sum, mut count) = (0.0, 0.0);
            for row in 2 * y..(2 * y + 2).min(self.height) {
                for column in 2 * x..(2 * x + 2).min(self.width) {
                    if let Some(sample) = self.samples[(row * self.width + column) as usize] {
                        sum += sample;
                        count += 1.0;
                    }
                }
            }
            samples.push((count > 0.0).then(|| sum / count));
        }
        Self { width, height, samples }
    }
}

/// Bilinear interpolation of a coarse image at a pixel of the image of twice its size.
fn bilinear(coarse: &[f32], [width, height]: [u32; 2], column: u32, row: u32) -> f32 {
    let axis = |at: u32, size: u32| {
        let at = (0.5 * at as f32 - 0.25).clamp(0.0, size as f32 - 1.0);
        (at as usize, (at as usize + 1).min(size as usize - 1), at.fract())
    };
    let (left, right, across) = axis(column, width);
    let (upper, lower, down) = axis(row, height);
    let at = |y: usize, x: usize| coarse[y * width as usize + x];
    let mix = |a: f32, b: f32, share: f32| a + (b - a) * share;
    mix(mix(at(upper, left), at(upper, right), across), mix(at(lower, left), at(lower, right), across), down)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn disc(radius: f64) -> Mask {
        let inside = |x: u32, y: u32| (f64::from(x) - 30.0).hypot(f64::from(y) - 20.0) < radius;
        Mask::new(64, 48, inside).expect("a part of it")
    }

    #[test]
    fn spans_equal_their_pixels() {
        let odd = |x: u32, y: u32| (x * 7 + y * 3).is_multiple_of(5) || x > 60;
        let mask = Mask::new(64, 48, odd).expect("a part of it");
        let mut hidden = 0;
        for (y, x) in (0..48).flat_map(|y| (0..64).map(move |x| (y, x))) {
            assert_eq!(mask.hides(x, y), odd(x, y), "{x} {y}");
            hidden += u32::from(odd(x, y));
        }
        assert!((mask.share() - f64::from(hidden) / (64.0 * 48.0)).abs() < 1e-12);
        assert!(!mask.hides(64, 0) && !mask.hides(0, 48));
        assert_eq!(format!("{mask:?}"), "Mask(64x48)");
    }

    /// The slow reference: the square of every hidden pixel against the disc.
    #[test]
    fn touches_agrees_with_every_pixel() {
        let mask = disc(9.5);
        let slowly = |u: f64, v: f64, radius: f64| {
            let away = |at: f64, low: u32| (f64::from(low) - at).max(at - f64::from(low) - 1.0).max(0.0);
            (0..48)
                .flat_map(|y| (0..64).map(move |x| (x, y)))
                .any(|(x, y)| mask.hides(x, y) && away(u, x).hypot(away(v, y)) <= radius)
        };
        let mut both = [0; 2];
        for i in 0..4000_u32 {
            let of = |k: u32, size: f64| f64::from(i * k % 997) / 997.0 * (size + 8.0) - 4.0;
            let (u, v, radius) = (of(7, 64.0), of(31, 48.0), f64::from(i % 40) * 0.61 + 0.013);
            assert_eq!(mask.touches(u, v, radius), slowly(u, v, radius), "{u} {v} {radius}");
            both[usize::from(mask.touches(u, v, radius))] += 1;
        }
        assert!(both.iter().all(|count| *count > 500), "{both:?}");
    }

    #[test]
    fn filled_pixels_are_independent_of_hidden_ones_and_smooth() {
        let mask = disc(12.0);
        let slope = |x: u32, y: u32| 0.2 + 0.006 * x as f32 + 0.004 * y as f32;
        let image = |hidden: &dyn Fn(u32, u32) -> f32| {
            let pixels = (0..48).flat_map(|y| (0..64).map(move |x| (x, y)));
            let of = |(x, y)| if mask.hides(x, y) { hidden(x, y) } else { slope(x, y) };
            GrayImage::new(64, 48, pixels.map(of).collect()).expect("finite")
        };
        let (noisy, blank) = (image(&|x, y| ((x * 31 + y * 17) % 7) as f32 / 7.0), image(&|_, _| 1.0));
        let filled = noisy.without(&mask).expect("of its size");
        assert!(filled == blank.without(&mask).expect("of its size"), "bit by bit");
        assert!(filled != noisy);
        for (at, &sample) in filled.data().iter().enumerate() {
            let (x, y) = (at as u32 % 64, at as u32 / 64);
            let off = (sample - slope(x, y)).abs();
            assert!(off < if mask.hides(x, y) { 0.08 } else { 1e-9 }, "{x} {y}: {off}");
        }
        let other = Mask::new(48, 64, |x, _| x < 10).expect("a part of it");
        let refused = noisy.without(&other).expect_err("turned by a quarter");
        assert!(
            matches!(refused, FeatureError::MaskSize { mask: (48, 64), image: (64, 48), .. }),
            "{refused}"
        );
    }

    #[cfg(feature = "learned")]
    #[test]
    fn regions_are_counted() {
        for (drawing, expected) in [
            (&["#.#", "...", "#.#"][..], 4),
            (&["#.#", ".#.", "..."], 1),
            (&["#.#.#", "#.#.#", "###.#"], 2),
            (&["#####", "#...#", "#.#.#", "#...#", "#####"], 2),
            (&["..#", "#..", ".#."], 2),
        ] {
            let (width, height) = (drawing[0].len() as u32, drawing.len() as u32);
            let hides = |x: u32, y: u32| drawing[y as usize].as_bytes()[x as usize] == b'#';
            assert_eq!(Mask::new(width, height, hides).expect("a part").regions(), expected, "{drawing:?}");
        }
    }

    #[test]
    fn implausible_masks_are_rejected() {
        assert!(matches!(Mask::new(8, 8, |_, _| false), Err(FeatureError::HidesNothing { .. })));
        assert!(matches!(Mask::new(8, 8, |_, _| true), Err(FeatureError::HidesAll { .. })));
        assert!(matches!(Mask::new(0, 8, |_, _| true), Err(FeatureError::Empty { .. })));
        let half = |left: bool| Mask::new(8, 8, move |x, _| (x < 4) == left).expect("a half");
        assert!(matches!(half(true).and(&half(false)), Err(FeatureError::HidesAll { .. })));
        assert_eq!(half(true).and(&half(true)).expect("the same"), half(true));
    }
}
