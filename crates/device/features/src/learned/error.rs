//! Why a file of tensors cannot be used.

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
