//! A network that can be run: an ONNX file, or a graph made of weights, in an engine.

use std::path::Path;

use crate::FeatureError;
use crate::learned::engine::{Engine, Run};
use crate::learned::{Layer, Tensor};

/// Most bytes of an ONNX file that are read.
const MOST_BYTES: u64 = 512 << 20;

/// A network whose input is an image, or several.
pub struct Network {
    engine: Engine,
    running: Box<dyn Run>,
    /// `[N, C, H, W]` of each input; `None` where a side is open.
    inputs: Vec<Vec<Option<usize>>>,
}

impl std::fmt::Debug for Network {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Network({}, {:?})", self.engine.name(), self.input())
    }
}

impl Network {
    /// Reads an ONNX file. It is run with as many threads as rayon has where it is opened.
    ///
    /// # Errors
    /// [`FeatureError::Read`], and [`FeatureError::Network`] for a file that is no network or is damaged, or an engine that is not there.
    pub fn open(path: &Path, engine: Engine) -> Result<Self, FeatureError> {
        Self::of_onnx(crate::learned::file::read(path, MOST_BYTES)?, engine)
            .map_err(|reason| FeatureError::Network { path: path.to_owned(), reason })
    }

    /// The same of what is in memory; what is wrong with it in words.
    pub(crate) fn of_onnx(bytes: Vec<u8>, engine: Engine) -> Result<Self, String> {
        let running = engine.load(bytes)?;
        Ok(Self { engine, inputs: running.inputs(), running })
    }

    /// What runs it.
    pub fn engine(&self) -> Engine {
        self.engine
    }

    /// Sides of the first input, `[N, C, H, W]` where it is an image; `None` for a side that is open.
    pub fn input(&self) -> &[Option<usize>] {
        self.sides_of(0)
    }

    /// The same of any of its inputs; none of one that it lacks.
    pub(crate) fn sides_of(&self, input: usize) -> &[Option<usize>] {
        self.inputs.get(input).map(Vec::as_slice).unwrap_or_default()
    }

    /// How many inputs and outputs it has.
    pub fn ends(&self) -> [usize; 2] {
        self.running.ends()
    }

    /// What the file says of itself under a key.
    pub fn metadata(&self, key: &str) -> Option<String> {
        self.running.metadata(key)
    }

    /// Runs it on an image `[1, C, H, W]`; results of these layers, in their order.
    ///
    /// # Errors
    /// [`FeatureError::NetworkRun`].
    pub fn run(&self, image: &Tensor, layers: &[Layer]) -> Result<Vec<Tensor>, FeatureError> {
        self.run_on(&[image], layers)
    }

    /// The same of a network with several inputs, each `[1, C, H, W]`, in the file's order.
    pub(crate) fn run_on(&self, images: &[&Tensor], layers: &[Layer]) -> Result<Vec<Tensor>, FeatureError> {
        let broken = |reason: String| FeatureError::NetworkRun { reason };
        let inputs: Option<Vec<([usize; 3], &[f32])>> =
            images.iter().map(|image| Some((image.image()?, &image.data[..]))).collect();
        let inputs = inputs.ok_or_else(|| broken("what it is given is no image".to_owned()))?;
        if inputs.len() > self.inputs.len() {
            return Err(broken("it has fewer inputs than it is given".to_owned()));
        }
        self.running.run(&inputs, layers).map_err(broken)
    }
}
