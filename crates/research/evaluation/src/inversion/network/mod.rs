//! The networks: over a grid on which descriptors were placed, to the colours of each cell. [`Form`] says which there are.
//!
//! The U-Net is after Ronneberger et al., *U-Net*, MICCAI 2015, as Dangwal et al. (*Mitigating reverse engineering attacks on local feature
//! descriptors*, BMVC 2021) and Ng et al. (*NinjaDesc*, CVPR 2022) use it on descriptors, and the paper with 64 channels and
//! five levels. Two convolutions a level, the largest of four cells on the way down, each cell four times on the way up beside
//! what was there on the way down.
//!
//! ```text
//! descriptors [dimension, N] → matrix → placed on the grid [width, cells], with how full a cell is and where it is
//!   level i:  two convolutions to width · 2^i channels, rectified; then a half grid
//!   back up:  matrix to the channels of the level, enlarged, beside the level's own, two convolutions
//! → matrix → [3, cells], red, green and blue from 0 to 1
//! ```
//!
//! Beside the paper's: what was not placed at all enters at the coarsest level as one column, the mean over all descriptors of
//! what a matrix makes of them ([`Sees::Bag`]). Three U-Nets in a row are in `invsfm.rs`.

mod convolution;
mod front;
mod invsfm;
mod levels;
mod sampling;
mod unet;

use invsfm::InvSfm;
use unet::UNet;
use veiloc_attacks::AttackError;
use veiloc_attacks::training::Matrix;
use veiloc_attacks::training::layers::Places;

/// Red, green and blue.
const COLOURS: usize = 3;

/// Sides of a grid, cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Grid {
    /// Of about so many cells on the longer side of an image of this size; sides are multiples of `multiple`.
    pub fn of_image([width, height]: [u32; 2], longer: usize, multiple: usize) -> Self {
        let scale = longer as f64 / f64::from(width.max(height).max(1));
        let side = |pixels: u32| {
            let whole = (f64::from(pixels) * scale / multiple as f64).round() as usize;
            whole.max(1) * multiple
        };
        Self { width: side(width), height: side(height) }
    }

    /// How many cells.
    pub fn cells(self) -> usize {
        self.width * self.height
    }

    /// With half the sides.
    fn half(self) -> Self {
        Self { width: self.width / 2, height: self.height / 2 }
    }
}

/// What is given of the places of descriptors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sees {
    /// One place each: the keypoint's, or where an attack puts it. The paper's.
    Places,
    /// What was sent: each is spread over its line, by how likely the guess finds the keypoint there.
    Lines,
    /// Nothing: descriptors in a bag.
    Bag,
}

impl Sees {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Places, Self::Lines, Self::Bag];

    /// What files and documents call it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Places => "places",
            Self::Lines => "lines",
            Self::Bag => "bag",
        }
    }
}

/// How a network is built.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// One U-Net, the paper's for SuperPoint.
    UNet,
    /// Three in a row, the paper's for SIFT (InvSfM): which placed descriptors to believe, a first image, a finer one.
    InvSfm,
}

impl Form {
    /// What documents call it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::UNet => "unet",
            Self::InvSfm => "invsfm",
        }
    }
}

/// How large a network is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shape {
    /// How it is built.
    pub form: Form,
    /// Length of the descriptors.
    pub dimension: usize,
    /// Channels of the finest level; twice as many on each coarser one. The paper's is 64.
    pub width: usize,
    /// Levels. The paper's is 5.
    pub depth: usize,
    /// Cells of the longer side of the image.
    pub side: usize,
    /// What is given of places.
    pub sees: Sees,
}

impl Shape {
    /// Whether such a network can be.
    ///
    /// # Errors
    /// [`AttackError::Option`].
    pub fn check(&self) -> Result<(), AttackError> {
        let of = [
            ("dimension", self.dimension, 1..=8192, "from 1 to 8192"),
            ("width", self.width, 1..=256, "from 1 to 256"),
            ("depth", self.depth, 1..=6, "from 1 to 6"),
            ("side", self.side, 16..=2048, "from 16 to 2048"),
        ];
        for (name, value, range, allowed) in of {
            if !range.contains(&value) {
                return Err(AttackError::refuse(name, value, allowed));
            }
        }
        Ok(())
    }

