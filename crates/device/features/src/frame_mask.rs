//! Masks as AR frameworks and person segmenters give them: a byte a pixel, of any resolution.
//!
//! | from | kind | hidden |
//! |---|---|---|
//! | ARKit `ARFrame.segmentationBuffer`; MediaPipe's categories of a person (multiclass) | [`MaskKind::Marked`] | all but 0 |
//! | MediaPipe's and ML Kit's confidences, as bytes | [`MaskKind::Confidence`] | 51 and more: a fifth |
//! | ARCore `Frame.acquireSemanticImage` | [`MaskKind::ArcoreSemantics`] | person (10) and vehicle (9) |
//! | files of COLMAP and of `--mask` | [`MaskKind::DarkHides`] | below 128 |
//!
//! Source of ARCore's labels: *ARCore reference*, `ArSemanticLabel`.

use std::str::FromStr;

use crate::{FeatureError, Mask};

/// Which values of a mask hide a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum MaskKind {
    /// All but 0: a segmentation that marks people.
    #[default]
    Marked,
    /// 51 and more: a confidence, 255 for certain. A person that is missed would be revealed; a few keypoints more that are
    /// hidden cost little.
    Confidence,
    /// The labels of ARCore's scene semantics for a person (10) and a vehicle (9), on which plates are.
    ArcoreSemantics,
    /// Below 128: black hides, as in the mask files of COLMAP.
    DarkHides,
}

impl MaskKind {
    /// All of them, in the order of their numbers in C.
    pub const ALL: [Self; 4] = [Self::Marked, Self::Confidence, Self::ArcoreSemantics, Self::DarkHides];

    /// The name in text form.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Marked => "marked",
            Self::Confidence => "confidence",
            Self::ArcoreSemantics => "arcore-semantics",
            Self::DarkHides => "dark-hides",
        }
    }

    const fn hides(self, value: u8) -> bool {
        match self {
            Self::Marked => value != 0,
            Self::Confidence => value >= 51,
            Self::ArcoreSemantics => matches!(value, 9 | 10),
            Self::DarkHides => value < 128,
        }
    }
}

/// A word that names no [`MaskKind`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown kind of mask {0:?}; known: marked, confidence, arcore-semantics, dark-hides")]
pub struct MaskKindError(String);

impl FromStr for MaskKind {
    type Err = MaskKindError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let named = Self::ALL.into_iter().find(|kind| kind.name() == text);
        named.ok_or_else(|| MaskKindError(text.chars().take(40).collect()))
    }
}

/// A mask of a frame: what a segmenter says of each pixel. It shows the same as the frame, before the frame is turned, and may have
/// another resolution.
#[derive(Clone, Copy)]
pub struct FrameMask<'a> {
    /// Which values hide.
    pub kind: MaskKind,
    /// Width and height, pixels.
    pub size: (u32, u32),
    /// Rows of bytes; they reach at least to the end of the last row's last pixel.
    pub bytes: &'a [u8],
    /// Bytes from one row to the next; 0 when rows follow each other without a gap.
    pub row_stride: usize,
    /// How far beyond what is marked is hidden, too, as a share of the longer side ([`Self::MARGIN`]).
    pub margin: f32,
}

impl FrameMask<'_> {
    /// The default margin: segmenters cut off hair, hands and what is held in them.
    pub const MARGIN: f32 = 0.02;

    /// The hidden pixels of a frame of this size, before it is turned; `None` when the mask hides nothing.
    ///
    /// # Errors
    /// [`FeatureError::Empty`], [`FeatureError::Stride`], [`FeatureError::Length`]; [`FeatureError::MaskMargin`]; and
    /// [`FeatureError::HidesAll`] when with the margin nothing is left.
    pub fn of_frame(&self, frame: (u32, u32)) -> Result<Option<Mask>, FeatureError> {
        let ([columns, rows], (width, height)) =
            ([self.size.0, self.size.1].map(|side| side as usize), frame);
        if !(0.0..=1.0).contains(&self.margin) {
            return Err(FeatureError::MaskMargin { margin: self.margin });
        }
        let stride = if self.row_stride == 0 { columns } else { self.row_stride };
        if columns == 0 || rows == 0 {
            return Err(FeatureError::Empty { width: self.size.0, height: self.size.1 });
        }
        if stride < columns {
            return Err(FeatureError::Stride { row: columns, stride });
        }
        let expected = stride.saturating_mul(rows - 1).saturating_add(columns);
        if self.bytes.len() < expected {
            let (width, height) = self.size;
            return Err(FeatureError::Length { width, height, expected, actual: self.bytes.len() });
        }
        let row = |y: usize| &self.bytes[y * stride..][..columns];
        let marked: Vec<bool> =
            (0..rows).flat_map(|y| row(y).iter().map(|value| self.kind.hides(*value))).collect();
        if !marked.contains(&true) {
            return Ok(None);
        }
        let reach = (self.margin * columns.max(rows) as f32).ceil() as usize;
        let across = grown(&marked, rows, columns, |line, at| line * columns + at, reach);
        let hidden = grown(&across, columns, rows, |line, at| at * columns + line, reach);
        // A pixel of the frame is hidden if any pixel of the mask that it overlaps is.
        let overlapped = |at: u32, side: u32, cells: usize| {
            let (at, side, cells) = (u64::from(at), u64::from(side), cells as u64);
            (at * cells / side) as usize..=(((at + 1) * cells - 1) / side) as usize
        };
        let wide: Vec<bool> = (0..rows)
            .flat_map(|row| (0..width).map(move |x| (row, x)))
            .map(|(row, x)| overlapped(x, width, columns).any(|column| hidden[row * columns + column]))
            .collect();
        Mask::new(width, height, |x, y| {
            overlapped(y, height, rows).any(|row| wide[row * width as usize + x as usize])
        })
        .map(Some)
    }
}

