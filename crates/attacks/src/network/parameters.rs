//! All numbers of a network in one list, in the order of its layers: drawn at the start, written to and read from files.

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::backend::Backend;
use burn::tensor::{Tensor, TensorData};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

use super::model::{Encoder, Shape};

/// A network with weights drawn evenly within `±√(6 / (inputs + outputs))` (Glorot), biases zero and norms neutral.
pub(super) fn drawn<B: Backend>(shape: &Shape, rng: &mut ChaCha8Rng, device: &B::Device) -> Encoder<B> {
    Encoder::zeros(shape, device).map(&mut Draw { rng })
}

/// All numbers, `[parameters]`.
pub(super) fn list<B: Backend>(encoder: &Encoder<B>) -> Vec<f32> {
    let mut values = List(Vec::new());
    encoder.visit(&mut values);
    values.0
}

/// A network with these numbers, as [`list`] gave them; `values` must hold `shape.parameters()` of them.
pub(super) fn filled<B: Backend>(shape: &Shape, values: &[f32], device: &B::Device) -> Encoder<B> {
    debug_assert_eq!(values.len() as u64, shape.parameters());
    Encoder::zeros(shape, device).map(&mut Fill { values })
}

struct Draw<'a> {
    rng: &'a mut ChaCha8Rng,
}

impl<B: Backend> ModuleMapper<B> for Draw<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<B, D>>) -> Param<Tensor<B, D>> {
        let (id, tensor, mapper) = param.consume();
        let shape = tensor.dims();
        let tensor = if D == 2 {
            let bound = (6.0 / shape.iter().sum::<usize>() as f32).sqrt();
            let values: Vec<f32> =
                (0..shape.iter().product::<usize>()).map(|_| self.rng.random_range(-bound..bound)).collect();
            replaced(tensor, values)
        } else {
            tensor
        };
        Param::from_mapped_value(id, tensor, mapper)
    }
}

struct List(Vec<f32>);

impl<B: Backend> ModuleVisitor<B> for List {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<B, D>>) {
        self.0.extend(param.val().into_data().iter::<f32>());
    }
}

struct Fill<'a> {
    values: &'a [f32],
}

impl<B: Backend> ModuleMapper<B> for Fill<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<B, D>>) -> Param<Tensor<B, D>> {
        let (id, tensor, mapper) = param.consume();
        let (own, rest) =
            self.values.split_at(tensor.dims().iter().product::<usize>().min(self.values.len()));
        self.values = rest;
        Param::from_mapped_value(id, replaced(tensor, own.to_vec()), mapper)
    }
}

/// A tensor of the same shape with other values, to be learned as the old one was.
fn replaced<B: Backend, const D: usize>(tensor: Tensor<B, D>, values: Vec<f32>) -> Tensor<B, D> {
    let learned = tensor.is_require_grad();
    let data = TensorData::new(values, tensor.dims());
    Tensor::from_data(data, &tensor.device()).set_require_grad(learned)
}

/// Gradients of all numbers, in the order of [`list`].
#[cfg(test)]
pub(super) fn slopes<B: burn::tensor::backend::AutodiffBackend>(
    encoder: &Encoder<B>,
    gradients: &B::Gradients,
) -> Vec<f32> {
    struct Slopes<'a, B: burn::tensor::backend::AutodiffBackend>(&'a B::Gradients, Vec<f32>);
    impl<B: burn::tensor::backend::AutodiffBackend> ModuleVisitor<B> for Slopes<'_, B> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<B, D>>) {
            let tensor = param.val();
            match tensor.grad(self.0) {
                Some(slope) => self.1.extend(slope.into_data().iter::<f32>()),
                None => self.1.extend(vec![f32::NAN; tensor.dims().iter().product()]),
            }
        }
    }
    let mut values = Slopes(gradients, Vec::new());
    encoder.visit(&mut values);
    values.1
}
