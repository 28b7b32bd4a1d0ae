//! The file of a network of positions: dimension, width, heads, layers, what it sees (0 set, 1 row, 2 line), half waves,
//! and length of the scheme's name (`u32` each), the name, filled up with zeros to a multiple of four bytes, then all
//! numbers (`f32` each, in the order of the layers).

use crate::AttackError;
use crate::training::file::{Format, Reader, Writer};

use super::waves::MOST_WAVES;
use super::{Layers, PositionNetwork, Sees};
use crate::learned::engine::encoder::Shape;
use crate::learned::options::refuse;

const FORMAT: Format = Format {
    magic: b"VLPLACES",
    version: 1,
    expected: "network of positions; `veiloc train positions` writes one",
};

impl PositionNetwork {
    /// The bytes of its file.
    pub fn encode(&self) -> Vec<u8> {
        let Shape { width, heads, layers, .. } = self.layers.shape;
        let sees = Sees::ALL.iter().position(|s| *s == self.layers.sees).unwrap_or(0);
        let mut file = Writer::new(&FORMAT);
        // A shape that was checked is small.
        let head = [self.layers.dimension, width, heads, layers, sees, MOST_WAVES];
        file.words(&head.map(|x| x as u32));
        file.text(&self.scheme.to_string());
        file.numbers(&self.numbers);
        file.finish()
    }

    /// A network from the bytes of its file.
    ///
    /// # Errors
    /// [`AttackError`] saying what is wrong: no network, another version, cut short, damaged.
    pub fn decode(bytes: &[u8]) -> Result<Self, AttackError> {
        let mut file = Reader::new(bytes, &FORMAT)?;
        let mut words = [0; 6];
        for word in &mut words {
            *word = file.word()? as usize;
        }
        let [dimension, width, heads, layers, sees, waves] = words;
        let sees = Sees::ALL.get(sees).copied().ok_or_else(|| refuse("what it sees", sees, "0, 1 or 2"))?;
        if waves != MOST_WAVES {
            return Err(refuse("half waves", waves, "11"));
        }
        let name = file.text("length of the scheme's name")?;
        let (layers, places) = Layers::new(dimension, sees, [width, heads, layers])?;
        file.seal(4 * places.count() as u64)?;
        let scheme = name.parse().map_err(|_| AttackError::Scheme {
            found: name.clone(),
            expected: "no scheme is called so".to_owned(),
        })?;
        Ok(Self { layers, numbers: file.numbers(places.count())?, scheme })
    }
}
