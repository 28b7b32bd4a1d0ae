//! End to end: from all rows of one obfuscated image to where on its line each keypoint lies.
//!
//! A row is told by its descriptor and by its line, as functions over the image ([`waves`]). A network over the set of
//! rows answers for each with a sum of the same functions, which is asked at places along the row's own candidates and
//! **added to the exact guess** there, as logarithms. So a network that has not learned says the guess to the last
//! bit, under any scheme and layout, and what it says beyond that was learned.
//!
//! ```text
//! log p(bin b of row i) = log guess_i(b) + ⟨network(all rows)_i, waves(place of b)⟩ + constant
//! loss = mean over rows of −log p(bin of the keypoint)
//! ```
//!
//! What the set of rows tells is measured against the same network without attention: the row alone ([`Sees::Row`]), and
//! its line alone ([`Sees::Line`]), which learns where keypoints usually are.

mod bins;
mod file;
mod lessons;
mod mirror;
mod recover;
mod told;
mod training;
mod waves;

use std::fmt;
use std::str::FromStr;

use crate::AttackError;
use crate::Observation;
use crate::training::layers::Places;
use veiloc_protocol::{AngleBits, Scheme};

use crate::learned::engine::Matrix;
use crate::learned::engine::encoder::{Encoder, Shape};
use crate::learned::options::TrainingOptions;

pub use recover::{Estimate, recover};
pub use told::{Told, told};
pub use training::train;

use bins::Bins;
use waves::Waves;

/// What is learned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct PositionTask {
    /// Under which images are sent.
    pub scheme: Scheme,
    /// Bits of a line's angle, as devices send them.
    pub angle_bits: AngleBits,
    /// What the network is shown.
    pub sees: Sees,
    /// Whether half of the draws are of a part of an image, as an image of its own. Default true.
    pub crop: bool,
    /// Whether half of the draws are mirrored. Right for SIFT descriptors alone, so default false.
    pub mirror: bool,
}

impl PositionTask {
    /// Of a scheme, everything else as by default.
    ///
    /// # Errors
    /// [`AttackError::Scheme`] for a scheme that sends positions.
    pub fn new(scheme: Scheme) -> Result<Self, AttackError> {
        if !scheme.hides_positions() {
            let expected = "positions are sent openly, there is nothing to learn".to_owned();
            return Err(AttackError::Scheme { found: scheme.to_string(), expected });
        }
        Ok(Self { scheme, angle_bits: AngleBits::default(), sees: Sees::Set, crop: true, mirror: false })
    }
}

/// What the network is shown of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Sees {
    /// All rows: descriptors and lines.
    #[default]
    Set,
    /// Each row alone: its descriptor and its line.
    Row,
    /// Each line alone.
    Line,
}

impl Sees {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Set, Self::Row, Self::Line];

    const fn name(self) -> &'static str {
        match self {
            Self::Set => "set",
            Self::Row => "row",
            Self::Line => "line",
        }
    }
}

impl fmt::Display for Sees {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Nothing that a network can be shown has this name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("a network is shown `set`, `row` or `line`, not {0:?}")]
pub struct UnknownSees(String);

impl FromStr for Sees {
    type Err = UnknownSees;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::ALL.into_iter().find(|s| s.name() == text).ok_or_else(|| UnknownSees(text.to_owned()))
    }
}

/// Says where on its line each keypoint lies; made by [`train`] or [`Self::decode`].
#[derive(Debug, Clone)]
pub struct PositionNetwork {
    layers: Layers,
    numbers: Vec<f32>,
    scheme: Scheme,
}

impl PositionNetwork {
    /// Under which scheme it learned; of other schemes it knows nothing.
    pub fn scheme(&self) -> Scheme {
        self.scheme
    }

    /// What it is shown.
    pub fn sees(&self) -> Sees {
        self.layers.sees
    }

    /// Length of the descriptors it learned from.
    pub fn dimension(&self) -> usize {
        self.layers.dimension
    }

    /// How many numbers were learned.
    pub fn parameters(&self) -> usize {
        self.numbers.len()
    }
}

/// The layers, by where their numbers stand, and the functions lines and answers are told in.
#[derive(Debug, Clone)]
struct Layers {
    dimension: usize,
    sees: Sees,
    shape: Shape,
    encoder: Encoder,
    waves: Waves,
}

