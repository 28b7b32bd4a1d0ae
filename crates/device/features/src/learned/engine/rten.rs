//! rten as an engine.
//!
//! Equal inputs give equal outputs, with any number of threads: rten divides rows and channels of a result between
//! threads, never a sum.

use std::sync::Arc;

use rten::{Dimension, Model, ModelOptions, NodeId, RunOptions, ThreadPool, ValueOrView};
use rten_tensor::TensorView;
use rten_tensor::prelude::*;

use super::run::{Input, Run};
use crate::learned::onnx::exact;
use crate::learned::{Layer, Tensor};

pub(super) struct Rten {
    model: Model,
    threads: Arc<ThreadPool>,
}

impl Rten {
    pub(super) fn load(onnx: Vec<u8>) -> Result<Self, String> {
        let model = ModelOptions::with_all_ops()
            .prepack_weights(true)
            .load(exact(&onnx).unwrap_or(onnx))
            .map_err(|error| error.to_string())?;
        let threads = Arc::new(ThreadPool::with_num_threads(rayon::current_num_threads()));
        Ok(Self { model, threads })
    }
}

impl Rten {
    fn name(&self, id: NodeId) -> String {
        let info = self.model.node_info(id);
        info.as_ref().and_then(|info| info.name()).unwrap_or_default().to_owned()
    }
}

impl Run for Rten {
    fn inputs(&self) -> Vec<Input> {
        let sides = |input| self.model.input_shape(input).unwrap_or_default().iter().map(fixed).collect();
        let of = |(at, id): (usize, &NodeId)| Input { name: self.name(*id), sides: sides(at) };
        self.model.input_ids().iter().enumerate().map(of).collect()
    }

    fn outputs(&self) -> Vec<String> {
        self.model.output_ids().iter().map(|id| self.name(*id)).collect()
    }

    fn metadata(&self, key: &str) -> Option<String> {
        self.model.metadata().get(key).map(str::to_owned)
    }

    fn run(&self, inputs: &[&Tensor], layers: &[Layer]) -> Result<Vec<Tensor>, String> {
        let inputs: Vec<(NodeId, ValueOrView<'_>)> = (self.model.input_ids().iter().zip(inputs))
            .map(|(id, tensor)| Ok((*id, view(tensor)?.into())))
            .collect::<Result<_, String>>()?;
        let of = |layer: &Layer| match layer {
            Layer::Output(number) => {
                let output = self.model.output_ids().get(*number).copied();
                output.ok_or_else(|| format!("it has no output {number}"))
            }
            Layer::Named(name) => self.model.node_id(name).map_err(|error| error.to_string()),
        };
        let outputs = layers.iter().map(of).collect::<Result<Vec<_>, _>>()?;
        let options = RunOptions::default().with_thread_pool(Some(Arc::clone(&self.threads)));
        // On a separate thread: a rayon thread would process other images while it waits for this one, and keep the
        // layers of all of them in memory.
        let run = || self.model.run(inputs, &outputs, Some(options));
        let results = match std::thread::scope(|scope| scope.spawn(run).join()) {
            Ok(results) => results.map_err(|error| error.to_string())?,
            Err(_) => return Err("it does not accept this input".to_owned()),
        };
        let tensor = |value: rten::Value| {
            let tensor: rten_tensor::Tensor<f32> =
                value.try_into().map_err(|_| "its output is not a table of numbers".to_owned())?;
            Ok(Tensor { shape: tensor.shape().to_vec(), data: tensor.into_data() })
        };
        results.into_iter().map(tensor).collect()
    }
}

fn fixed(dimension: &Dimension) -> Option<usize> {
    match dimension {
        Dimension::Fixed(size) => Some(*size),
        Dimension::Symbolic(_) => None,
    }
}

fn view(tensor: &Tensor) -> Result<TensorView<'_>, String> {
    TensorView::try_from_data(&tensor.shape[..], &tensor.data[..]).map_err(|error| error.to_string())
}
