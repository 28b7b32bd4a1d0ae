//! One-channel images, the input of extraction.

use crate::FeatureError;

/// Weights of red, green and blue in gray: Rec. 709 luma on the stored (gamma-encoded) values, as in COLMAP.
const LUMA: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// A gray image: `width * height` finite samples, nominally in [0, 1], row by row, at least one pixel.
///
/// The sample of column `x`, row `y` belongs to the point (x + 0.5, y + 0.5), COLMAP's pixel convention.
#[derive(Clone, PartialEq)]
pub struct GrayImage {
    width: u32,
    height: u32,
    data: Vec<f32>,
}

// Image content must never reach a log (rule L8).
impl std::fmt::Debug for GrayImage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "GrayImage({}x{})", self.width, self.height)
    }
}

impl GrayImage {
    /// From samples row by row, `[height, width]`, nominally in [0, 1].
    ///
    /// # Errors
    /// [`FeatureError::Empty`], [`FeatureError::Length`] or [`FeatureError::NotFinite`].
    pub fn new(width: u32, height: u32, data: Vec<f32>) -> Result<Self, FeatureError> {
        check_size(width, height, 1, data.len())?;
        if let Some(at) = data.iter().position(|sample| !sample.is_finite()) {
            let width = width as usize;
            return Err(FeatureError::NotFinite { column: (at % width) as u32, row: (at / width) as u32 });
        }
        Ok(Self { width, height, data })
    }

    /// From gray bytes row by row, `[height, width]`; 255 becomes 1.
    ///
    /// # Errors
    /// [`FeatureError::Empty`] or [`FeatureError::Length`].
    pub fn from_luma8(width: u32, height: u32, samples: &[u8]) -> Result<Self, FeatureError> {
        check_size(width, height, 1, samples.len())?;
        Ok(Self { width, height, data: samples.iter().map(|&v| f32::from(v) / 255.0).collect() })
    }

    /// From colour bytes row by row, `[height, width, 3]` (red, green, blue), by Rec. 709 luma of the stored values.
    ///
    /// COLMAP rounds the gray value to a byte, this does not: at most half a gray level apart.
    ///
    /// # Errors
    /// [`FeatureError::Empty`] or [`FeatureError::Length`].
    pub fn from_rgb8(width: u32, height: u32, samples: &[u8]) -> Result<Self, FeatureError> {
        check_size(width, height, 3, samples.len())?;
        let data = samples.chunks_exact(3).map(|rgb| luma(rgb[0], rgb[1], rgb[2])).collect();
        Ok(Self { width, height, data })
    }

    /// As [`Self::from_rgb8`], for bytes `[height, width, 4]`, as in a browser's canvas: transparency is ignored.
    ///
    /// # Errors
    /// [`FeatureError::Empty`] or [`FeatureError::Length`].
    pub fn from_rgba8(width: u32, height: u32, samples: &[u8]) -> Result<Self, FeatureError> {
        check_size(width, height, 4, samples.len())?;
        let data = samples.chunks_exact(4).map(|rgba| luma(rgba[0], rgba[1], rgba[2])).collect();
        Ok(Self { width, height, data })
    }

    /// From samples in [0, 1], `[height, width]`.
    pub(crate) fn from_samples(width: u32, height: u32, data: Vec<f32>) -> Self {
        debug_assert_eq!(data.len(), width as usize * height as usize);
        Self { width, height, data }
    }

    /// The mean of all samples.
    pub fn mean(&self) -> f64 {
        let row = |y| self.row(y).iter().map(|sample| f64::from(*sample)).sum::<f64>();
        (0..self.height).map(row).sum::<f64>() / self.data.len() as f64
    }

    /// Columns.
    pub const fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub const fn height(&self) -> u32 {
        self.height
    }

    /// All samples row by row, `[height, width]`.
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// The samples of one row, `[width]`.
    pub fn row(&self, y: u32) -> &[f32] {
        let width = self.width as usize;
        &self.data[y as usize * width..][..width]
    }

    /// The image scaled down to at most `max_side` pixels wide and high, with its aspect ratio; unchanged when it
    /// already is.
    ///
    /// A point `(u, v)` of this image is at `(u * new_width / width, v * new_height / height)` of the new one:
    /// see [`Features::scaled`](crate::Features::scaled) for the inverse.
    pub fn limited(self, max_side: u32) -> Self {
        let longest = self.width.max(self.height);
        let max_side = max_side.max(1);
        if longest <= max_side {
            return self;
        }
        let shrink = |side: u32| {
            let shrunk = (f64::from(side) * f64::from(max_side) / f64::from(longest)).round();
            (shrunk as u32).max(1)
        };
        self.resized(shrink(self.width), shrink(self.height))
    }

    /// The image at another size (at least 1x1), each new pixel the mean of the area it covers.
    ///
    /// Intended for scaling down; enlarging repeats pixels.
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        let columns = coverage(self.width, width);
        let rows = coverage(self.height, height);
        let mut data = Vec::with_capacity(width as usize * height as usize);
        let mut mean_row = vec![0.0f32; self.width as usize];
        for cover in &rows {
            mean_row.fill(0.0);
            for (y, &weight) in (cover.first..).zip(&cover.weights) {
                for (sum, &sample) in mean_row.iter_mut().zip(self.row(y)) {
                    *sum += weight * sample;
                }
            }
            data.extend(columns.iter().map(|cover| {
                let under = &mean_row[cover.first as usize..];
                under.iter().zip(&cover.weights).map(|(&sample, &weight)| sample * weight).sum::<f32>()
            }));
        }
        Self { width, height, data }
    }
}

/// Gray of one colour pixel, in [0, 1].
pub(crate) fn luma(red: u8, green: u8, blue: u8) -> f32 {
    let [r, g, b] = LUMA;
    (r * f32::from(red) + g * f32::from(green) + b * f32::from(blue)) / 255.0
}

/// The old pixels that one new pixel covers along one axis, with their weights (which sum to 1).
struct Coverage {
    first: u32,
    weights: Vec<f32>,
}

fn coverage(old: u32, new: u32) -> Vec<Coverage> {
    let step = f64::from(old) / f64::from(new);
    (0..new)
        .map(|i| {
            let begin = f64::from(i) * step;
            let end = (f64::from(i + 1) * step).min(f64::from(old));
            let first = (begin as u32).min(old - 1);
            let last = (end.ceil() as u32).clamp(first + 1, old);
            let covered = |pixel: u32| end.min(f64::from(pixel + 1)) - begin.max(f64::from(pixel));
            let total: f64 = (first..last).map(covered).sum();
            Coverage { first, weights: (first..last).map(|pixel| (covered(pixel) / total) as f32).collect() }
        })
        .collect()
}

fn check_size(width: u32, height: u32, channels: usize, actual: usize) -> Result<(), FeatureError> {
    if width == 0 || height == 0 {
        return Err(FeatureError::Empty { width, height });
    }
    let expected = (width as usize).saturating_mul(height as usize).saturating_mul(channels);
    if expected == actual { Ok(()) } else { Err(FeatureError::Length { width, height, expected, actual }) }
}