/// Numbers a row is told by beside descriptor and line: width and height of the image, and how long the line is in it.
const MORE: usize = 3;
/// What functions are worth on a line is small beside entries of descriptors.
const LINE_SCALE: f32 = 3.0;

impl Layers {
    fn new(
        dimension: usize,
        sees: Sees,
        [width, heads, layers]: [usize; 3],
    ) -> Result<(Self, Places), AttackError> {
        let waves = Waves::new();
        let shape = Shape {
            inputs: dimension + waves.len() + MORE,
            width,
            outputs: waves.len(),
            heads,
            layers,
            attends: sees == Sees::Set,
        };
        shape.check()?;
        let mut places = Places::default();
        let encoder = Encoder::new(&shape, &mut places);
        Ok((Self { dimension, sees, shape, encoder, waves }, places))
    }

    fn of_options(
        dimension: usize,
        sees: Sees,
        options: &TrainingOptions,
    ) -> Result<(Self, Places), AttackError> {
        Self::new(dimension, sees, [options.width, options.heads, options.layers])
    }

    /// What each function is worth at each bin: `[functions, bins]`.
    fn at_bins(&self, bins: &Bins, size: [u32; 2]) -> Matrix {
        let mut values = Matrix::zeros(self.waves.len(), bins.places.len());
        let columns = values.as_mut_slice().chunks_exact_mut(self.waves.len());
        columns.zip(&bins.places).for_each(|(column, place)| self.waves.at(*place, size, column));
        values
    }

    /// What the network is told of the rows of an image, `[inputs, N]`; `descriptors` are `[dimension, N]`.
    fn input(&self, descriptors: &Matrix, bins: &Bins, at_bins: &Matrix, size: [u32; 2]) -> Matrix {
        let [width, height] = size.map(f64::from);
        let longer = width.max(height).max(1.0);
        let functions = self.waves.len();
        let mut input = Matrix::zeros(self.shape.inputs, bins.rows());
        for (row, column) in input.as_mut_slice().chunks_exact_mut(self.shape.inputs).enumerate() {
            let (own, rest) = column.split_at_mut(self.dimension);
            if self.sees != Sees::Line {
                own.copy_from_slice(descriptors.column(row).as_slice());
            }
            let (line, more) = rest.split_at_mut(functions);
            for bin in bins.of_row(row) {
                let share = LINE_SCALE * bins.guess[bin].exp();
                line.iter_mut().zip(at_bins.column(bin).iter()).for_each(|(l, v)| *l += share * v);
            }
            more.copy_from_slice(
                &[width / longer, height / longer, bins.lengths[row] / longer].map(|x| x as f32),
            );
        }
        input
    }

    /// Logarithms, up to a constant each row, of how likely each bin is, from the network's answers `[functions, N]`.
    fn logits(answers: &Matrix, bins: &Bins, at_bins: &Matrix) -> Vec<f32> {
        let mut logits = bins.guess.clone();
        for row in 0..bins.rows() {
            let answer = answers.column(row);
            for bin in bins.of_row(row) {
                logits[bin] += answer.dot(&at_bins.column(bin));
            }
        }
        logits
    }

    /// How likely each bin of each row is, `[bins]`; descriptors `[dimension, N]`.
    fn shares(&self, numbers: &[f32], descriptors: &Matrix, bins: &Bins, size: [u32; 2]) -> Vec<f32> {
        let at_bins = self.at_bins(bins, size);
        let input = self.input(descriptors, bins, &at_bins, size);
        let answers = self.encoder.apply(numbers, &input);
        let mut shares = Self::logits(&answers, bins, &at_bins);
        for row in 0..bins.rows() {
            crate::learned::engine::exponential::softmax(&mut shares[bins.of_row(row)]);
        }
        shares
    }
}

/// What was sent under this scheme, as far as it can be told from the rows.
fn fits(scheme: Scheme, observation: &Observation) -> bool {
    match observation {
        Observation::Line(_) => scheme == Scheme::RandomLines,
        Observation::EitherLine(_) => scheme == Scheme::CoordinatePermutation,
        Observation::Pencil(_) => matches!(scheme, Scheme::Dcl(_)),
        Observation::Known(_) => true,
    }
}
