//! The file of a trained network.
//!
//! ```text
//! "VLNEIGHB"            8 bytes
//! version               u32, 1
//! dimension, width, heads, layers    u32 each
//! parameters            f32 each, in the order of the layers
//! checksum              u64, XXH3 of all that stands before
//! ```
//! Little-endian throughout.

use burn::backend::ndarray::NdArrayDevice;
use xxhash_rust::xxh3::xxh3_64;

use super::NeighbourNetwork;
use super::error::NetworkError;
use super::model::Shape;
use super::parameters;

const MAGIC: &[u8; 8] = b"VLNEIGHB";
const VERSION: u32 = 1;
/// Bytes before the parameters.
const HEAD: usize = 28;
/// Bytes behind them.
const TAIL: usize = 8;

impl NeighbourNetwork {
    /// The bytes of its file.
    pub fn encode(&self) -> Vec<u8> {
        let Shape { dimension, width, heads, layers } = self.shape;
        let mut bytes = MAGIC.to_vec();
        bytes.extend(VERSION.to_le_bytes());
        // A shape that was checked is small.
        bytes.extend([dimension, width, heads, layers].iter().flat_map(|x| (*x as u32).to_le_bytes()));
        bytes.extend(parameters::list(&self.encoder).iter().flat_map(|x| x.to_le_bytes()));
        let checksum = xxh3_64(&bytes);
        bytes.extend(checksum.to_le_bytes());
        bytes
    }

    /// A network from the bytes of its file.
    ///
    /// # Errors
    /// [`NetworkError`] saying what is wrong: no network, another version, cut short, damaged.
    pub fn decode(bytes: &[u8]) -> Result<Self, NetworkError> {
        if !bytes.starts_with(MAGIC) {
            return Err(NetworkError::NotANetwork);
        }
        let cut_short = NetworkError::Length { found: bytes.len(), expected: (HEAD + TAIL) as u64 };
        let word = |i: usize| {
            let at = bytes.get(8 + 4 * i..12 + 4 * i)?;
            Some(u32::from_le_bytes(at.try_into().ok()?))
        };
        let [Some(version), Some(dimension), Some(width), Some(heads), Some(layers)] =
            [0, 1, 2, 3, 4].map(word)
        else {
            return Err(cut_short);
        };
        if version != VERSION {
            return Err(NetworkError::Version { found: version, expected: VERSION });
        }
        let shape = Shape {
            dimension: dimension as usize,
            width: width as usize,
            heads: heads as usize,
            layers: layers as usize,
        };
        shape.check()?;
        let expected = (HEAD + TAIL) as u64 + 4 * shape.parameters();
        if bytes.len() as u64 != expected {
            return Err(NetworkError::Length { found: bytes.len(), expected });
        }
        let (body, checksum) = bytes.split_at(bytes.len() - TAIL);
        if checksum != xxh3_64(body).to_le_bytes() {
            return Err(NetworkError::Checksum);
        }
        let values: Vec<f32> = body[HEAD..]
            .chunks_exact(4)
            .map(|four| f32::from_le_bytes([four[0], four[1], four[2], four[3]]))
            .collect();
        if values.iter().any(|v| !v.is_finite()) {
            return Err(NetworkError::NotFinite);
        }
        Ok(Self { shape, encoder: parameters::filled(&shape, &values, &NdArrayDevice::default()) })
    }
}
