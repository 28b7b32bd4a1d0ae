//! The known models, and where their files are.

use std::path::{Path, PathBuf};

use crate::Extractors;
use crate::FeatureError;

use crate::learned::built_in::{BUILT_IN, GLOBALS};
use crate::learned::{Description, Engine, GlobalDescription, Learned, LearnedGlobal};

/// Descriptions by name, and the search folders for files. Nothing is ever downloaded.
#[derive(Debug, Clone)]
pub struct Models {
    known: Vec<Description>,
    globals: Vec<GlobalDescription>,
    folders: Vec<PathBuf>,
    engine: Engine,
}

/// A model, and the path of its file.
#[derive(Debug, Clone)]
pub struct ModelFile<'a> {
    /// The description.
    pub description: &'a Description,
    /// Its file, if it exists.
    pub file: Option<PathBuf>,
}

/// A model of global descriptors, and the paths of its files.
#[derive(Debug, Clone)]
pub struct GlobalModelFiles<'a> {
    /// The description.
    pub description: &'a GlobalDescription,
    /// The file of each of its networks, if it exists.
    pub files: Vec<Option<PathBuf>>,
}

impl Models {
    /// The built-in ones, with files searched in these folders, in their order, and in each also in the sub-folder with
    /// the model's name.
    pub fn new(folders: Vec<PathBuf>) -> Self {
        let built_in = BUILT_IN.iter().map(|(file, text)| Description::parse(text, Path::new(file)));
        let globals = GLOBALS.iter().map(|(file, text)| GlobalDescription::parse(text, Path::new(file)));
        Self {
            known: built_in.map(|d| d.expect("a test reads all of them")).collect(),
            globals: globals.map(|d| d.expect("a test reads all of them")).collect(),
            folders,
            engine: Engine::default(),
        }
    }

    /// These models with another engine.
    #[must_use]
    pub fn with_engine(mut self, engine: Engine) -> Self {
        self.engine = engine;
        self
    }

    /// The search folders.
    pub fn folders(&self) -> &[PathBuf] {
        &self.folders
    }

