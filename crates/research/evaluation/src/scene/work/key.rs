//! Hash of an evaluation's inputs: poses, files, behaviour of extractors.

use std::fs;
use std::path::{Path, PathBuf};

use veiloc_features::{Features, Image, load_gray};
use veiloc_geometry::CameraFromWorld;
use veiloc_mapping::build_cache::CacheKey;
use veiloc_mapping::image_file;

use super::io;
use crate::error::EvalError;
use crate::scene::SceneEvaluation;

/// Inputs that evaluations add to a hash.
pub(super) trait EvaluationKey {
    fn pose(&mut self, pose: Option<&CameraFromWorld>);

    /// The content of a file; a missing file has a hash of its own, and the stage that needs the file reports it.
    fn file(&mut self, path: &Path) -> Result<(), EvalError>;

    /// The output of the extractor and of the network of global descriptors for an image: their names do not identify
    /// their weights.
    fn behaviour(&mut self, evaluation: &SceneEvaluation) -> Result<(), EvalError>;

    fn features(&mut self, features: &Features);
}

impl EvaluationKey for CacheKey {
    fn pose(&mut self, pose: Option<&CameraFromWorld>) {
        self.debug(&pose.is_some());
        if let Some(pose) = pose {
            self.numbers(pose.rotation().matrix().iter().copied());
            self.numbers(pose.translation().iter().copied());
        }
    }

    fn file(&mut self, path: &Path) -> Result<(), EvalError> {
        match fs::read(path) {
            Ok(bytes) => self.bytes(&bytes),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => self.text("no such file"),
            Err(e) => return Err(io(path)(e)),
        }
        Ok(())
    }

    fn behaviour(&mut self, evaluation: &SceneEvaluation) -> Result<(), EvalError> {
        let of_scene = evaluation.map_list.iter().chain(&evaluation.query_list);
        let of_scene = of_scene.map(|name| image_file(&evaluation.images, name));
        let paths: Vec<PathBuf> =
            of_scene.chain(evaluation.negatives.iter().map(|image| image.path.clone())).collect();
        let Some(first) = paths.first() else { return Ok(()) };
        let extractor = evaluation.build.extractors.named(&evaluation.build.features);
        let extractor = extractor?;
        // An image that cannot be read is reported when the map is built.
        let Ok(gray) = load_gray(first) else { return Ok(()) };
        let image = Image::from(gray);
        match extractor.stored() {
            // Each stored global descriptor is hashed: one does not represent the others.
            Some(stored) => {
                for path in &paths {
                    let Ok(gray) = load_gray(path) else { continue };
                    if let Ok(features) = stored.features(path, (gray.width(), gray.height())) {
                        self.features(&features);
                    }
                }
            }
            None => self.features(&extractor.extract(&image, 64)?),
        }
        if let Some(global) = &evaluation.build.global {
            self.debug(&global.describe(&image)?.as_codes());
        }
        Ok(())
    }

    fn features(&mut self, features: &Features) {
        self.numbers(features.keypoints.iter().flat_map(|k| [k.pixel.u, k.pixel.v]));
        self.bytes(features.descriptors.as_bytes());
    }
}
