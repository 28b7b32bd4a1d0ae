//! Engines for networks: rten, which is part of the program, or the user's ONNX Runtime, which is faster. Each is a
//! cargo feature.

#[cfg(feature = "onnxruntime")]
mod onnxruntime;
#[cfg(feature = "rten")]
mod rten;
mod run;

use std::str::FromStr;

use crate::FeatureError;
pub(crate) use run::{Input, Run};

/// An engine for networks. Engines round differently: a device and its map should use the same one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Engine {
    /// rten: pure Rust, part of the program. Results do not depend on the number of threads. Requires the cargo feature
    /// `rten`.
    #[default]
    Rten,
    /// ONNX Runtime, a library named by the environment variable `ORT_DYLIB_PATH`. Requires the cargo feature
    /// `onnxruntime`.
    OnnxRuntime,
}

impl Engine {
    /// All engines, whether this program includes them or not.
    pub const ALL: [Self; 2] = [Self::Rten, Self::OnnxRuntime];

    /// The name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rten => "rten",
            Self::OnnxRuntime => "onnxruntime",
        }
    }

    /// Reads an ONNX model; the error describes the problem with the model or the engine.
    #[cfg_attr(
        not(any(feature = "rten", feature = "onnxruntime")),
        expect(unused_variables, reason = "no engine reads it")
    )]
    pub(crate) fn load(self, onnx: Vec<u8>) -> Result<Box<dyn Run>, String> {
        match self {
            #[cfg(feature = "rten")]
            Self::Rten => Ok(Box::new(rten::Rten::load(onnx)?)),
            #[cfg(not(feature = "rten"))]
            Self::Rten => Err(absent("networks (rten)", "networks")),
            #[cfg(feature = "onnxruntime")]
            Self::OnnxRuntime => Ok(Box::new(onnxruntime::OnnxRuntime::load(onnx)?)),
            #[cfg(not(feature = "onnxruntime"))]
            Self::OnnxRuntime => Err(absent("ONNX Runtime", "onnxruntime")),
        }
    }
}

/// The error for an engine that is not included.
#[cfg(not(all(feature = "rten", feature = "onnxruntime")))]
fn absent(engine: &str, feature: &str) -> String {
    format!("this program was built without {engine}; build it with `--features {feature}`")
}

impl FromStr for Engine {
    type Err = FeatureError;

    fn from_str(name: &str) -> Result<Self, FeatureError> {
        let known = || Self::ALL.map(Self::name).join(", ");
        let unknown =
            || FeatureError::UnknownEngine { name: name.chars().take(80).collect(), known: known() };
        Self::ALL.into_iter().find(|engine| engine.name() == name).ok_or_else(unknown)
    }
}
