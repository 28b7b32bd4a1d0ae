//! A runnable network: an ONNX file in an engine.

use std::path::Path;

use crate::FeatureError;
use crate::learned::engine::{Engine, Input, Run};
use crate::learned::{Layer, Tensor};

/// Maximum size of an ONNX file, bytes.
const MAX_BYTES: u64 = 1 << 30;

/// A network in an engine. Its inputs are usually one or several images.
pub struct Network {
    engine: Engine,
    running: Box<dyn Run>,
    inputs: Vec<Input>,
    /// Names of its outputs.
    outputs: Vec<String>,
}

impl std::fmt::Debug for Network {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Network({}, {:?})", self.engine.name(), self.input())
    }
}

impl Network {
    /// Reads an ONNX file. It runs with as many threads as rayon has at this call.
    ///
    /// # Errors
    /// [`FeatureError::Read`], and [`FeatureError::Network`] for a file that is not a network or is damaged, or an
    /// unavailable engine.
    pub fn open(path: &Path, engine: Engine) -> Result<Self, FeatureError> {
        let bytes = crate::learned::file::read(path, MAX_BYTES)?;
        let refused = |reason| FeatureError::Network { path: path.to_owned(), reason };
        let running = engine.load(bytes).map_err(refused)?;
        Ok(Self { engine, inputs: running.inputs(), outputs: running.outputs(), running })
    }

    /// The engine.
    pub fn engine(&self) -> Engine {
        self.engine
    }

    /// Sides of the first input, `[N, C, H, W]` where it is an image; `None` for a side that is open.
    pub fn input(&self) -> &[Option<usize>] {
        self.sides_of(0)
    }

    /// The same for any of its inputs; empty if it does not exist.
    pub(crate) fn sides_of(&self, input: usize) -> &[Option<usize>] {
        self.inputs.get(input).map(|input| &input.sides[..]).unwrap_or_default()
    }

    /// The numbers of inputs and outputs.
    pub fn ends(&self) -> [usize; 2] {
        [self.inputs.len(), self.outputs.len()]
    }

    /// Sides of the input with this name, `None` for an open side; `None` if there is no such input.
    pub fn input_named(&self, name: &str) -> Option<&[Option<usize>]> {
        self.inputs.iter().find(|input| input.name == name).map(|input| &input.sides[..])
    }

    /// Names of its outputs, in the file's order.
    pub fn outputs(&self) -> &[String] {
        &self.outputs
    }

    /// The file's metadata under a key.
    pub fn metadata(&self, key: &str) -> Option<String> {
        self.running.metadata(key)
    }

    /// Runs it on an image `[1, C, H, W]`; returns the results of these layers, in their order.
    ///
    /// # Errors
    /// [`FeatureError::NetworkRun`].
    pub fn run(&self, image: &Tensor, layers: &[Layer]) -> Result<Vec<Tensor>, FeatureError> {
        self.run_on(&[image], layers)
    }

    /// The same for a network with several inputs, each `[1, C, H, W]`, in the file's order.
    pub(crate) fn run_on(&self, images: &[&Tensor], layers: &[Layer]) -> Result<Vec<Tensor>, FeatureError> {
        let broken = |reason: &str| FeatureError::NetworkRun { reason: reason.to_owned() };
        if images.iter().any(|image| image.image().is_none()) {
            return Err(broken("its input is not an image"));
        }
        if images.len() > self.inputs.len() {
            return Err(broken("it has fewer inputs than were given"));
        }
        self.running.run(images, layers).map_err(|reason| FeatureError::NetworkRun { reason })
    }

    /// Runs it on inputs of any shape, by their names; returns the results of these outputs, in their order.
    ///
    /// # Errors
    /// [`FeatureError::NetworkRun`], also for an unknown or missing input or output, and for wrong sides.
    pub fn run_named(
        &self,
        given: &[(&str, &Tensor)],
        outputs: &[&str],
    ) -> Result<Vec<Tensor>, FeatureError> {
        let broken = |reason: String| FeatureError::NetworkRun { reason };
        if let Some((name, _)) = given.iter().find(|(name, _)| self.input_named(name).is_none()) {
            return Err(broken(format!("it has no input {name}")));
        }
        if let Some(name) = outputs.iter().find(|name| self.outputs.iter().all(|own| own != *name)) {
            return Err(broken(format!("it has no output {name}")));
        }
        let of = |input: &Input| {
            let Input { name, sides } = input;
            let found = given.iter().find(|(own, _)| own == name);
            let (_, tensor) = found.ok_or_else(|| broken(format!("its input {name} is not given")))?;
            let alike = |(own, side): (&Option<usize>, &usize)| own.is_none_or(|own| own == *side);
            if sides.len() != tensor.shape.len() || !sides.iter().zip(&tensor.shape).all(alike) {
                return Err(broken(format!("its input {name} does not accept the sides {:?}", tensor.shape)));
            }
            Ok(*tensor)
        };
        let inputs = self.inputs.iter().map(of).collect::<Result<Vec<_>, _>>()?;
        let layers: Vec<Layer> = outputs.iter().map(|name| Layer::from(*name)).collect();
        self.running.run(&inputs, &layers).map_err(broken)
    }
}
