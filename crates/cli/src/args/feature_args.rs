//! Selection of local features, and search for the network files of learned features.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use veiloc_features::FeatureError;
use veiloc_features::learned::{Engine, Learned, Models};
use veiloc_features::{Extractor, Extractors};
#[cfg(feature = "hloc")]
use veiloc_mapping::importers::hloc::StoredFeatures;
use veiloc_protocol::Profile;

#[cfg(not(feature = "hloc"))]
use crate::commands::missing_feature;
use crate::output::exit::Failure;

/// Environment variable that lists the folders of network files, in the form of `PATH`.
const FOLDERS: &str = "VEILOC_MODELS";

/// Returns the known models; their files are searched in the folders of `VEILOC_MODELS`.
pub(crate) fn models() -> Models {
    let folders = std::env::var_os(FOLDERS);
    Models::new(folders.map(|all| std::env::split_paths(&all).collect()).unwrap_or_default())
}

/// The network of learned features.
#[derive(clap::Args)]
pub(crate) struct ModelFileArgs {
    /// Network file of the learned features. Default: the first file of the model that exists in a folder of the
    /// environment variable VEILOC_MODELS or in its sub-folder with the model's name. `veiloc models` lists the files
    /// and their download pages; veiloc downloads nothing.
    #[arg(long, value_name = "FILE")]
    model_file: Option<PathBuf>,
    /// Inference engine: rten, or onnxruntime (faster; needs a build with `--features onnxruntime` and the library at
    /// ORT_DYLIB_PATH). The engines round differently: use the same one for a map and its queries.
    #[arg(long, value_name = "ENGINE", default_value = Engine::default().name(), value_parser = engines())]
    engine: Engine,
    /// Read features from this HDF5 file of hloc (keyed by image name) instead of extracting them; --features names
    /// their kind, which may be a known name or a new one. A map and its queries must use features of the same name.
    /// Default: features are extracted.
    #[arg(long, value_name = "FILE.h5", conflicts_with = "model_file")]
    features_file: Option<PathBuf>,
}

fn engines() -> impl TypedValueParser<Value = Engine> {
    PossibleValuesParser::new(Engine::ALL.map(Engine::name)).try_map(|name| name.parse::<Engine>())
}

impl ModelFileArgs {
    /// Returns the known models, run by the chosen engine.
    pub(crate) fn models(&self) -> Models {
        models().with_engine(self.engine)
    }

    fn open(&self, name: &str) -> Result<Arc<Learned>, FeatureError> {
        self.models().open(name, self.model_file.as_deref()).map(Arc::new)
    }

    /// Returns the name of the features and the extractors that include them.
    ///
    /// # Errors
    /// The model is unknown, has no file, or cannot be used.
    pub(crate) fn extractors(&self, features: &str) -> Result<(String, Extractors), Failure> {
        if let Some(file) = &self.features_file {
            let stored = self.stored(file, features)?;
            return Ok((stored.kind().name().to_owned(), Extractors::default().with(stored)));
        }
        if Extractors::default().named(features).is_ok() {
            self.refuse_model_file(features)?;
            return Ok((features.to_owned(), Extractors::default()));
        }
        let learned = self.open(features)?;
        Ok((learned.kind().name().to_owned(), Extractors::default().with(learned)))
    }

    /// Opens stored features of the kind with this name.
    #[cfg(feature = "hloc")]
    fn stored(&self, file: &Path, features: &str) -> Result<StoredFeatures, Failure> {
        let built_in = Extractors::default().named(features).map(|own| own.kind()).ok();
        let models = self.models();
        let described = || models.all().find(|found| found.description.name() == features);
        let known = built_in.or_else(|| described().map(|found| found.description.kind()));
        Ok(StoredFeatures::open(file, features, known)?)
    }

    #[cfg(not(feature = "hloc"))]
    #[expect(clippy::unused_self, reason = "same signature as with the feature")]
    fn stored(&self, file: &Path, _features: &str) -> Result<Arc<Learned>, Failure> {
        Err(missing_feature::error(&format!("--features-file {}", file.display()), "hloc"))
    }

    fn refuse_model_file(&self, features: &str) -> Result<(), Failure> {
        match &self.model_file {
            Some(file) => Err(Failure::with_help(
                format!("--model-file {} is given, and {features} has no network", file.display()),
                "leave it out, or name its features with --features",
            )),
            None => Ok(()),
        }
    }
}

/// Features for commands that need no map.
#[derive(clap::Args)]
pub(crate) struct ImageFeatureArgs {
    /// Local features: compact, sift, the name of a model (`veiloc models`), or a .toml file that describes a model.
    #[arg(long, default_value = Extractors::DEFAULT, value_name = "KIND|FILE")]
    features: String,
    #[command(flatten)]
    file: ModelFileArgs,
}

impl ImageFeatureArgs {
    /// Returns the extractor as a map uses it.
    ///
    /// # Errors
    /// The model is unknown, has no file, or cannot be used.
    #[cfg(feature = "hloc")]
    pub(crate) fn extractor(&self) -> Result<Arc<dyn Extractor>, Failure> {
        self.extractor_among(&Extractors::default())
    }

    /// Returns the extractor as a device uses it for sealing (rule L11).
    ///
    /// # Errors
    /// The model is unknown, has no file, or cannot be used.
    pub(crate) fn device_extractor(&self) -> Result<Arc<dyn Extractor>, Failure> {
        self.extractor_among(&Extractors::for_sealing())
    }

    fn extractor_among(&self, built_in: &Extractors) -> Result<Arc<dyn Extractor>, Failure> {
        if let Some(file) = &self.file.features_file {
            return Ok(Arc::new(self.file.stored(file, &self.features)?));
        }
        if let Ok(built_in) = built_in.shared(&self.features) {
            self.file.refuse_model_file(&self.features)?;
            return Ok(built_in);
        }
        Ok(self.file.open(&self.features)?)
    }
}

/// Features for a map that already names their kind.
#[derive(clap::Args)]
pub(crate) struct MapFeatureArgs {
    /// Local features: sift, compact, the name of a model (`veiloc models`), or a .toml file that describes a model.
    /// Default: the features that the map's profile names. Features of another kind than the map's are refused.
    #[arg(long, value_name = "KIND|FILE")]
    features: Option<String>,
    #[command(flatten)]
    file: ModelFileArgs,
}

impl MapFeatureArgs {
    /// Returns the known models, run by the chosen engine.
    pub(crate) fn models(&self) -> Models {
        self.file.models()
    }

    /// Returns the built-in extractors and the model that the profile names, if it is not built in.
    ///
    /// # Errors
    /// The model is unknown, has no file, cannot be used, or differs in kind from the map's features.
    pub(crate) fn extractors(&self, profile: &Profile) -> Result<Extractors, Failure> {
        let map_kind = profile.descriptor_kind();
        let (name, extractors) = self.file.extractors(self.features.as_deref().unwrap_or(map_kind.name()))?;
        if extractors.of_kind(map_kind).is_err() || name != map_kind.name() {
            let own = extractors.named(&name)?.kind();
            let message = format!(
                "the map has features {map_kind:?}, and --features gives {own:?}: these do not match"
            );
            return Err(Failure::with_help(
                message,
                "leave --features out, or give the model that the map was built with",
            ));
        }
        Ok(extractors)
    }
}
