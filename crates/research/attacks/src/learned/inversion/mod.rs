//! Inversion networks: from descriptors, and information about their positions, to an image.
//!
//! ```text
//! features [1, dimension + 1, H, W]    descriptors in the cells of a grid over the image, or colours, or nothing; last
//!                                      channel: occupancy
//! → image [1, 3, H, W]                 red, green and blue of each cell, sRGB from 0 to 1
//! → visible [1, 1, H, W]               optional: probability that the descriptors of the cell are placed correctly
//! ```
//!
//! Positions are the true keypoints (the paper's upper bound), the answers of an attack, or the sent lines, where
//! each descriptor is spread over its line by the prior-only likelihood of the keypoint. A cell with descriptors of
//! shares `sᵢ` has the channels `Σ sᵢ dᵢ / max(Σ sᵢ, 1)`, and `ln(1 + Σ sᵢ)` as the last one.

mod cells;
mod grid;

use std::path::Path;

use veiloc_features::ColourImage;
use veiloc_features::learned::Tensor;
use veiloc_geometry::Pixel;

pub use self::grid::Grid;
use super::description::{DescribedNetwork, InputModality, NetworkKind};
use crate::{AttackError, DecodedDescriptors, Observation};

/// Allowed numbers of cells along the longer side.
const SIDES: std::ops::RangeInclusive<usize> = 16..=2048;
/// Maximum number of values in a grid: one gibibyte.
const MAX_NUMBERS: usize = 1 << 28;

