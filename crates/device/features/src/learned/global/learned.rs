//! Described networks as an extractor of global descriptors.

use std::path::PathBuf;

use crate::{FeatureError, GlobalExtractor, GrayImage, Image};
use veiloc_descriptor::{GlobalDescriptor, NamedGlobal};

use super::GlobalDescription;
use super::description::{ImageInput, InputSource, NetworkPart};
use crate::learned::prepare::{prepare, resized};
use crate::learned::{Engine, Network, Tensor};

/// Factor on the root of the dimension: a byte covers 4 standard deviations of a component in a random direction.
const LENGTH: f64 = 32.0;

/// A learned global descriptor: a description and its networks.
///
/// Its codes are a unit vector times 32 √numbers in bytes. It is computed from the gray image at the networks' size,
/// including its border. Rule L14 of docs/reference/privacy-rules.md limits what is sent of it.
pub struct LearnedGlobal {
    description: GlobalDescription,
    model: NamedGlobal,
    networks: Vec<Network>,
}

impl std::fmt::Debug for LearnedGlobal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "LearnedGlobal({:?}, {:?})", self.model, self.networks)
    }
}

impl LearnedGlobal {
    /// Opens the networks of a description from these files, one each.
    ///
    /// # Errors
    /// [`FeatureError`] for a file that is not a network, is damaged, or does not match the description.
    pub fn open(
        description: GlobalDescription,
        files: &[PathBuf],
        engine: Engine,
    ) -> Result<Self, FeatureError> {
        let count = description.networks.len();
        if files.len() != count {
            let reason = format!("{} files were given for {count} networks", files.len());
            return Err(FeatureError::Network { path: files.first().cloned().unwrap_or_default(), reason });
        }
        let networks = files.iter().map(|file| Network::open(file, engine)).collect::<Result<_, _>>()?;
        let all = Self { model: description.model(), description, networks };
        all.check(files)?;
        Ok(all)
    }

    /// The description.
    pub fn description(&self) -> &GlobalDescription {
        &self.description
    }

    /// Its networks, in execution order.
    pub fn networks(&self) -> &[Network] {
        &self.networks
    }

    fn check(&self, files: &[PathBuf]) -> Result<(), FeatureError> {
        let parts = self.description.networks.iter().zip(&self.networks).zip(files).enumerate();
        for (at, ((part, network), file)) in parts {
            let refused = |reason: String| Err(FeatureError::Network { path: file.clone(), reason });
            let (expected, actual) = (part.inputs(at == 0).len(), network.ends()[0]);
            if expected != actual {
                return refused(format!("it has {actual} inputs instead of {expected}"));
            }
            for input in 0..actual {
                if !matches!(network.sides_of(input), [None | Some(1), _, _, _]) {
                    return refused(format!("its input {input} is not one image"));
                }
            }
        }
        Ok(())
    }

    /// The vector of an image, of length 1; all zeros if the networks return zeros. `[numbers]`
    ///
    /// # Errors
    /// [`FeatureError::NetworkRun`].
    pub fn vector(&self, image: &GrayImage) -> Result<Vec<f32>, FeatureError> {
        let mut before = None;
        for (at, (part, network)) in self.description.networks.iter().zip(&self.networks).enumerate() {
            before = Some(step(part, network, at == 0, image, before)?);
        }
        let last = before.map(|tensor| tensor.data).unwrap_or_default();
        if last.len() != self.model.dim() || last.iter().any(|number| !number.is_finite()) {
            let reason = format!("its vector does not have {} numbers", self.model.dim());
            return Err(FeatureError::NetworkRun { reason });
        }
        let length = last.iter().map(|number| f64::from(*number).powi(2)).sum::<f64>().sqrt();
        let factor = if length > 0.0 { 1.0 / length } else { 0.0 };
        Ok(last.iter().map(|number| (f64::from(*number) * factor) as f32).collect())
    }
}

/// The result of a network, from the image and the result of the previous network.
fn step(
    part: &NetworkPart,
    network: &Network,
    is_first: bool,
    image: &GrayImage,
    before: Option<Tensor>,
) -> Result<Tensor, FeatureError> {
    let broken = |reason: &str| FeatureError::NetworkRun { reason: reason.to_owned() };
    let seen = match &part.image {
        Some(seen) => {
            let input =
                part.inputs(is_first).iter().position(|from| *from == InputSource::Image).unwrap_or(0);
            Some(image_input(image, seen, network.sides_of(input)))
        }
        None => None,
    };
    let given = part.inputs(is_first).iter().map(|from| match from {
        InputSource::Image => seen.as_ref().ok_or_else(|| broken("it has no image")),
        InputSource::Before => before.as_ref().ok_or_else(|| broken("there is no previous network")),
    });
    let given: Vec<&Tensor> = given.collect::<Result<_, _>>()?;
    let result = network.run_on(&given, std::slice::from_ref(&part.layer))?.pop();
    let mut result = result.ok_or_else(|| broken("it has no result"))?;
    if part.channels_last {
        result = result.channels_first().ok_or_else(|| broken("its result is not an image"))?;
    }
    match part.middle {
        Some(sides) => middle(&result, sides).ok_or_else(|| broken("its result is too small")),
        None => Ok(result),
    }
}

/// The image input of a network.
fn image_input(image: &GrayImage, seen: &ImageInput, sides: &[Option<usize>]) -> Tensor {
    let fixed = match sides {
        [_, _, Some(height), Some(width)] => Some([*width, *height]),
        _ => None,
    };
    let made = seen.size.map(|[width, height]| {
        let samples = resized(image, [width as usize, height as usize]);
        GrayImage::new(width, height, samples).expect("as many samples as pixels")
    });
    prepare(made.as_ref().unwrap_or(image), &seen.input(), fixed).0
}

/// The middle columns and rows of `[1, C, H, W]`.
fn middle(tensor: &Tensor, [columns, rows]: [usize; 2]) -> Option<Tensor> {
    let [channels, height, width] = tensor.image()?;
    let (left, upper) = (width.checked_sub(columns)? / 2, height.checked_sub(rows)? / 2);
    let mut data = Vec::with_capacity(channels * rows * columns);
    for plane in tensor.data.chunks_exact(height * width) {
        for row in plane.chunks_exact(width).skip(upper).take(rows) {
            data.extend_from_slice(&row[left..left + columns]);
        }
    }
    Some(Tensor { shape: vec![1, channels, rows, columns], data })
}

impl GlobalExtractor for LearnedGlobal {
    fn model(&self) -> NamedGlobal {
        self.model
    }

    fn describe(&self, image: &Image) -> Result<GlobalDescriptor, FeatureError> {
        let broken = |error: FeatureError| FeatureError::Extractor {
            name: self.model.name().to_owned(),
            reason: error.to_string(),
        };
        let vector = self.vector(image.gray()).map_err(broken)?;
        let length = LENGTH * (self.model.dim() as f64).sqrt();
        let code = |number: &f32| (f64::from(*number) * length).round().clamp(-127.0, 127.0) as i8;
        Ok(GlobalDescriptor::new(vector.iter().map(code).collect()))
    }
}