    /// All of them, with their files.
    pub fn all(&self) -> impl Iterator<Item = ModelFile<'_>> {
        self.known.iter().map(|description| ModelFile { description, file: self.file_of(description, &[]) })
    }

    /// The names, separated by commas.
    pub fn names(&self) -> String {
        self.known.iter().map(Description::name).collect::<Vec<_>>().join(", ")
    }

    /// Whether there is a description of this name.
    pub fn knows(&self, name: &str) -> bool {
        self.known.iter().any(|description| description.name() == name)
    }

    /// Opens the model with this name, or the one of a description file (`….toml`).
    ///
    /// `file`: its network file; if `None`, it is searched beside the description and in the folders.
    ///
    /// # Errors
    /// [`FeatureError::UnknownFeatures`], [`FeatureError::NoModelFile`] with the searched folders and the source,
    /// [`FeatureError::Description`], and those of [`Learned::open`].
    pub fn open(&self, name: &str, file: Option<&Path>) -> Result<Learned, FeatureError> {
        let mut beside = Vec::new();
        let description = if is_description(name) {
            let text = read_beside(Path::new(name), &mut beside)?;
            Description::parse(&text, Path::new(name))?
        } else {
            let known = self.known.iter().find(|description| description.name() == name);
            let unknown = || FeatureError::UnknownFeatures {
                name: name.chars().take(80).collect(),
                known: format!("{}, {}", Extractors::default().names(), self.names()),
            };
            known.ok_or_else(unknown)?.clone()
        };
        let file = file.map(Path::to_owned).or_else(|| self.file_of(&description, &beside));
        let file = file.ok_or_else(|| self.no_file(&description, &beside))?;
        Learned::open(description, &file, self.engine)
    }

    /// All models of global descriptors, with their files.
    pub fn globals(&self) -> impl Iterator<Item = GlobalModelFiles<'_>> {
        self.globals.iter().map(|description| {
            let files = description.files().map(|files| self.found(description.name(), files, &[]));
            GlobalModelFiles { description, files: files.collect() }
        })
    }

    /// Opens the global descriptor with this name, or the one of a description file (`….toml`). Its files are searched
    /// beside the description and in the folders.
    ///
    /// # Errors
    /// [`FeatureError::UnknownGlobal`], [`FeatureError::NoGlobalFile`] with the searched folders and the source,
    /// [`FeatureError::Description`], and those of [`LearnedGlobal::open`].
    pub fn open_global(&self, name: &str) -> Result<LearnedGlobal, FeatureError> {
        let mut beside = Vec::new();
        let description = if is_description(name) {
            let text = read_beside(Path::new(name), &mut beside)?;
            GlobalDescription::parse(&text, Path::new(name))?
        } else {
            let known = self.globals.iter().find(|description| description.name() == name);
            let names = || self.globals.iter().map(GlobalDescription::name).collect::<Vec<_>>().join(", ");
            let unknown =
                || FeatureError::UnknownGlobal { name: name.chars().take(80).collect(), known: names() };
            known.ok_or_else(unknown)?.clone()
        };
        let files = description.files().map(|files| {
            let lacking = || FeatureError::NoGlobalFile {
                name: description.name().to_owned(),
                files: files.join(" or "),
                source_of: source_text(description.source(), description.licence(), description.export())
                    .into(),
                searched: self.searched(&beside).into(),
            };
            self.found(description.name(), files, &beside).ok_or_else(lacking)
        });
        let files = files.collect::<Result<Vec<_>, _>>()?;
        LearnedGlobal::open(description, &files, self.engine)
    }

    fn file_of(&self, description: &Description, beside: &[PathBuf]) -> Option<PathBuf> {
        self.found(description.name(), description.files(), beside)
    }

    /// The first of these files that exists: beside a description, in a folder, or in its sub-folder with the model's
    /// name or the file's prefix (`xfeat` for `xfeat_640x640.onnx`).
    fn found(&self, name: &str, files: &[String], beside: &[PathBuf]) -> Option<PathBuf> {
        files.iter().find_map(|file| {
            let own = file.split(['_', '.']).next().unwrap_or(file);
            let folders = beside.iter().cloned().chain(
                self.folders.iter().flat_map(|folder| [folder.clone(), folder.join(name), folder.join(own)]),
            );
            folders.map(|folder| folder.join(file)).find(|path| path.is_file())
        })
    }

    fn no_file(&self, description: &Description, beside: &[PathBuf]) -> FeatureError {
        FeatureError::NoModelFile {
            name: description.name().to_owned(),
            files: description.files().join(" or "),
            source_of: source_text(description.source(), description.licence(), description.export()).into(),
            searched: self.searched(beside).into(),
        }
    }

    fn searched(&self, beside: &[PathBuf]) -> String {
        let searched: Vec<String> =
            beside.iter().chain(&self.folders).map(|f| f.display().to_string()).collect();
        if searched.is_empty() { "no folder".to_owned() } else { searched.join(", ") }
    }
}

/// The source of a file, its licence, and the command that makes it.
fn source_text(source: &str, licence: &str, export: Option<&str>) -> String {
    let made = export.map_or_else(String::new, |export| format!(", run `{export}` on it"));
    format!("{source} ({licence}){made}")
}

fn is_description(name: &str) -> bool {
    Path::new(name).extension().is_some_and(|e| e.eq_ignore_ascii_case("toml"))
}

/// The text of a description; its folder is added to the search folders.
fn read_beside(path: &Path, beside: &mut Vec<PathBuf>) -> Result<String, FeatureError> {
    beside.push(path.parent().unwrap_or(Path::new("")).to_owned());
    std::fs::read_to_string(path).map_err(|source| FeatureError::Read { path: path.to_owned(), source })
}
