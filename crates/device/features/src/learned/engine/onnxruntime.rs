//! ONNX Runtime as an engine: the user's library, loaded together with the first network.
//!
//! Only the library that `ORT_DYLIB_PATH` names is loaded; the system is not searched.

use std::path::PathBuf;
use std::sync::{Mutex, OnceLock, PoisonError};

use ort::session::{Session, SessionInputValue};
use ort::value::{TensorRef, ValueType};

use super::run::{Input, Run};
use crate::learned::onnx::with_outputs;
use crate::learned::{Layer, Tensor};

/// The environment variable with the path of the library.
const LIBRARY: &str = "ORT_DYLIB_PATH";

/// A network. A session returns the declared outputs of its model, so an inner layer requires a model that declares it.
pub(super) struct OnnxRuntime {
    onnx: Vec<u8>,
    inputs: Vec<Input>,
    /// Names of the outputs that the file declares.
    outputs: Vec<String>,
    threads: usize,
    /// One session per requested set of inner layers; the first has none.
    sessions: Mutex<Vec<(Vec<String>, Session)>>,
}

impl OnnxRuntime {
    pub(super) fn load(onnx: Vec<u8>) -> Result<Self, String> {
        library()?;
        let threads = rayon::current_num_threads();
        let session = session(&onnx, threads)?;
        let of =
            |input: &ort::value::Outlet| Input { name: input.name().to_owned(), sides: sides(input.dtype()) };
        let inputs = session.inputs().iter().map(of).collect();
        let outputs = session.outputs().iter().map(|output| output.name().to_owned()).collect();
        let sessions = Mutex::new(vec![(Vec::new(), session)]);
        Ok(Self { onnx, inputs, outputs, threads, sessions })
    }
}

impl Run for OnnxRuntime {
    fn inputs(&self) -> Vec<Input> {
        self.inputs.clone()
    }

    fn outputs(&self) -> Vec<String> {
        self.outputs.clone()
    }

    fn metadata(&self, key: &str) -> Option<String> {
        let sessions = self.sessions.lock().unwrap_or_else(PoisonError::into_inner);
        sessions.first()?.1.metadata().ok()?.custom(key)
    }

    fn run(&self, inputs: &[&Tensor], layers: &[Layer]) -> Result<Vec<Tensor>, String> {
        let name = |layer: &Layer| match layer {
            Layer::Output(number) => {
                let output = self.outputs.get(*number).cloned();
                output.ok_or_else(|| format!("it has no output {number}"))
            }
            Layer::Named(name) => Ok(name.clone()),
        };
        let names = layers.iter().map(name).collect::<Result<Vec<_>, _>>()?;
        let mut inner: Vec<String> =
            names.iter().filter(|name| !self.outputs.contains(name)).cloned().collect();
        inner.sort();
        inner.dedup();
        let mut sessions = self.sessions.lock().unwrap_or_else(PoisonError::into_inner);
        let known = sessions.iter().position(|(of, _)| *of == inner);
        let at = known.unwrap_or(sessions.len());
        if known.is_none() {
            let onnx = with_outputs(&self.onnx, &inner).ok_or("it is damaged")?;
            sessions.push((inner, session(&onnx, self.threads)?));
        }
        let session = &mut sessions[at].1;
        let inputs = (self.inputs.iter().zip(inputs))
            .map(|(input, tensor)| {
                let view = TensorRef::from_array_view((tensor.shape.clone(), &tensor.data[..]));
                Ok((input.name.clone(), SessionInputValue::from(view.map_err(words)?)))
            })
            .collect::<Result<Vec<_>, String>>()?;
        let results = session.run(inputs).map_err(words)?;
        let tensor = |name: &String| {
            let value = results.get(name).ok_or_else(|| format!("it has no layer {name}"))?;
            let (shape, data) = value.try_extract_tensor::<f32>().map_err(words)?;
            let shape = shape.iter().map(|side| usize::try_from(*side).unwrap_or(0)).collect();
            Ok(Tensor { shape, data: data.to_vec() })
        };
        names.iter().map(tensor).collect()
    }
}

/// Loads the library, once.
fn library() -> Result<(), String> {
    static LOADED: OnceLock<Result<(), String>> = OnceLock::new();
    let load = || {
        let path = std::env::var_os(LIBRARY).filter(|path| !path.is_empty()).map(PathBuf::from);
        let path = path.ok_or_else(|| {
            format!("{LIBRARY} names no library of ONNX Runtime (for example libonnxruntime.so)")
        })?;
        // Some builds send telemetry: a device must not reveal its use.
        ort::init_from(&path).map_err(words)?.with_telemetry(false).commit();
        Ok(())
    };
    LOADED.get_or_init(load).clone()
}

fn session(onnx: &[u8], threads: usize) -> Result<Session, String> {
    let builder = Session::builder().map_err(words)?;
    let builder = builder.with_intra_threads(threads).map_err(words)?;
    let mut builder = builder.with_deterministic_compute(true).map_err(words)?;
    builder.commit_from_memory(onnx).map_err(words)
}

fn words(error: impl std::fmt::Display) -> String {
    error.to_string()
}

fn sides(kind: &ValueType) -> Vec<Option<usize>> {
    match kind {
        ValueType::Tensor { shape, .. } => shape.iter().map(|side| usize::try_from(*side).ok()).collect(),
        _ => Vec::new(),
    }
}
