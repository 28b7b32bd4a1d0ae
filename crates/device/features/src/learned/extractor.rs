//! A described network as an extractor of local features.

use std::path::Path;

use crate::{Extractor, FeatureError, Features, Image, Keypoint};
use veiloc_descriptor::{DescriptorKind, Descriptors};
use veiloc_geometry::Pixel;

use crate::learned::head::Head;
use crate::learned::keypoints::{Peak, ScoreMap};
use crate::learned::prepare::prepare;
use crate::learned::sample::{DescriptorMap, bytes};
use crate::learned::{Description, Engine, Network, Tensor};

/// Learned local features: a description and its network.
///
/// Positions are those of the network, in the image's own pixels. A keypoint's scale is one pixel of the network's
/// input; it has no orientation. Descriptors are unit vectors in signed bytes, or projections of them. Only the order
/// of the network's scores is used, and it is removed when a query is sealed (rules L3 and L4 of docs/reference/privacy-rules.md).
pub struct Learned {
    description: Description,
    kind: DescriptorKind,
    /// The kind before projection.
    plain: DescriptorKind,
    network: Network,
    head: Option<Head>,
    /// Width and height, when the network has a fixed size.
    fixed: Option<[usize; 2]>,
}

impl std::fmt::Debug for Learned {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Learned({:?}, {:?})", self.kind, self.network)
    }
}

/// The output of a network for an image, for tests and numerical checks.
pub(crate) struct NetworkOutput {
    pub(crate) peaks: Vec<Peak>,
    /// `[N, numbers]`, of length 1.
    pub(crate) descriptors: Vec<f32>,
    /// Pixels of the image per pixel of the network's input.
    pub(crate) pixel: f64,
    /// Position of each peak; the corner of the image is at 0, 0.
    pub(crate) positions: Vec<[f64; 2]>,
}

impl Learned {
    /// Opens the network of a description from an ONNX file, and its head, if it has one, from the same folder.
    ///
    /// # Errors
    /// [`FeatureError`] for a file that is not a network, is damaged, or does not match the description.
    pub fn open(description: Description, file: &Path, engine: Engine) -> Result<Self, FeatureError> {
        let network = Network::open(file, engine)?;
        let refused = |reason: String| FeatureError::Network { path: file.to_owned(), reason };
        let channels = description.input.channels;
        let (Some(&[None | Some(1), own, height, width]), [1, _]) =
            (network.input().first_chunk::<4>(), network.ends())
        else {
            return Err(refused("its input is not one image".to_owned()));
        };
        if own.is_some_and(|own| own != channels) {
            return Err(refused(format!("its input has another number of channels than {channels}")));
        }
        let fixed = match (width, height) {
            (None, None) => None,
            (Some(width), Some(height)) if (64..=8192).contains(&width) && (64..=8192).contains(&height) => {
                Some([width, height])
            }
            _ => {
                return Err(refused(
                    "its input must have two fixed sides from 64 to 8192, or none".to_owned(),
                ));
            }
        };
        let head = description.descriptors.head.as_ref();
        let head = head.map(|name| Head::open(&file.with_file_name(name), engine)).transpose()?;
        let (kind, plain) = (description.kind(), description.plain_kind());
        Ok(Self { description, kind, plain, network, head, fixed })
    }

    /// The description.
    pub fn description(&self) -> &Description {
        &self.description
    }

    /// The network.
    pub fn network(&self) -> &Network {
        &self.network
    }

    pub(crate) fn run_network(&self, image: &Image, most: usize) -> Result<NetworkOutput, FeatureError> {
        let Description { input, scores, descriptors, .. } = &self.description;
        let (samples, placement) = prepare(image.gray(), input, self.fixed);
        let [_, _, height, width] = samples.shape[..] else { unreachable!("an image has four sides") };
        let mut layers = vec![scores.layer.clone()];
        layers.extend(scores.factor.clone());
        layers.push(descriptors.layer.clone());
        let mut results = self.network.run(&samples, &layers)?.into_iter();
        let mut next = || results.next().expect("one result for each layer");
        let map = ScoreMap::of(next(), scores)?;
        let factor = scores.factor.as_ref().map(|_| next());
        if [map.width, map.height] != [width, height] {
            let (w, h) = (map.width, map.height);
            let reason = format!("its scores have {w}x{h} pixels, but its input has {width}x{height}");
            return Err(FeatureError::NetworkRun { reason });
        }
        let factor_at = |pixel: [usize; 2]| {
            factor.as_ref().map_or(1.0, |factor| factor_at(factor, pixel, [width, height]))
        };
        let peaks = map.peaks(scores, placement, factor_at, most);
        let vectors = if let Some(head) = &self.head {
            head.descriptors(&next(), &peaks, descriptors.numbers)?
        } else {
            let mut vectors = vec![0.0; peaks.len() * descriptors.numbers];
            let of_peaks = peaks.iter().zip(vectors.chunks_exact_mut(descriptors.numbers));
            let map = DescriptorMap::of(next(), descriptors)?;
            of_peaks.for_each(|(peak, vector)| map.at(peak.position, [width, height], descriptors, vector));
            vectors
        };
        let positions = peaks.iter().map(|peak| placement.to_image(peak.position)).collect();
        Ok(NetworkOutput { peaks, descriptors: vectors, pixel: placement.pixel(), positions })
    }
}

/// The factor at a pixel, linearly interpolated between cells, as XFeat's program samples its reliability.
fn factor_at(factor: &Tensor, pixel: [usize; 2], size: [usize; 2]) -> f32 {
    let Some([_, rows, columns]) = factor.image() else { return 1.0 };
    let [x, y] = [(0, columns), (1, rows)].map(|(axis, cells)| {
        let at = pixel[axis] as f64 / (size[axis] as f64 - 1.0).max(1.0) * cells as f64 - 0.5;
        let first = at.floor();
        [(first, 1.0 - (at - first)), (first + 1.0, at - first)]
    });
    let mut sum = 0.0;
    for (row, down) in y {
        for (column, across) in x {
            if row >= 0.0 && column >= 0.0 && row < rows as f64 && column < columns as f64 {
                sum += (down * across) as f32 * factor.data[row as usize * columns + column as usize];
            }
        }
    }
    sum
}

impl Extractor for Learned {
    fn kind(&self) -> DescriptorKind {
        self.kind
    }

    fn extract(&self, image: &Image, max_keypoints: usize) -> Result<Features, FeatureError> {
        let broken = |reason: String| FeatureError::Extractor { name: self.kind.name().to_owned(), reason };
        let output = self.run_network(image, max_keypoints).map_err(|error| broken(error.to_string()))?;
        let keypoints = output.positions.iter().zip(&output.peaks).map(|([u, v], peak)| Keypoint {
            pixel: Pixel::new(*u, *v),
            scale: output.pixel as f32,
            orientation: 0.0,
            response: peak.score,
        });
        let vectors = bytes(&output.descriptors, self.plain).collect();
        let plain = Descriptors::new(self.plain, vectors).map_err(|error| broken(error.to_string()))?;
        let descriptors = match &self.description.read {
            Some(projection) => projection.apply(&plain),
            None => plain,
        };
        Ok(Features { keypoints: keypoints.collect(), descriptors, global: None })
    }

    /// 0: the image is continued by its mirror image, by the description's `margin`.
    fn support_radius(&self) -> f64 {
        0.0
    }

    fn receptive_field(&self) -> f64 {
        self.description.descriptors.receptive_field
    }
}
