//! A network over the set of descriptors of an image that predicts which keypoints are neighbours.
//!
//! After Chelani et al., *Obfuscation Based Privacy Preserving Representations are Recoverable Using Neighborhood
//! Information*: every descriptor is embedded, self-attention relates it to the others of its image, and the
//! likelihood of a pair grows with the similarity of its embeddings.
//!
//! ```text
//! descriptors [1, N, dimension] → embedding [1, N, E], rows of length 1; the larger a product of two, the likelier neighbours
//! ```

use std::path::Path;

use veiloc_geometry::nalgebra::DMatrix;

use super::description::{DescribedNetwork, NetworkKind};
use super::rows;
use crate::{AttackError, DecodedDescriptors, NeighbourLists, likeliest_pairs};

/// Predicts from descriptors alone which keypoints are neighbours.
#[derive(Debug)]
pub struct NeighbourNetwork(DescribedNetwork);

impl NeighbourNetwork {
    /// Reads a network from its description, or from the ONNX file beside it.
    ///
    /// # Errors
    /// [`AttackError::Description`] and [`AttackError::Features`], with the file's name.
    pub fn open(path: &Path) -> Result<Self, AttackError> {
        let (network, _) = DescribedNetwork::open(path, NetworkKind::Neighbours)?;
        network.check(&[("descriptors", &[Some(1), None, Some(network.dimension())])], &["embedding"])?;
        Ok(Self(network))
    }

    /// The descriptor kind of its training data.
    pub fn features(&self) -> &str {
        self.0.features()
    }

    /// The `k` likeliest neighbours of each keypoint, likeliest first; ties are ordered by index.
    ///
    /// # Errors
    /// [`AttackError::Dimensions`] when the descriptors have another dimension than the network's,
    /// [`AttackError::Features`] when the network cannot run.
    pub fn predict(&self, descriptors: &DecodedDescriptors, k: usize) -> Result<NeighbourLists, AttackError> {
        self.0.check_dimension(descriptors)?;
        let count = descriptors.len();
        if count == 0 {
            return NeighbourLists::from_lists(&[]);
        }
        let sides = [Some(1), Some(count), None];
        let embedding =
            self.0.run(&[("descriptors", &rows(descriptors))], &[("embedding", &sides)])?.remove(0);
        // A row of one matrix is a column of the other.
        let embedding = DMatrix::from_vec(embedding.data.len() / count, count, embedding.data);
        NeighbourLists::from_lists(&likeliest_pairs(&embedding, &embedding, &vec![0.0; count], k))
    }
}
