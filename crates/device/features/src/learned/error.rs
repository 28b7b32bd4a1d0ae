//! Why a network cannot be used.

use std::path::PathBuf;

use crate::ProjectionError;

/// Why there are no learned features.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// The file could not be read.
    #[error("cannot read {}: {source}; check the path and the permissions", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// The file is no network, is damaged, or is of another form than its description says.
    #[error("{}: this network cannot be used: {reason}", path.display())]
    Model {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A file of tensors that cannot be used.
    #[error("{}: these weights cannot be used: {source}", path.display())]
    Weights {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: WeightsError,
    },
    /// A file that a description names as the projection of its descriptors, and is not.
    #[error("{}: this projection cannot be used: {source}", path.display())]
    Projection {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: ProjectionError,
    },
    /// A description that says what cannot be.
    #[error("{}: this describes no model: {reason}", path.display())]
    Description {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// No model of this name is known.
    #[error(
        "no features of the name {name:?} are known; there are: {known}, or give the .toml file that describes a network"
    )]
    Unknown {
        /// What was asked for.
        name: String,
        /// The names of those there are.
        known: String,
    },
    /// The model is known, its file was not found.
    #[error(
        "the model {name} needs its file ({files}), which is not there; get it from {source_of} ({licence}) and name it with \
         --model-file, or put it into a folder that VEILOC_MODELS names; looked for in: {looked}"
    )]
    NoFile {
        /// The model.
        name: String,
        /// Names of files that would do.
        files: String,
        /// Where it is got.
        source_of: String,
        /// On what terms.
        licence: String,
        /// Folders, or that there are none.
        looked: String,
    },
    /// No engine of this name is known.
    #[error("no engine of the name {name:?} is known; there are: {known}")]
    Engine {
        /// What was asked for.
        name: String,
        /// The names of those there are.
        known: String,
    },
    /// No model of global descriptors has this name.
    #[error(
        "no global descriptor of the name {name:?} is known; there are: vlad, {known}, or give the .toml file that describes one"
    )]
    UnknownGlobal {
        /// What was asked for.
        name: String,
        /// The names of those there are.
        known: String,
    },
    /// The model of global descriptors is known, one of its files was not found.
    #[error(
        "the global descriptor {name} needs its file ({files}), which is not there; get it from {source_of} and put it into a \
         folder that VEILOC_MODELS names; looked for in: {looked}"
    )]
    NoGlobalFile {
        /// The model.
        name: String,
        /// Names of files that would do.
        files: String,
        /// Where it is got, and on what terms.
        source_of: String,
        /// Folders, or that there are none.
        looked: String,
    },
    /// The network broke on an image.
    #[error("the network could not run: {reason}")]
    Run {
        /// What it said.
        reason: String,
    },
}

/// What is wrong with a file of tensors.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum WeightsError {
    /// Neither a `.pth` nor a `.npz` nor a `.mat`.
    #[error("it is neither a PyTorch file nor a NumPy archive nor a MATLAB file of version 5")]
    Format,
    /// It ends before it is whole, or says that it is larger than it is.
    #[error("it is cut short or damaged: {0}")]
    Damaged(&'static str),
    /// Something other than tensors: it could do anything when Python loads it, and is not looked at further.
    #[error("it holds something other than tensors ({0}); save the state dictionary alone")]
    NotTensors(String),
    /// Packed or stored in a way that is not read here.
    #[error("{0} is not read; save it again with torch.save, numpy.savez or MATLAB's save -v7")]
    Unsupported(&'static str),
    /// A tensor that the network needs and the file lacks.
    #[error("it lacks the tensor {0}")]
    Missing(String),
    /// A tensor of another shape.
    #[error("its tensor {name} is {actual:?} and not {expected:?}")]
    Shape {
        /// The tensor.
        name: String,
        /// What the network takes.
        expected: Vec<usize>,
        /// What the file has.
        actual: Vec<usize>,
    },
    /// A number that is none.
    #[error("its tensor {0} has numbers that are none")]
    NotFinite(String),
}
