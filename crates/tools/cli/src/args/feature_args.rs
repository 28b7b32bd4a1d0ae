//! Which features, and where the network of learned ones is found.

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
use crate::commands::absent;
use crate::exit::Failure;

/// Folders of network files, as paths are listed in the environment.
const FOLDERS: &str = "VEILOC_MODELS";

/// The models that are known here, with files looked for where `VEILOC_MODELS` says.
pub(crate) fn models() -> Models {
    let folders = std::env::var_os(FOLDERS);
    Models::new(folders.map(|all| std::env::split_paths(&all).collect()).unwrap_or_default())
}

/// The network of learned features.
#[derive(clap::Args)]
pub(crate) struct ModelFileArgs {
    /// The network file of learned features. Default: the first of the model's files in a folder of the environment variable
    /// VEILOC_MODELS, or in its sub-folder of the model's name. `veiloc models` says which files and where they are got; nothing is
    /// downloaded.
    #[arg(long, value_name = "FILE")]
    model_file: Option<PathBuf>,
    /// What runs the network: rten, or onnxruntime, which is faster and a library that ORT_DYLIB_PATH names (only in a program that was
    /// built with `--features onnxruntime`). They round differently: use one for a map and its queries.
    #[arg(long, value_name = "ENGINE", default_value = Engine::default().name(), value_parser = engines())]
    engine: Engine,
    /// Take features from this file of hloc's (HDF5, by the images' names) instead of extracting them; --features says whose they are:
    /// a name that is known, or a new one. A map and its queries must be of features of one name. Default: features are extracted.
    #[arg(long, value_name = "FILE.h5", conflicts_with = "model_file")]
    features_file: Option<PathBuf>,
}

fn engines() -> impl TypedValueParser<Value = Engine> {
    PossibleValuesParser::new(Engine::ALL.map(Engine::name)).try_map(|name| name.parse::<Engine>())
}

impl ModelFileArgs {
    /// The models that are known here, run by the engine that is asked for.
    pub(crate) fn models(&self) -> Models {
        models().with_engine(self.engine)
    }

    fn open(&self, name: &str) -> Result<Arc<Learned>, FeatureError> {
        self.models().open(name, self.model_file.as_deref()).map(Arc::new)
    }

    /// The name of these features, and the extractors among which they are.
    ///
    /// # Errors
    /// An unknown model, no file for it, or one that cannot be used.
    pub(crate) fn extractors(&self, features: &str) -> Result<(String, Extractors), Failure> {
        if let Some(file) = &self.features_file {
            let stored = self.stored(file, features)?;
            return Ok((stored.kind().name().to_owned(), Extractors::default().with(stored)));
        }
        if Extractors::default().named(features).is_ok() {
            self.needs_no_file(features)?;
            return Ok((features.to_owned(), Extractors::default()));
        }
        let learned = self.open(features)?;
        Ok((learned.kind().name().to_owned(), Extractors::default().with(learned)))
    }

    /// Features of a file, of the kind of this name.
    #[cfg(feature = "hloc")]
    fn stored(&self, file: &Path, features: &str) -> Result<StoredFeatures, Failure> {
        let built_in = Extractors::default().named(features).map(|own| own.kind()).ok();
        let models = self.models();
        let described = || models.all().find(|found| found.description.name() == features);
        let known = built_in.or_else(|| described().map(|found| found.description.kind()));
        Ok(StoredFeatures::open(file, features, known)?)
    }

    #[cfg(not(feature = "hloc"))]
    #[expect(clippy::unused_self, reason = "as where there are such files")]
    fn stored(&self, file: &Path, _features: &str) -> Result<Arc<Learned>, Failure> {
        Err(absent::without(&format!("--features-file {}", file.display()), "hloc"))
    }

    fn needs_no_file(&self, features: &str) -> Result<(), Failure> {
        match &self.model_file {
            Some(file) => Err(Failure::with_help(
                format!("--model-file {} is given, and {features} has no network", file.display()),
                "leave it out, or say whose it is with --features",
            )),
            None => Ok(()),
        }
    }
}

/// What makes the features of images that no map is asked for.
#[derive(clap::Args)]
pub(crate) struct ImageFeatureArgs {
    /// What makes the features: compact, sift, the name of a model (`veiloc models`), or a .toml file that describes one.
    #[arg(long, default_value = Extractors::DEFAULT, value_name = "KIND|FILE")]
    features: String,
    #[command(flatten)]
    file: ModelFileArgs,
}

impl ImageFeatureArgs {
    /// One extractor.
    ///
    /// # Errors
    /// An unknown model, no file for it, or one that cannot be used.
    pub(crate) fn extractor(&self) -> Result<Arc<dyn Extractor>, Failure> {
        if let Some(file) = &self.file.features_file {
            return Ok(Arc::new(self.file.stored(file, &self.features)?));
        }
        if let Ok(built_in) = Extractors::default().shared(&self.features) {
            self.file.needs_no_file(&self.features)?;
            return Ok(built_in);
        }
        Ok(self.file.open(&self.features)?)
    }
}

/// What makes the features that a map asks for.
#[derive(clap::Args)]
pub(crate) struct MapFeatureArgs {
    /// What makes the features: sift, compact, the name of a model (`veiloc models`), or a .toml file that describes one. Default: the one of
    /// the name that the map asks for. Features of another kind than the map's are refused.
    #[arg(long, value_name = "KIND|FILE")]
    features: Option<String>,
    #[command(flatten)]
    file: ModelFileArgs,
}

impl MapFeatureArgs {
    /// The models that are known here, run by the engine that is asked for.
    pub(crate) fn models(&self) -> Models {
        self.file.models()
    }

    /// The built-in ones, and the model that a map asks for, if it asks for another.
    ///
    /// # Errors
    /// An unknown model, no file for it, one that cannot be used, or one of another kind than the map's.
    pub(crate) fn extractors(&self, profile: &Profile) -> Result<Extractors, Failure> {
        let asked = profile.descriptor_kind();
        let (name, extractors) = self.file.extractors(self.features.as_deref().unwrap_or(asked.name()))?;
        if extractors.of_kind(asked).is_err() || name != asked.name() {
            let own = extractors.named(&name)?.kind();
            let message =
                format!("the map is of features {asked:?}, and --features makes {own:?}: they never match");
            return Err(Failure::with_help(
                message,
                "leave --features out, or give the model the map was built with",
            ));
        }
        Ok(extractors)
    }
}
