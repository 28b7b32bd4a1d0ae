//! A trained network, and its file.
//!
//! ```text
//! "VLINVERT"            8 bytes; "VLINVSFM" for three U-Nets in a row
//! version               u32, 1
//! dimension, width, levels, cells of the longer side, what it sees (0 places, 1 lines, 2 bag),
//! length of the scheme's name                                          u32 each
//! name of the scheme    filled up with zeros to a multiple of four bytes
//! all numbers           f32 each, in the order of the layers
//! checksum              u64, XXH3 of all that stands before
//! ```

use crate::EvalError;
use crate::inversion::example::{columns, descriptors};
use crate::inversion::network::{Form, Grid, Made, Network, Placed, Sees, Shape};
use crate::inversion::pixels::to_image;
use crate::inversion::places;
use veiloc_attacks::AttackError;
use veiloc_attacks::Observation;
use veiloc_attacks::training::file::{Format, Reader, Writer};
use veiloc_datasets::problem_files::KeypointImage;
use veiloc_features::ColourImage;
use veiloc_geometry::Pixel;
use veiloc_protocol::Scheme;

/// What networks of each form are written as.
const FORMATS: [(Form, Format); 2] = [
    (Form::UNet, Format { magic: b"VLINVERT", version: 1, expected: EXPECTED }),
    (Form::InvSfm, Format { magic: b"VLINVSFM", version: 1, expected: EXPECTED }),
];
const EXPECTED: &str = "inversion network; `veiloc train inversion` writes one";

/// Makes an image of descriptors; made by [`crate::inversion::train`] or [`Self::decode`].
#[derive(Debug, Clone)]
pub struct Inverter {
    net: Network,
    numbers: Vec<f32>,
    scheme: Scheme,
}

/// What is known of the places of descriptors, `[N]`.
#[derive(Debug, Clone, Copy)]
pub enum Known<'a> {
    /// A place each, pixels; one that is not finite or lies beyond the image is left out.
    Places(&'a [Pixel]),
    /// What was sent.
    Lines(&'a [Observation]),
    /// Nothing.
    Nothing,
}

impl Inverter {
    pub(crate) fn new(net: Network, numbers: Vec<f32>, scheme: Scheme) -> Self {
        Self { net, numbers, scheme }
    }

    /// How large it is, and what it sees.
    pub fn shape(&self) -> &Shape {
        self.net.shape()
    }

    /// Under which scheme it learned; [`Scheme::Points`] for one that sees no lines.
    pub fn scheme(&self) -> Scheme {
        self.scheme
    }

    /// How many numbers were learned.
    pub fn parameters(&self) -> usize {
        self.numbers.len()
    }

    /// The image on the network's grid, of the descriptors of `image` and what is `known` of their places; its keypoints are
    /// not read. `times`: of the view, each side so many times the image's, the image in its middle; 1 for the image itself.
    ///
    /// # Errors
    /// [`EvalError::Descriptors`] for descriptors of another length than those learned from.
    pub fn invert(
        &self,
        image: &KeypointImage,
        known: Known<'_>,
        times: u32,
    ) -> Result<ColourImage, EvalError> {
        let (placed, made) = self.made(image, known, times)?;
        Ok(to_image(&made.colours, placed.grid))
    }

    /// How far each of these descriptors is believed to stand where it was placed, `[N]`, from 0 to 1; NaN for one that is
    /// placed beyond the image. `None` of a network that judges no places ([`Form::UNet`]).
    ///
    /// # Errors
    /// As [`Self::invert`].
    pub fn beliefs(&self, image: &KeypointImage, places: &[Pixel]) -> Result<Option<Vec<f32>>, EvalError> {
        if self.shape().form == Form::UNet {
            return Ok(None);
        }
        let (placed, made) = self.made(image, Known::Places(places), 1)?;
        Ok(made.stages.map(|stages| {
            let mut beliefs = vec![f32::NAN; places.len()];
            for (descriptor, cell, _) in &placed.shares {
                beliefs[*descriptor as usize] = 1.0 / (1.0 + (-stages.odds[*cell as usize]).exp());
            }
            beliefs
        }))
    }

    fn made(&self, image: &KeypointImage, known: Known<'_>, times: u32) -> Result<(Placed, Made), EvalError> {
        let (bytes, dimension) = descriptors(image, self.shape().dimension)?;
        let size = [image.width, image.height];
        let one = self.shape().grid(size);
        let grid = Grid { width: one.width * times as usize, height: one.height * times as usize };
        let view = size.map(|side| side * times);
        let margin = size.map(|side| f64::from(side) * 0.5 * f64::from(times - 1));
        let shares = match known {
            Known::Places(at) => {
                let moved: Vec<Pixel> =
                    at.iter().map(|p| Pixel::new(p.u + margin[0], p.v + margin[1])).collect();
                places::at(&moved, view, grid)
            }
            Known::Lines(sent) => places::along(sent, view, grid),
            Known::Nothing => Vec::new(),
        };
        let rows = bytes.chunks_exact(dimension);
        let count = rows.len();
        let placed = Placed { grid, descriptors: columns(rows, dimension, count), shares };
        let (made, _) = self.net.forward(&self.numbers, &placed);
        Ok((placed, made))
    }

    /// The bytes of its file.
    pub fn encode(&self) -> Vec<u8> {
        let Shape { form, dimension, width, depth, side, sees } = *self.shape();
        let sees = Sees::ALL.iter().position(|s| *s == sees).unwrap_or(0);
        let of_form = FORMATS.iter().find(|(of, _)| *of == form);
        let mut file = Writer::new(&of_form.unwrap_or(&FORMATS[0]).1);
        // A shape that was checked is small.
        file.words(&[dimension, width, depth, side, sees].map(|x| x as u32));
        file.text(&self.scheme.to_string());
        file.numbers(&self.numbers);
        file.finish()
    }

    /// A network from the bytes of its file.
    ///
    /// # Errors
    /// [`EvalError`] saying what is wrong: no network, another version, cut short, damaged.
    pub fn decode(bytes: &[u8]) -> Result<Self, EvalError> {
        let written = FORMATS.iter().find(|(_, format)| bytes.starts_with(format.magic));
        let (form, format) = written.unwrap_or(&FORMATS[0]);
        let mut file = Reader::new(bytes, format)?;
        let mut words = [0; 5];
        for word in &mut words {
            *word = file.word()? as usize;
        }
        let [dimension, width, depth, side, sees] = words;
        let refuse = AttackError::refuse;
        let sees = Sees::ALL.get(sees).copied().ok_or_else(|| refuse("what it sees", sees, "0, 1 or 2"))?;
        let name = file.text("length of the scheme's name")?;
        let shape = Shape { form: *form, dimension, width, depth, side, sees };
        shape.check()?;
        let (net, places) = Network::new(shape);
        file.seal(4 * places.count() as u64)?;
        let unknown = || EvalError::Scheme { found: name.clone(), expected: "no scheme is called so" };
        let scheme = name.parse().map_err(|_| unknown())?;
        Ok(Self { net, numbers: file.numbers(places.count())?, scheme })
    }
}
