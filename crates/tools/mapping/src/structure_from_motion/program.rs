//! Finds the program of structure from motion, and runs COLMAP.

use std::fmt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use veiloc_features::Progress;

use super::state::{Causes, Task};
use crate::error::MappingError;
use crate::python::tail;

/// How the program of structure from motion is installed; Debian and Ubuntu refuse it outside of a virtual environment.
pub const INSTALL: &str =
    "python3 -m pip install pycolmap, in a virtual environment whose Python --python names";

/// A program of structure from motion.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SfmProgram {
    /// pycolmap.
    Pycolmap {
        /// The Python that has it.
        python: PathBuf,
        /// Its version.
        version: String,
    },
    /// The program `colmap`.
    Colmap {
        /// Its file.
        path: PathBuf,
    },
}

impl fmt::Display for SfmProgram {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Pycolmap { python, version } => write!(f, "pycolmap {version} of {}", python.display()),
            Self::Colmap { path } => write!(f, "{}", path.display()),
        }
    }
}

impl SfmProgram {
    /// pycolmap of the given Python; without one that of `python3` of the PATH, or else `colmap` of the PATH.
    ///
    /// # Errors
    /// [`MappingError::NoSfmProgram`], which names the command that brings pycolmap.
    pub fn find(python: Option<&Path>) -> Result<Self, MappingError> {
        let searched = python.map_or_else(|| PathBuf::from("python3"), Path::to_owned);
        if let Some(version) = version_of_pycolmap(&searched) {
            return Ok(Self::Pycolmap { python: searched, version });
        }
        let colmap = PathBuf::from("colmap");
        if python.is_none() && Command::new(&colmap).arg("help").output().is_ok() {
            return Ok(Self::Colmap { path: colmap });
        }
        Err(MappingError::NoSfmProgram { python: searched, is_given: python.is_some(), install: INSTALL })
    }
}

fn version_of_pycolmap(python: &Path) -> Option<String> {
    let script = "import pycolmap; print(pycolmap.__version__)";
    let output = Command::new(python).args(["-c", script]).output().ok()?;
    let version = String::from_utf8_lossy(&output.stdout).trim().to_owned();
    (output.status.success() && !version.is_empty()).then_some(version)
}

/// Runs the steps of the program `colmap`.
pub(super) fn run_colmap(path: &Path, task: &Task, progress: &dyn Progress) -> Result<Causes, MappingError> {
    let run = |arguments: &[&str]| -> Result<Output, MappingError> {
        Command::new(path).args(arguments).output().map_err(MappingError::io(path))
    };
    let step = |name: &str, arguments: &[&str]| -> Result<(), MappingError> {
        progress.start(name, 1);
        let output = run(arguments)?;
        progress.advance(1);
        progress.finish();
        if output.status.success() {
            return Ok(());
        }
        let log = String::from_utf8_lossy(&output.stderr);
        let step = arguments.first().copied().unwrap_or_default();
        let reason = format!("{} {step} failed ({}): {}", path.display(), output.status, tail(&log));
        Err(MappingError::Sfm { reason })
    };
    if task.images.panoramas > 0 {
        let reason =
            format!("panoramas need pycolmap, and only {} is there; install it: {INSTALL}", path.display());
        return Err(MappingError::Sfm { reason });
    }
    let (database, images, sparse) = (task.database(), task.folder.clone(), task.sparse());
    let [database, images, sparse] =
        [&database, &images, &sparse].map(|path| path.to_string_lossy().into_owned());
    // Without CUDA, SIFT on the graphics card needs a screen. The names of the options changed with version 3.12.
    let without_cuda = String::from_utf8_lossy(&run(&["help"])?.stdout).contains("without CUDA");
    let help = run(&["feature_extractor", "--help"])?;
    let help = String::from_utf8_lossy(&help.stdout).into_owned() + &String::from_utf8_lossy(&help.stderr);
    let is_new = help.contains("FeatureExtraction.use_gpu");
    let on_cpu = |option: &'static str| if without_cuda { vec![option, "0"] } else { Vec::new() };
    let list = task.sparse().with_file_name("names.txt");
    for of_camera in &task.images.cameras {
        let names: String = of_camera.names.iter().flat_map(|name| [name.as_str(), "\n"]).collect();
        std::fs::write(&list, names).map_err(MappingError::io(&list))?;
        let list = list.to_string_lossy();
        let mut extract = vec!["feature_extractor", "--database_path", &database, "--image_path", &images];
        extract.extend(["--image_list_path", &list, "--ImageReader.single_camera", "1"]);
        extract.extend(on_cpu(if is_new {
            "--FeatureExtraction.use_gpu"
        } else {
            "--SiftExtraction.use_gpu"
        }));
        step("features of structure from motion", &extract)?;
    }
    let matcher = if task.is_sequential { "sequential_matcher" } else { "exhaustive_matcher" };
    let mut pairs = vec![matcher, "--database_path", &database];
    pairs.extend(on_cpu(if is_new { "--FeatureMatching.use_gpu" } else { "--SiftMatching.use_gpu" }));
    step("matches of structure from motion", &pairs)?;
    let smallest = task.min_model_size().to_string();
    let mut mapper = vec!["mapper", "--database_path", &database, "--image_path", &images];
    mapper.extend(["--output_path", &sparse, "--Mapper.min_model_size", &smallest]);
    step("camera poses", &mapper)?;
    Ok(Causes::new())
}