/// What the attacker knows about the positions of descriptors.
#[derive(Debug, Clone, Copy)]
pub enum PositionKnowledge<'a> {
    /// One position per descriptor, `[N]`, pixels; positions that are not finite or outside the image are left out.
    Positions(&'a [Pixel]),
    /// The sent observations, `[N]`.
    Lines(&'a [Observation]),
    /// No position: every descriptor is spread evenly over all cells.
    None,
}

/// Output of an inversion network.
#[derive(Debug, Clone, PartialEq)]
pub struct Reconstruction {
    /// One pixel per cell.
    pub image: ColourImage,
    /// Probability that each descriptor was placed correctly, `[N]`, 0 to 1; NaN for a descriptor outside the image.
    /// `None` for a network without this output, and if no positions were given.
    pub visibility: Option<Vec<f32>>,
}

/// Reconstructs an image from descriptors.
#[derive(Debug)]
pub struct InversionNetwork {
    network: DescribedNetwork,
    side: usize,
    multiple: usize,
    input: InputModality,
}

impl InversionNetwork {
    /// Reads a network from its description, or from the ONNX file beside it.
    ///
    /// # Errors
    /// [`AttackError::Description`] and [`AttackError::Features`], with the file's name.
    pub fn open(path: &Path) -> Result<Self, AttackError> {
        let (network, description) = DescribedNetwork::open(path, NetworkKind::Inversion)?;
        let (side, multiple) = (description.side.unwrap_or(0), description.multiple.unwrap_or(0));
        if !SIDES.contains(&side) {
            let (least, most) = (SIDES.start(), SIDES.end());
            return Err(
                network.description_error(format!("its side is {side}; it must be from {least} to {most}"))
            );
        }
        if multiple == 0 || !side.is_multiple_of(multiple) {
            return Err(network.description_error(format!("its multiple, {multiple}, must divide its side")));
        }
        let channels = network.dimension() + 1;
        if channels * side * side > MAX_NUMBERS {
            let reason = format!("a grid of side {side} exceeds {MAX_NUMBERS} values");
            return Err(network.description_error(reason));
        }
        network.check(&[("features", &[Some(1), Some(channels), None, None])], &["image"])?;
        Ok(Self { network, side, multiple, input: description.input.unwrap_or(InputModality::Descriptors) })
    }

    /// The description's file.
    pub fn file(&self) -> &Path {
        self.network.file()
    }

    /// The descriptor kind of its training data.
    pub fn features(&self) -> &str {
        self.network.features()
    }

    /// The descriptor length.
    pub fn dimension(&self) -> usize {
        self.network.dimension()
    }

    /// What it is given at each position.
    pub fn input(&self) -> InputModality {
        self.input
    }

    /// Cells along the longer side.
    pub fn side(&self) -> usize {
        self.side
    }

    /// Whether the network estimates which positions are correct.
    pub fn has_visibility(&self) -> bool {
        self.network.has_output("visible")
    }

    /// The grid for an image of this size, pixels.
    pub fn grid(&self, size: [u32; 2]) -> Grid {
        Grid::of_image(size, self.side, self.multiple)
    }

    /// The image reconstructed from descriptors and what is `known` of their positions, on the grid of an image of
    /// `size` pixels. `times`: each side of the view is this multiple of the image's side, with the image in the
    /// centre; 1 for the image itself.
    ///
    /// # Errors
    /// [`AttackError::Dimensions`] for descriptors with another length than the network's,
    /// [`AttackError::DescriptorCount`] when the numbers of descriptors and positions differ,
    /// [`AttackError::Features`] when the network cannot run.
    pub fn invert(
        &self,
        descriptors: &DecodedDescriptors,
        size: [u32; 2],
        known: PositionKnowledge<'_>,
        times: u32,
    ) -> Result<Reconstruction, AttackError> {
        self.network.check_dimension(descriptors)?;
        let one = self.grid(size);
        let grid = Grid { width: one.width * times as usize, height: one.height * times as usize };
        let view = size.map(|side| side * times);
        let margin = size.map(|side| f64::from(side) * 0.5 * f64::from(times - 1));
        let placed = match known {
            PositionKnowledge::Positions(at) => {
                let moved: Vec<Pixel> =
                    at.iter().map(|p| Pixel::new(p.u + margin[0], p.v + margin[1])).collect();
                Some((at.len(), cells::at(&moved, view, grid)))
            }
            PositionKnowledge::Lines(sent) => Some((sent.len(), cells::along(sent, view, grid))),
            PositionKnowledge::None => None,
        };
        let given = match &placed {
            Some((count, _)) if *count != descriptors.len() => {
                let (keypoints, descriptors) = (*count, descriptors.len());
                return Err(AttackError::DescriptorCount { keypoints, descriptors });
            }
            Some((_, shares)) => placed_on(grid, descriptors, shares),
            None => spread_over(grid, descriptors),
        };
        let sides = |channels| [Some(1), Some(channels), Some(grid.height), Some(grid.width)];
        let (of_image, of_visible) = (sides(3), sides(1));
        let mut outputs: Vec<(&str, &[Option<usize>])> = vec![("image", &of_image)];
        if self.has_visibility() && matches!(known, PositionKnowledge::Positions(_)) {
            outputs.push(("visible", &of_visible));
        }
        let mut results = self.network.run(&[("features", &given)], &outputs)?.into_iter();
        let colours = results.next().map(|colours| colours.data).unwrap_or_default();
        let visibility = results.next().zip(placed).map(|(visible, (count, shares))| {
            let mut visibility = vec![f32::NAN; count];
            for (descriptor, cell, _) in shares {
                visibility[descriptor as usize] = visible.data[cell as usize].clamp(0.0, 1.0);
            }
            visibility
        });
        Ok(Reconstruction { image: image_of(&colours, grid), visibility })
    }
}

/// Descriptors accumulated in their cells, `[1, dimension + 1, H, W]`.
fn placed_on(grid: Grid, descriptors: &DecodedDescriptors, shares: &[cells::CellShare]) -> Tensor {
    let (cells, dimension) = (grid.cells(), descriptors.dimension());
    let mut full = vec![0.0f32; cells];
    for (_, cell, share) in shares {
        full[*cell as usize] += share;
    }
    let scale = (dimension as f32).sqrt();
    let mut data = vec![0.0; (dimension + 1) * cells];
    for (descriptor, cell, share) in shares {
        let cell = *cell as usize;
        let share = scale * share / full[cell].max(1.0);
        let channels = data[cell..].iter_mut().step_by(cells);
        let from = descriptors.columns().column(*descriptor as usize);
        channels.zip(from.iter()).for_each(|(to, from)| *to += share * from);
    }
    for (to, full) in data[dimension * cells..].iter_mut().zip(&full) {
        *to = full.ln_1p();
    }
    tensor(grid, data)
}

/// All descriptors in all cells with equal shares: the information of descriptors without positions.
fn spread_over(grid: Grid, descriptors: &DecodedDescriptors) -> Tensor {
    let (cells, dimension) = (grid.cells(), descriptors.dimension());
    let full = descriptors.len() as f32 / cells as f32;
    let share = (dimension as f32).sqrt() / cells as f32 / full.max(1.0);
    let mut data = Vec::with_capacity((dimension + 1) * cells);
    for row in descriptors.columns().row_iter() {
        data.extend(std::iter::repeat_n(share * row.sum(), cells));
    }
    data.extend(std::iter::repeat_n(full.ln_1p(), cells));
    tensor(grid, data)
}

fn tensor(grid: Grid, data: Vec<f32>) -> Tensor {
    Tensor { shape: vec![1, data.len() / grid.cells(), grid.height, grid.width], data }
}

/// `[3, cells]`, clamped to 0 to 1.
fn image_of(colours: &[f32], grid: Grid) -> ColourImage {
    let cells = grid.cells();
    let byte = |value: f32| (255.0 * value.clamp(0.0, 1.0)).round() as u8;
    let pixel = |cell: usize| [0, 1, 2].map(|colour| byte(colours[colour * cells + cell]));
    let image = ColourImage::new(grid.width as u32, grid.height as u32, (0..cells).flat_map(pixel).collect());
    image.expect("three bytes for each cell of a grid that has some")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grid_keeps_aspect_ratio() {
        let of = |size| Grid::of_image(size, 256, 16);
        assert_eq!(of([640, 480]), Grid { width: 256, height: 192 });
        assert_eq!(of([480, 640]), Grid { width: 192, height: 256 });
        assert_eq!(of([512, 333]), Grid { width: 256, height: 160 });
        assert_eq!(of([5000, 3]), Grid { width: 256, height: 16 }, "at least one multiple");
    }

    #[test]
    fn cells_hold_weighted_means_and_occupancy() {
        let descriptors = DecodedDescriptors::new(&[3, 4, 0, 0, 8, 6], 2).expect("three of them");
        let grid = Grid { width: 2, height: 1 };
        // The first and the last share a cell; the middle one is all zeros, so only its share is visible.
        let shares = [(0, 0, 1.0), (2, 0, 0.5), (1, 1, 0.25)];
        let placed = placed_on(grid, &descriptors, &shares);
        assert_eq!(placed.shape, [1, 3, 1, 2]);
        let scale = 2f32.sqrt();
        let expected = [
            scale * (0.6 + 0.5 * 0.8) / 1.5,
            0.0,
            scale * (0.8 + 0.5 * 0.6) / 1.5,
            0.0,
            1.5f32.ln_1p(),
            0.25f32.ln_1p(),
        ];
        assert!(
            placed.data.iter().zip(expected).all(|(own, other)| (own - other).abs() < 1e-6),
            "{expected:?}"
        );

        let everywhere: Vec<cells::CellShare> =
            (0..3).flat_map(|i| (0..2).map(move |cell| (i, cell, 0.5))).collect();
        let spread = spread_over(grid, &descriptors);
        let same = placed_on(grid, &descriptors, &everywhere);
        assert!(spread.data.iter().zip(&same.data).all(|(own, other)| (own - other).abs() < 1e-6));
    }
}
