//! Runs pycolmap in a Python, by a script that prints its progress.

use std::ffi::OsStr;
use std::path::Path;

use serde_json::{Value, json};
use veiloc_features::Progress;

use super::state::{Causes, Task, cause};
use crate::error::MappingError;
use crate::python::run_python;

const SCRIPT: &str = include_str!("pycolmap.py");

pub(super) fn run(python: &Path, task: &Task, progress: &dyn Progress) -> Result<Causes, MappingError> {
    let cameras = task.images.cameras.iter().map(|camera| {
        let params = camera.simple_pinhole.map(|params| params.map(|number| number.to_string()).join(","));
        json!({ "names": camera.names, "simple_pinhole": params })
    });
    let input = json!({
        "database": task.database(),
        "images": task.folder,
        "names": task.images.names,
        "sparse": task.sparse(),
        "cameras": cameras.collect::<Vec<_>>(),
        "rigs": task.images.rigs(),
        "matching": if task.is_sequential { "sequential" } else { "exhaustive" },
        "seed": task.seed,
    });
    let mut causes = Causes::new();
    run_python(python, &["-c", SCRIPT].map(OsStr::new), &input, progress, &mut |fields| {
        let number = |key: &str| fields.get(key).and_then(Value::as_u64).map_or(0, |n| n as usize);
        if let Some(name) = fields.get("unregistered").and_then(Value::as_str) {
            causes.insert(name.to_owned(), cause(number("keypoints"), number("verified_pairs")));
        }
    })
    .map_err(|failure| MappingError::Sfm {
        reason: format!("{}: pycolmap failed {failure}", python.display()),
    })?;
    Ok(causes)
}
