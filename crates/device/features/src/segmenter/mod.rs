//! Finds people in an image with MediaPipe's selfie segmentation, so that they can be hidden before anything is sent.
//!
//! The network is `selfie_segmentation.tflite` or `selfie_segmentation_landscape.tflite` of MediaPipe (Apache-2.0), as it
//! is; the user brings the file. It runs here without another library, also in WebAssembly, and equal images give equal
//! masks.
//!
//! It was made for one person near the camera, and does not see small ones in a whole image; hence it also sees parts of the
//! image, enlarged ([`SCALES`]), and what any of these shows is hidden. `docs/results/privacy.md` has the measurement.

mod flatbuffer;
mod network;
mod operators;
#[cfg(test)]
mod tests;

use rayon::prelude::*;
use veiloc_geometry::QuarterTurns;

use crate::{ColourImage, FeatureError, FrameMask, GrayImage, Mask, MaskKind};

use network::Network;

/// Sides of the image that the network sees in parts, over its input's, in quarters: 1, 1.75 and 2.5, which are 1, 2 × 2 and
/// 3 × 3 parts that overlap by a quarter.
const SCALES: [usize; 3] = [4, 7, 10];

/// The largest file that is read, bytes; the real ones have 0.25 million.
pub const MAX_SEGMENTER_BYTES: u64 = 16 << 20;

/// A network that says of each pixel how likely it shows a person.
pub struct PersonSegmenter(Network);

impl std::fmt::Debug for PersonSegmenter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "PersonSegmenter({:?})", self.0.input)
    }
}

impl PersonSegmenter {
    /// The class that it finds.
    pub const CLASS: &'static str = "people";

    /// Whether the bytes of a file begin as a TFLite file does.
    pub fn is_tflite(file: &[u8]) -> bool {
        file.get(4..8) == Some(b"TFL3")
    }

    /// Reads the bytes of a TFLite file with the operators of MediaPipe's selfie segmentation.
    ///
    /// # Errors
    /// [`FeatureError::Segmenter`] for another network, and for one that is damaged.
    pub fn read(file: &[u8]) -> Result<Self, FeatureError> {
        let refused = |reason| FeatureError::Segmenter { reason };
        if file.len() as u64 > MAX_SEGMENTER_BYTES {
            return Err(refused(format!("it has more than {MAX_SEGMENTER_BYTES} bytes")));
        }
        Network::read(file).map(Self).map_err(refused)
    }

    /// The people of an image, with a margin around them ([`FrameMask::margin`]); `None` when there are none. `turns` is how
    /// the image is turned to stand upright, as the network must see it.
    ///
    /// # Errors
    /// [`FeatureError::DetectorRun`] when the network gives numbers that are no confidences; [`FeatureError::MaskMargin`];
    /// [`FeatureError::HidesAll`] when with the margin nothing is left.
    pub fn mask(
        &self,
        image: &ColourImage,
        turns: QuarterTurns,
        margin: f32,
    ) -> Result<Option<Mask>, FeatureError> {
        let upright = image.turned(turns);
        let (confidence, size) = self.confidence(&upright)?;
        let mask = FrameMask { kind: MaskKind::Confidence, size, bytes: &confidence, row_stride: 0, margin };
        let mask = mask.of_frame((upright.width(), upright.height()))?;
        Ok(mask.map(|mask| mask.turned(turns.inverse())))
    }

    /// The largest confidence of all scales, 255 for certain, and its width and height: 2.5 times the network's.
    fn confidence(&self, image: &ColourImage) -> Result<(Vec<u8>, (u32, u32)), FeatureError> {
        let [rows, columns, _] = self.0.input;
        let [width, height] = [columns, rows].map(|side| side * SCALES[2] / 4);
        let finest = image.channels().map(|channel| channel.resized(width as u32, height as u32));
        let scaled = SCALES.map(|scale| {
            let (width, height) = ((columns * scale / 4) as u32, (rows * scale / 4) as u32);
            finest.each_ref().map(|channel| channel.resized(width, height))
        });
        // Scale, and the top left corner of the part.
        let parts: Vec<(usize, [usize; 2])> = (0..SCALES.len())
            .flat_map(|scale| {
                (0..(scale + 1).pow(2)).map(move |part| (scale, [part / (scale + 1), part % (scale + 1)]))
            })
            .map(|(scale, [y, x])| (scale, [y * rows * 3 / 4, x * columns * 3 / 4]))
            .collect();
        let seen: Vec<Vec<f32>> =
            parts.par_iter().map(|(scale, corner)| self.0.run(self.part(&scaled[*scale], *corner))).collect();
        if seen.iter().flatten().any(|value| !(0.0..=1.0).contains(value)) {
            return Err(FeatureError::DetectorRun { reason: "its output is not from 0 to 1".to_owned() });
        }
        let mut largest = vec![0_u8; width * height];
        for ((scale, [top, left]), seen) in parts.iter().zip(&seen) {
            for (at, largest) in largest.iter_mut().enumerate() {
                // The pixel of this scale under the one of the finest, if the part has it.
                let y = (at / width * SCALES[*scale] / SCALES[2]).wrapping_sub(*top);
                let x = (at % width * SCALES[*scale] / SCALES[2]).wrapping_sub(*left);
                if y < rows && x < columns {
                    *largest = (*largest).max((seen[y * columns + x] * 255.0).round() as u8);
                }
            }
        }
        Ok((largest, (width as u32, height as u32)))
    }

    /// The network's input from a part of an image.
    fn part(&self, channels: &[GrayImage; 3], [top, left]: [usize; 2]) -> Vec<f32> {
        let [rows, columns, _] = self.0.input;
        let pixel = |y: usize, x: usize| channels.each_ref().map(|channel| channel.row(y as u32)[x]);
        (top..top + rows).flat_map(|y| (left..left + columns).flat_map(move |x| pixel(y, x))).collect()
    }
}