/// The values spread along each of `lines` lines of `length` values, by `reach` to both sides.
fn grown(
    values: &[bool],
    lines: usize,
    length: usize,
    index: impl Fn(usize, usize) -> usize,
    reach: usize,
) -> Vec<bool> {
    let mut result = values.to_vec();
    for line in 0..lines {
        // The number of true values before each place.
        let mut before = vec![0_usize; length + 1];
        for at in 0..length {
            before[at + 1] = before[at] + usize::from(values[index(line, at)]);
        }
        for at in 0..length {
            let (from, to) = (at.saturating_sub(reach), (at + reach + 1).min(length));
            result[index(line, at)] = before[to] > before[from];
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(kind: MaskKind, bytes: &[u8], size: (u32, u32)) -> FrameMask<'_> {
        FrameMask { kind, size, bytes, row_stride: 0, margin: 0.0 }
    }

    #[test]
    fn kinds_hide_what_their_source_says() {
        let bytes: Vec<u8> = (0..=255).collect();
        let hidden = |kind| -> Vec<u32> {
            let mask = mask(kind, &bytes, (256, 1)).of_frame((256, 1)).expect("a mask").expect("hides some");
            (0..256).filter(|x| mask.hides(*x, 0)).collect()
        };
        assert_eq!(hidden(MaskKind::Marked), (1..256).collect::<Vec<_>>());
        assert_eq!(hidden(MaskKind::Confidence), (51..256).collect::<Vec<_>>());
        assert_eq!(hidden(MaskKind::ArcoreSemantics), [9, 10]);
        assert_eq!(hidden(MaskKind::DarkHides), (0..128).collect::<Vec<_>>());
    }

    #[test]
    fn every_pixel_that_a_marked_one_touches_is_hidden() {
        // One of 3 × 2 on frames that are no multiples of it, smaller and larger.
        for frame in [(7, 5), (2, 2), (300, 200), (3, 2)] {
            let mask = mask(MaskKind::Marked, &[0, 1, 0, 0, 0, 0], (3, 2))
                .of_frame(frame)
                .expect("a mask")
                .expect("hides some");
            let (w, h) = (f64::from(frame.0), f64::from(frame.1));
            for (x, y) in (0..frame.1).flat_map(|y| (0..frame.0).map(move |x| (x, y))) {
                let [left, right] = [x, x + 1].map(|x| f64::from(x) / w * 3.0);
                let top = f64::from(y) / h * 2.0;
                let touches = left < 2.0 - 1e-9 && right > 1.0 + 1e-9 && top < 1.0 - 1e-9;
                assert_eq!(mask.hides(x, y), touches, "{frame:?} {x} {y}");
            }
        }
    }

    #[test]
    fn the_margin_reaches_to_all_sides() {
        let mut bytes = vec![0; 100 * 50];
        bytes[25 * 100 + 40] = 255;
        let wide = FrameMask { margin: 0.05, ..mask(MaskKind::Marked, &bytes, (100, 50)) };
        let wide = wide.of_frame((100, 50)).expect("a mask").expect("hides some");
        for (x, y) in (0..50).flat_map(|y| (0..100).map(move |x| (x, y))) {
            assert_eq!(wide.hides(x, y), x.abs_diff(40) <= 5 && y.abs_diff(25) <= 5, "{x} {y}");
        }
    }

    #[test]
    fn strides_are_skipped_and_nothing_hidden_is_no_mask() {
        let bytes = [0, 0, 9, 0, 1, 9, 0, 0];
        let padded = FrameMask { row_stride: 3, ..mask(MaskKind::Marked, &bytes, (2, 3)) };
        let found = padded.of_frame((2, 3)).expect("a mask").expect("hides one");
        assert!(found.hides(1, 1) && found.share() < 0.17, "{}", found.share());
        assert_eq!(mask(MaskKind::Marked, &[0; 6], (2, 3)).of_frame((640, 480)).expect("a mask"), None);
    }

    #[test]
    fn wrong_masks_are_errors() {
        let refused = |mask: FrameMask<'_>| mask.of_frame((64, 48)).expect_err("refused");
        let bytes = [1; 6];
        assert!(matches!(refused(mask(MaskKind::Marked, &bytes, (2, 3))), FeatureError::HidesAll { .. }));
        assert!(matches!(refused(mask(MaskKind::Marked, &bytes, (0, 3))), FeatureError::Empty { .. }));
        assert!(matches!(
            refused(mask(MaskKind::Marked, &bytes, (2, 4))),
            FeatureError::Length { expected: 8, actual: 6, .. }
        ));
        let narrow = FrameMask { row_stride: 1, ..mask(MaskKind::Marked, &bytes, (2, 3)) };
        assert!(matches!(refused(narrow), FeatureError::Stride { row: 2, stride: 1 }));
        for margin in [-0.1, 1.1, f32::NAN] {
            let wrong = FrameMask { margin, ..mask(MaskKind::Marked, &bytes, (2, 3)) };
            assert!(matches!(refused(wrong), FeatureError::MaskMargin { .. }));
        }
    }
}
