//! The file of a network of neighbours: dimension, width, heads and layers (`u32` each), then all numbers (`f32` each, in
//! the order of the layers).

use crate::AttackError;
use crate::training::file::{Format, Reader, Writer};

use super::{Layers, NeighbourNetwork};
use crate::learned::engine::encoder::Shape;

const FORMAT: Format = Format {
    magic: b"VLNEIGHB",
    version: 1,
    expected: "network of neighbours; `veiloc train neighbours` writes one",
};

impl NeighbourNetwork {
    /// The bytes of its file.
    pub fn encode(&self) -> Vec<u8> {
        let Shape { inputs, width, heads, layers, .. } = self.layers.shape;
        let mut file = Writer::new(&FORMAT);
        // A shape that was checked is small.
        file.words(&[inputs, width, heads, layers].map(|x| x as u32));
        file.numbers(&self.numbers);
        file.finish()
    }

    /// A network from the bytes of its file.
    ///
    /// # Errors
    /// [`AttackError`] saying what is wrong: no network, another version, cut short, damaged.
    pub fn decode(bytes: &[u8]) -> Result<Self, AttackError> {
        let mut file = Reader::new(bytes, &FORMAT)?;
        let mut words = [0; 4];
        for word in &mut words {
            *word = file.word()? as usize;
        }
        let [inputs, width, heads, layers] = words;
        let shape = Shape { inputs, width, outputs: width, heads, layers, attends: true };
        shape.check()?;
        let (layers, places) = Layers::new(shape);
        file.seal(4 * places.count() as u64)?;
        Ok(Self { layers, numbers: file.numbers(places.count())? })
    }
}
