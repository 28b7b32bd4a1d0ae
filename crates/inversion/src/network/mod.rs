//! The network: a U-Net over a grid on which descriptors were placed, to the colours of each cell.
//!
//! After Ronneberger et al., *U-Net*, MICCAI 2015, as Dangwal et al. (*Mitigating reverse engineering attacks on local feature
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
//! Two ways beside the paper's: what was not placed at all enters at the coarsest level as one column, the mean over all
//! descriptors of what a matrix makes of them ([`Sees::Bag`]).

mod convolution;
mod sampling;
mod unet;

use veiloc_training::{Matrix, TrainingError};

pub(crate) use unet::UNet;

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

/// How large a network is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shape {
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
    /// [`TrainingError::Option`].
    pub fn check(&self) -> Result<(), TrainingError> {
        let of = [
            ("dimension", self.dimension, 1..=8192, "from 1 to 8192"),
            ("width", self.width, 1..=256, "from 1 to 256"),
            ("depth", self.depth, 1..=6, "from 1 to 6"),
            ("side", self.side, 16..=2048, "from 16 to 2048"),
        ];
        for (name, value, range, allowed) in of {
            if !range.contains(&value) {
                return Err(TrainingError::refuse(name, value, allowed));
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

    /// Channels of a level.
    fn channels(&self, level: usize) -> usize {
        self.width << level
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