    /// Sides of a grid are multiples of this: they are halved so often.
    pub fn multiple(&self) -> usize {
        1 << (self.depth - 1)
    }

    /// The grid of an image of this size, pixels.
    pub fn grid(&self, size: [u32; 2]) -> Grid {
        Grid::of_image(size, self.side, self.multiple())
    }
}

/// Descriptors, and where they are placed.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Placed {
    /// Where.
    pub(crate) grid: Grid,
    /// `[dimension, N]`, columns whose squares sum up to their length.
    pub(crate) descriptors: Matrix,
    /// Descriptor, cell, and how much of it; nothing for a descriptor whose place is not known.
    pub(crate) shares: Vec<(u32, u32, f32)>,
}

impl Placed {
    /// By cell, how full it is: the shares of all descriptors in it.
    pub(crate) fn full(&self) -> Vec<f32> {
        let mut full = vec![0.0f32; self.grid.cells()];
        self.shares.iter().for_each(|(_, cell, share)| full[*cell as usize] += share);
        full
    }
}

/// What a network answers, and, in the same places, what a loss says of it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Made {
    /// `[3, cells]`, colours, mostly from 0 to 1.
    pub(crate) colours: Matrix,
    /// What earlier stages answer, where there are some.
    pub(crate) stages: Option<Stages>,
}

/// What the earlier stages of [`Form::InvSfm`] answer.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Stages {
    /// `[1, cells]`, log odds that what stands in a cell belongs there.
    pub(crate) odds: Matrix,
    /// `[3, cells]`, the first image.
    pub(crate) coarse: Matrix,
}

/// A network of any form, by where its numbers stand.
#[derive(Debug, Clone)]
pub(crate) struct Network {
    shape: Shape,
    layers: Layers,
}

#[derive(Debug, Clone)]
enum Layers {
    UNet(UNet),
    InvSfm(InvSfm),
}

/// What the way back needs.
#[derive(Debug)]
pub(crate) enum Tape {
    UNet(unet::Tape),
    InvSfm(invsfm::Tape),
}

impl Network {
    pub(crate) fn new(shape: Shape) -> (Self, Places) {
        let (layers, places) = match shape.form {
            Form::UNet => {
                let (net, places) = UNet::new(shape);
                (Layers::UNet(net), places)
            }
            Form::InvSfm => {
                let (net, places) = InvSfm::new(shape);
                (Layers::InvSfm(net), places)
            }
        };
        (Self { shape, layers }, places)
    }

    pub(crate) fn shape(&self) -> &Shape {
        &self.shape
    }

    pub(crate) fn forward(&self, numbers: &[f32], placed: &Placed) -> (Made, Tape) {
        match &self.layers {
            Layers::UNet(net) => {
                let (colours, tape) = net.forward(numbers, placed);
                (Made { colours, stages: None }, Tape::UNet(tape))
            }
            Layers::InvSfm(net) => {
                let (made, tape) = net.forward(numbers, placed);
                (made, Tape::InvSfm(tape))
            }
        }
    }

