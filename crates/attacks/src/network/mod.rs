//! An attention network over the set of descriptors of an image, which predicts who is whose neighbour.
//!
//! After Chelani et al., *Obfuscation Based Privacy Preserving Representations are Recoverable Using Neighborhood
//! Information*: every descriptor is embedded, self-attention lets it see the others of its image, and a pair is the
//! likelier the more alike its embeddings are. Nothing but descriptors goes in; positions are needed for training
//! alone, on images that the attacker took himself.
//!
//! ```text
//! descriptors [N, dimension] → linear → (norm, attention, +; norm, two layers, +) × layers → norm, linear, unit length
//! logit of (i, j) = e^s ⟨eᵢ, eⱼ⟩,   loss = mean over i and the neighbours j of i of −log softmax_j
//! ```
//!
//! Trained and run by burn on the CPU. Equal seeds give equal networks.

mod batches;
mod dropout;
mod error;
mod file;
mod loss;
mod model;
mod options;
mod parameters;
mod schedule;
mod training;

use burn::backend::NdArray;
use burn::backend::ndarray::NdArrayDevice;
use burn::tensor::{Tensor, TensorData};
use veiloc_geometry::nalgebra::DMatrix;

use crate::error::AttackError;
use crate::features::Descriptors;
use crate::neighbours::NeighbourLists;
use crate::ranking::likeliest_pairs;

pub use error::NetworkError;
pub use options::TrainingOptions;
pub use training::{CurvePoint, PRECISION_AT, Trained, train};

use dropout::Dropout;
use model::{Encoder, Shape};

/// Where networks are run.
type Cpu = NdArray<f32>;

/// Says from descriptors alone which keypoints are likely neighbours; made by [`train`] or [`Self::decode`].
#[derive(Debug, Clone)]
pub struct NeighbourNetwork {
    shape: Shape,
    encoder: Encoder<Cpu>,
}

impl NeighbourNetwork {
    /// The `k` likeliest neighbours of each keypoint, likeliest first, equal ones by index.
    ///
    /// # Errors
    /// [`AttackError::Dimensions`] when the descriptors are of another dimension than those learned from.
    pub fn predict(&self, descriptors: &Descriptors, k: usize) -> Result<NeighbourLists, AttackError> {
        let found = descriptors.columns().nrows();
        if found != self.shape.dimension {
            return Err(AttackError::Dimensions { expected: self.shape.dimension, found });
        }
        if descriptors.is_empty() {
            return NeighbourLists::from_lists(&[]);
        }
        let embedded = self.embed(descriptors);
        let nothing = vec![0.0; embedded.ncols()];
        NeighbourLists::from_lists(&likeliest_pairs(&embedded, &embedded, &nothing, k))
    }

    /// Numbers that were learned.
    pub fn parameters(&self) -> usize {
        self.shape.parameters() as usize
    }

    /// `[width, N]`: unit columns, the more alike the likelier neighbours.
    fn embed(&self, descriptors: &Descriptors) -> DMatrix<f32> {
        let input = batches::input(descriptors);
        let rows = descriptors.len();
        let data = TensorData::new(input.as_slice().to_vec(), [rows, self.shape.dimension]);
        let x = Tensor::<Cpu, 2>::from_data(data, &NdArrayDevice::default());
        let embedded = self.encoder.forward(x, &mut Dropout::none()).into_data();
        // Row-major [N, width] is column-major [width, N]. The backend computes in f32, so the conversion never fails.
        DMatrix::from_iterator(self.shape.width, rows, embedded.iter::<f32>())
    }
}
