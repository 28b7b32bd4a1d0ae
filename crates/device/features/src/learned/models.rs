//! The models that are known by name, and where their files are.

use std::path::{Path, PathBuf};

use crate::Extractors;
use crate::FeatureError;

use crate::learned::built_in::{BUILT_IN, GLOBALS};
use crate::learned::{Description, Engine, GlobalDescription, Learned, LearnedGlobal};

/// Descriptions by name, and folders to look for files in. Nothing is ever downloaded.
#[derive(Debug, Clone)]
pub struct Models {
    known: Vec<Description>,
    globals: Vec<GlobalDescription>,
    folders: Vec<PathBuf>,
    engine: Engine,
}

/// A model, and where its file is.
#[derive(Debug, Clone)]
pub struct Found<'a> {
    /// What it is.
    pub description: &'a Description,
    /// Its file, if it is there.
    pub file: Option<PathBuf>,
}

/// A model of global descriptors, and where its files are.
#[derive(Debug, Clone)]
pub struct FoundGlobal<'a> {
    /// What it is.
    pub description: &'a GlobalDescription,
    /// The file of each of its networks, if it is there.
    pub files: Vec<Option<PathBuf>>,
}

impl Models {
    /// The built-in ones, with files looked for in these folders, in their order, and in each in the sub-folder of the model's
    /// name too.
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

    /// The same, with networks run by this engine.
    #[must_use]
    pub fn with_engine(mut self, engine: Engine) -> Self {
        self.engine = engine;
        self
    }

    /// Where files are looked for.
    pub fn folders(&self) -> &[PathBuf] {
        &self.folders
    }

    /// All of them, with their files.
    pub fn all(&self) -> impl Iterator<Item = Found<'_>> {
        self.known.iter().map(|description| Found { description, file: self.file_of(description, &[]) })
    }

    /// The names, separated by commas.
    pub fn names(&self) -> String {
        self.known.iter().map(Description::name).collect::<Vec<_>>().join(", ")
    }

    /// Whether there is a description of this name.
    pub fn knows(&self, name: &str) -> bool {
        self.known.iter().any(|description| description.name() == name)
    }

    /// Opens the model of this name, or the one that a description file (`….toml`) is of.
    ///
    /// `file`: its network, where that is said; else it is looked for beside the description and in the folders.
    ///
    /// # Errors
    /// [`FeatureError::UnknownFeatures`], [`FeatureError::NoModelFile`] saying where it was looked for and where it is got,
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
    pub fn globals(&self) -> impl Iterator<Item = FoundGlobal<'_>> {
        self.globals.iter().map(|description| {
            let files = description.files().map(|files| self.found(description.name(), files, &[]));
            FoundGlobal { description, files: files.collect() }
        })
    }

    /// Opens the global descriptor of this name, or the one that a description file (`….toml`) is of. Its files are looked for
    /// beside the description and in the folders.
    ///
    /// # Errors
    /// [`FeatureError::UnknownGlobal`], [`FeatureError::NoGlobalFile`] saying where it was looked for and where it is got,
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
                source_of: got(description.source(), description.licence(), description.export()).into(),
                looked: self.looked(&beside).into(),
            };
            self.found(description.name(), files, &beside).ok_or_else(lacking)
        });
        let files = files.collect::<Result<Vec<_>, _>>()?;
        LearnedGlobal::open(description, &files, self.engine)
    }

    fn file_of(&self, description: &Description, beside: &[PathBuf]) -> Option<PathBuf> {
        self.found(description.name(), description.files(), beside)
    }

    /// The first of these files that is there: beside a description, in a folder, or in its sub-folder of the model's name or of
    /// the file's own (`xfeat` for `xfeat_640x640.onnx`).
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
            source_of: got(description.source(), description.licence(), description.export()).into(),
            looked: self.looked(beside).into(),
        }
    }

    fn looked(&self, beside: &[PathBuf]) -> String {
        let looked: Vec<String> =
            beside.iter().chain(&self.folders).map(|f| f.display().to_string()).collect();
        if looked.is_empty() { "no folder".to_owned() } else { looked.join(", ") }
    }
}

/// Where a file is got, on what terms, and what makes it of what is got there.
fn got(source: &str, licence: &str, export: Option<&str>) -> String {
    let made = export.map_or_else(String::new, |export| format!(", run `{export}` on it"));
    format!("{source} ({licence}){made}")
}

fn is_description(name: &str) -> bool {
    Path::new(name).extension().is_some_and(|e| e.eq_ignore_ascii_case("toml"))
}

/// The text of a description; its folder is one to look for files in.
fn read_beside(path: &Path, beside: &mut Vec<PathBuf>) -> Result<String, FeatureError> {
    beside.push(path.parent().unwrap_or(Path::new("")).to_owned());
    std::fs::read_to_string(path).map_err(|source| FeatureError::Read { path: path.to_owned(), source })
}
