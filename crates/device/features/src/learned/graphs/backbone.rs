//! Networks whose layers images are compared by: AlexNet and VGG16 as torchvision has them, and SuperPoint's encoder.

use crate::FeatureError;
use crate::learned::onnx::Graph;
use crate::learned::{Engine, Layer, Network, Tensor, Weights, WeightsError};

/// A layer of AlexNet or VGG16.
enum Part {
    /// Number among torchvision's `features`, channels in and out, side of the kernel, zeros on each side, stride; rectified. The
    /// last says whether images are compared by it.
    Convolution(u64, [usize; 3], [u64; 2], bool),
    /// Side and stride.
    Pool([u64; 2]),
}

use Part::{Convolution, Pool};

/// Krizhevsky, *One weird trick for parallelizing convolutional neural networks*, 2014, in torchvision's form.
const ALEXNET: [Part; 7] = [
    Convolution(0, [3, 64, 11], [2, 4], true),
    Pool([3, 2]),
    Convolution(3, [64, 192, 5], [2, 1], true),
    Pool([3, 2]),
    Convolution(6, [192, 384, 3], [1, 1], true),
    Convolution(8, [384, 256, 3], [1, 1], true),
    Convolution(10, [256, 256, 3], [1, 1], true),
];

/// Simonyan and Zisserman, *Very Deep Convolutional Networks*, ICLR 2015, configuration D.
const VGG16: [Part; 17] = [
    Convolution(0, [3, 64, 3], [1, 1], false),
    Convolution(2, [64, 64, 3], [1, 1], true),
    Pool([2, 2]),
    Convolution(5, [64, 128, 3], [1, 1], false),
    Convolution(7, [128, 128, 3], [1, 1], true),
    Pool([2, 2]),
    Convolution(10, [128, 256, 3], [1, 1], false),
    Convolution(12, [256, 256, 3], [1, 1], false),
    Convolution(14, [256, 256, 3], [1, 1], true),
    Pool([2, 2]),
    Convolution(17, [256, 512, 3], [1, 1], false),
    Convolution(19, [512, 512, 3], [1, 1], false),
    Convolution(21, [512, 512, 3], [1, 1], true),
    Pool([2, 2]),
    Convolution(24, [512, 512, 3], [1, 1], false),
    Convolution(26, [512, 512, 3], [1, 1], false),
    Convolution(28, [512, 512, 3], [1, 1], true),
];

/// A network of which several layers are looked at.
#[derive(Debug)]
pub struct Backbone {
    network: Network,
    layers: Vec<Layer>,
    channels: Vec<usize>,
}

impl Backbone {
    /// AlexNet; five layers, `features.{0,3,6,8,10}` of torchvision's file, rectified.
    ///
    /// # Errors
    /// [`WeightsError`] for weights of another network.
    pub fn alexnet(weights: &Weights) -> Result<Self, WeightsError> {
        Self::of_parts(&ALEXNET, weights)
    }

    /// VGG16; five layers, the last before each pool and the last of all, rectified.
    ///
    /// # Errors
    /// As [`Self::alexnet`].
    pub fn vgg16(weights: &Weights) -> Result<Self, WeightsError> {
        Self::of_parts(&VGG16, weights)
    }

    /// SuperPoint's encoder, for gray images; four layers, the last before each pool and the last of all, rectified. The file
    /// may lack the heads.
    ///
    /// # Errors
    /// As [`Self::alexnet`].
    pub fn superpoint(weights: &Weights) -> Result<Self, WeightsError> {
        let mut graph = Graph::default();
        super::superpoint::encoder(&mut graph, weights)?;
        let layers = [("conv1b", 64), ("conv2b", 64), ("conv3b", 128), ("conv4b", 128)];
        let named = layers.iter().map(|(name, channels)| (format!("{name}.relu"), *channels)).collect();
        Self::made(graph, 1, named)
    }

    fn of_parts(parts: &[Part], weights: &Weights) -> Result<Self, WeightsError> {
        let mut graph = Graph::default();
        let mut last = Graph::INPUT.to_owned();
        let mut named = Vec::new();
        for (at, part) in parts.iter().enumerate() {
            match part {
                Convolution(number, [from, to, side], how, looked_at) => {
                    let kernel =
                        weights.get(&format!("features.{number}.weight"), &[*to, *from, *side, *side])?;
                    let bias = weights.get(&format!("features.{number}.bias"), &[*to])?;
                    let name = format!("features.{number}");
                    graph.strided(&name, &last, kernel, Some(bias), *how);
                    last = format!("{name}.relu");
                    graph.relu(&last, &name);
                    if *looked_at {
                        named.push((last.clone(), *to));
                    }
                }
                Pool(how) => {
                    let name = format!("pool.{at}");
                    graph.overlapping_pool(&name, &last, *how);
                    last = name;
                }
            }
        }
        Self::made(graph, 3, named)
    }

    fn made(mut graph: Graph, inputs: usize, named: Vec<(String, usize)>) -> Result<Self, WeightsError> {
        for (name, channels) in &named {
            graph.output(name, *channels);
        }
        let network =
            Network::of_onnx(graph.model(inputs), Engine::default()).map_err(WeightsError::NotTensors)?;
        let (names, channels): (Vec<_>, Vec<_>) = named.into_iter().unzip();
        Ok(Self { network, layers: names.into_iter().map(Layer::Named).collect(), channels })
    }

    /// Channels of each layer that is looked at.
    pub fn channels(&self) -> &[usize] {
        &self.channels
    }

    /// These layers of an image `[1, C, H, W]`, each `[1, channels, h, w]`.
    ///
    /// # Errors
    /// [`FeatureError::NetworkRun`] for an image of other channels, or so small that nothing is left of it.
    pub fn layers(&self, image: &Tensor) -> Result<Vec<Tensor>, FeatureError> {
        self.network.run(image, &self.layers)
    }
}