    /// Adds to the derivatives of all numbers, from those of what was answered. The tape is of the same network.
    pub(crate) fn backward(
        &self,
        numbers: &[f32],
        slopes: &mut [f32],
        placed: &Placed,
        tape: &Tape,
        of: &Made,
    ) {
        match (&self.layers, tape) {
            (Layers::UNet(net), Tape::UNet(tape)) => {
                net.backward(numbers, slopes, placed, tape, &of.colours);
            }
            (Layers::InvSfm(net), Tape::InvSfm(tape)) => net.backward(numbers, slopes, placed, tape, of),
            (Layers::UNet(_), Tape::InvSfm(_)) | (Layers::InvSfm(_), Tape::UNet(_)) => {
                unreachable!("a tape goes back to the network that wrote it")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn placed(rng: &mut ChaCha8Rng, grid: Grid) -> Placed {
        let shares =
            (0..20).map(|i| (i % 9, rng.random_range(0..grid.cells() as u32), rng.random_range(0.2..1.0)));
        let shares = shares.collect();
        Placed { grid, descriptors: Matrix::from_fn(7, 9, |_, _| rng.random_range(-1.0..1.0)), shares }
    }

    /// The slope of a sum of all answers along each number, by the way back and by differences.
    fn derivatives(form: Form, sees: Sees, depth: usize, grid: Grid) {
        let mut rng = ChaCha8Rng::seed_from_u64(depth as u64);
        let shape = Shape { form, dimension: 7, width: 3, depth, side: 16, sees };
        let (net, places) = Network::new(shape);
        let mut numbers = places.draw(&mut rng);
        // Biases too, and away from the kinks at zero.
        for n in &mut numbers {
            *n += rng.random_range(0.0..0.1);
        }
        let placed = placed(&mut rng, grid);
        let (made, tape) = net.forward(&numbers, &placed);
        let mut weigh = |like: &Matrix| like.map(|_| rng.random_range(-1.0..1.0));
        let weights = Made {
            colours: weigh(&made.colours),
            stages: made
                .stages
                .as_ref()
                .map(|stages| Stages { odds: weigh(&stages.odds), coarse: weigh(&stages.coarse) }),
        };
        let product = |a: &Matrix, b: &Matrix| -> f64 {
            a.iter().zip(b.iter()).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
        };
        let value = |numbers: &[f32]| -> f64 {
            let made = net.forward(numbers, &placed).0;
            let earlier = made.stages.as_ref().zip(weights.stages.as_ref());
            product(&made.colours, &weights.colours)
                + earlier.map_or(0.0, |(m, w)| product(&m.odds, &w.odds) + product(&m.coarse, &w.coarse))
        };
        let mut slopes = vec![0.0; numbers.len()];
        net.backward(&numbers, &mut slopes, &placed, &tape, &weights);
        let scale = slopes.iter().map(|s| s.abs()).fold(0.0, f32::max);
        let (mut far, mut steep) = (0, 0);
        for at in (0..numbers.len()).step_by(3) {
            let (here, step) = (numbers[at], 5e-4);
            numbers[at] = here + step;
            let after = value(&numbers);
            numbers[at] = here - step;
            let before = value(&numbers);
            numbers[at] = here;
            let numeric = ((after - before) / (2.0 * f64::from(step))) as f32;
            far += usize::from((numeric - slopes[at]).abs() > 0.02 * scale.min(numeric.abs() + 0.05 * scale));
            steep += usize::from(numeric.abs() > 0.01 * scale);
        }
        let count = numbers.len().div_ceil(3);
        // Where a step crosses the kink of a rectified channel, or another cell becomes the largest, differences err.
        assert!(far * 50 < count, "{form:?} {sees:?} {depth}: {far} of {count}");
        assert!(
            steep * 4 > count,
            "{form:?} {sees:?} {depth}: hardly anything has a slope, {steep} of {count}"
        );
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        derivatives(Form::UNet, Sees::Places, 1, Grid { width: 5, height: 3 });
        derivatives(Form::UNet, Sees::Places, 2, Grid { width: 6, height: 4 });
        derivatives(Form::UNet, Sees::Places, 3, Grid { width: 8, height: 12 });
        derivatives(Form::UNet, Sees::Bag, 2, Grid { width: 6, height: 4 });
    }

    #[test]
    fn derivatives_of_three_stages_are_those_of_differences() {
        derivatives(Form::InvSfm, Sees::Places, 1, Grid { width: 5, height: 3 });
        derivatives(Form::InvSfm, Sees::Places, 2, Grid { width: 6, height: 4 });
        derivatives(Form::InvSfm, Sees::Places, 3, Grid { width: 8, height: 4 });
    }
}
