//! A detector file, and its detections.

use std::path::{Path, PathBuf};

use crate::ColourImage;
use crate::FeatureError;
use crate::learned::{Engine, Layer, Network, Tensor};

use crate::detector::boxes::{Detection, suppress_overlaps};
use crate::detector::classes;
use crate::detector::letterbox::letterbox;

/// Boxes of one class that overlap by more than this belong to one object.
const SAME: f32 = 0.5;

/// A detector read from a file.
///
/// ONNX with one input `[1, 3, H, W]` of fixed size, red, green and blue from 0 to 1, and one output `[1, 4 + C, N]`:
/// for each of `N` boxes its centre, width and height in pixels of the input, and the scores of `C` classes, whose
/// names are in the file's metadata under `names`. YOLO 8 to 11 export this format; quantized networks (int8) work as
/// well.
pub struct Detector {
    network: Network,
    /// Width and height of the input.
    size: [usize; 2],
    names: Vec<String>,
}

impl std::fmt::Debug for Detector {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Detector({} classes, {:?})", self.names.len(), self.size)
    }
}

impl Detector {
    /// Reads a detector.
    ///
    /// # Errors
    /// [`FeatureError::ReadDetector`], and [`FeatureError::Detector`] for a file that is damaged or of another format.
    pub fn open(path: &Path) -> Result<Self, FeatureError> {
        let unusable = |reason: String| FeatureError::Detector { path: PathBuf::from(path), reason };
        let network = Network::open(path, Engine::default()).map_err(|error| match error {
            FeatureError::Read { path, source } => FeatureError::ReadDetector { path, source },
            FeatureError::Network { reason, .. } => unusable(reason),
            other => unusable(other.to_string()),
        })?;
        let names = network.metadata("names").as_deref().and_then(classes::parse);
        let names =
            names.ok_or_else(|| unusable("it does not contain the names of its classes".to_owned()))?;
        if network.ends() != [1, 1] {
            return Err(unusable("it has more than one input or output".to_owned()));
        }
        let &[Some(1), Some(3), Some(height), Some(width)] = network.input() else {
            return Err(unusable("its input is not one colour image of a fixed size".to_owned()));
        };
        if !(32..=4096).contains(&height) || !(32..=4096).contains(&width) {
            return Err(unusable(format!("its input of {width}x{height} pixels is not from 32 to 4096")));
        }
        Ok(Self { network, size: [width, height], names })
    }

    /// The class names, by index.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// All detections with at least this score, one box per object, by falling score.
    ///
    /// # Errors
    /// [`FeatureError::DetectorRun`] when the network cannot run, or its output does not match its classes.
    pub fn detect(&self, image: &ColourImage, least_score: f32) -> Result<Vec<Detection>, FeatureError> {
        Ok(suppress_overlaps(self.candidates(image, least_score)?, SAME))
    }

    /// All boxes with at least this score, without suppression.
    pub(crate) fn candidates(
        &self,
        image: &ColourImage,
        least_score: f32,
    ) -> Result<Vec<Detection>, FeatureError> {
        let broken = |reason: String| FeatureError::DetectorRun { reason };
        let [width, height] = self.size;
        let (samples, placement) = letterbox(image, self.size);
        let input = Tensor { shape: vec![1, 3, height, width], data: samples };
        let outputs = self.network.run(&input, &[Layer::Output(0)]).map_err(|error| match error {
            FeatureError::NetworkRun { reason } => broken(reason),
            other => broken(other.to_string()),
        })?;
        let Some((&[images, columns, boxes], numbers)) = outputs
            .first()
            .and_then(|table| Some((<&[usize; 3]>::try_from(&table.shape[..]).ok()?, &table.data)))
        else {
            return Err(broken("its output is not a table".to_owned()));
        };
        if images != 1 || columns != 4 + self.names.len() {
            let expected = 4 + self.names.len();
            return Err(broken(format!("its output has {columns} numbers per box instead of {expected}")));
        }
        let mut found = Vec::new();
        for at in 0..boxes {
            let number = |column: usize| numbers[column * boxes + at];
            let scores = (0..self.names.len()).map(|class| (class, number(4 + class)));
            let Some((class, score)) = scores.max_by(|a, b| a.1.total_cmp(&b.1)) else { continue };
            let [x, y, half_width, half_height] = [number(0), number(1), number(2) / 2.0, number(3) / 2.0];
            let is_box = [x, y, half_width, half_height, score].iter().all(|v| v.is_finite());
            if !is_box {
                return Err(broken("its output contains NaN or infinity".to_owned()));
            }
            if score >= least_score {
                let [left, upper] = placement.to_file([x - half_width, y - half_height]);
                let [right, lower] = placement.to_file([x + half_width, y + half_height]);
                found.push(Detection { class, score, corners: [left, upper, right, lower] });
            }
        }
        Ok(found)
    }
}
