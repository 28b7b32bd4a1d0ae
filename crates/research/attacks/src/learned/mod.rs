//! Attackers that are networks: trained in PyTorch on images of elsewhere (`research/train`), run here by rten.
//!
//! - [`neighbours`]: from the descriptors of an image to who is near whom, for the attacks that live on neighbours;
//! - [`positions`]: from all rows of a query, descriptors and lines, to where on its line each keypoint lies;
//! - [`inversion`]: from descriptors and what is known of their places to an image.
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
//! # of positions:
//! scheme = "dcl"                # under which it learned, as `--scheme` has it
//! sees = "set"                  # of a query: all rows ("set"), each row alone ("row"), each line alone ("line")
//! ```
//!
//! All networks are given descriptors whose squares sum up to their length; a descriptor of zeros stays zero.
//! What is wrong with a description or a network is an error that names the file, whatever the file holds.

mod description;
pub mod inversion;
pub mod neighbours;
pub mod positions;

use veiloc_features::learned::Tensor;

use crate::Descriptors;

/// `[1, N, dimension]`, the squares of a row summing up to its length.
fn rows(descriptors: &Descriptors) -> Tensor {
    let scale = (descriptors.dimension() as f32).sqrt();
    let shape = vec![1, descriptors.len(), descriptors.dimension()];
    Tensor { shape, data: descriptors.columns().iter().map(|x| x * scale).collect() }
}
