//! Learned attacks: networks trained in PyTorch on images of other scenes (`research/train`) and run here by rten.
//!
//! - [`neighbours`]: from the descriptors of an image to a neighbour graph, for the attacks that need neighbours;
//! - [`positions`]: from all rows of a query, descriptors and lines, to the position of each keypoint on its line;
//! - [`inversion`]: from descriptors and information about their positions to an image.
//!
//! A network is an ONNX file with a short text file beside it, its description:
//!
//! ```toml
//! version = 1
//! kind = "inversion"            # or "positions", "neighbours"
//! model = "dcl.onnx"            # the name of a file beside this one
//! features = "sift"             # kind of descriptors it learned from
//! dimension = 128               # their length
//! # of inversion:
//! side = 256                    # cells of the longer side of the grid, pixels of the image
//! multiple = 16                 # sides of the grid are multiples of this; it divides `side`
//! input = "descriptors"         # the default; "positions" (dimension 0), or "colour" of each position (dimension 3)
//! # of positions:
//! scheme = "dcl"                # under which it learned, as `--scheme` has it
//! input = "set"                 # of a query: all rows ("set"), each row alone ("row"), each line alone ("line")
//! ```
//!
//! The input descriptors of all networks are scaled to a squared norm equal to their length; a zero descriptor stays
//! zero. A defect in a description or a network is an error with the file's name; no content of a file ends the
//! program.

mod description;
pub mod inversion;
pub mod neighbours;
pub mod positions;

use veiloc_features::learned::Tensor;

pub use self::description::InputModality;
use crate::DecodedDescriptors;

/// `[1, N, dimension]`, each row scaled to a squared norm equal to its length.
fn rows(descriptors: &DecodedDescriptors) -> Tensor {
    let scale = (descriptors.dimension() as f32).sqrt();
    let shape = vec![1, descriptors.len(), descriptors.dimension()];
    Tensor { shape, data: descriptors.columns().iter().map(|x| x * scale).collect() }
}
