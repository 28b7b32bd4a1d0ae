//! Runs pycolmap in a Python, by a script that prints its progress.

use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::{Map, Value, json};
use veiloc_features::Progress;

use super::state::{Causes, Task, cause};
use crate::error::MappingError;

const SCRIPT: &str = include_str!("pycolmap.py");

/// Characters of the program's output that an error shows.
const SHOWN: usize = 2000;

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
    run_script(python, SCRIPT, &input, progress, &mut |fields| {
        let number = |key: &str| fields.get(key).and_then(Value::as_u64).map_or(0, |n| n as usize);
        if let Some(name) = fields.get("unregistered").and_then(Value::as_str) {
            causes.insert(name.to_owned(), cause(number("keypoints"), number("verified_pairs")));
        }
    })
    .map_err(|reason| MappingError::Sfm {
        reason: format!("{}: pycolmap failed {reason}", python.display()),
    })?;
    Ok(causes)
}

/// Runs a script that reads a document on stdin and prints an object a line: `{"stage": name, "total": n}` and `{"done": n}` are
/// its progress, the others are passed to `each`. The error is the status and the end of its log.
pub(super) fn run_script(
    python: &Path,
    script: &str,
    input: &Value,
    progress: &dyn Progress,
    each: &mut dyn FnMut(Map<String, Value>),
) -> Result<(), String> {
    let broken = |error: std::io::Error| format!("{}: {error}", python.display());
    let mut child = Command::new(python)
        .args(["-c", script])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(broken)?;
    // Its log, which would fill the pipe if nothing read it.
    let log = child.stderr.take().map(|mut stderr| {
        std::thread::spawn(move || {
            let mut log = Vec::new();
            let _ = stderr.read_to_end(&mut log);
            String::from_utf8_lossy(&log).into_owned()
        })
    });
    // A script that ends before it reads says why in its log.
    let _ = child.stdin.take().map(|mut stdin| stdin.write_all(input.to_string().as_bytes()));
    let mut done = 0;
    for line in child.stdout.take().map(BufReader::new).into_iter().flat_map(BufRead::lines) {
        // COLMAP itself prints lines, too.
        let Ok(Value::Object(fields)) = serde_json::from_str::<Value>(&line.map_err(broken)?) else {
            continue;
        };
        let number = |key: &str| fields.get(key).and_then(Value::as_u64).map(|n| n as usize);
        if let (Some(stage), Some(total)) = (fields.get("stage").and_then(Value::as_str), number("total")) {
            progress.start(stage, total);
            done = 0;
        } else if let Some(now) = number("done") {
            progress.advance(now.saturating_sub(done));
            done = done.max(now);
        } else {
            each(fields);
        }
    }
    progress.finish();
    let status = child.wait().map_err(broken)?;
    let log = log.and_then(|log| log.join().ok()).unwrap_or_default();
    if status.success() { Ok(()) } else { Err(format!("({status}): {}", tail(&log))) }
}

/// The end of a log.
pub(super) fn tail(log: &str) -> &str {
    let log = log.trim_end();
    let from = log.char_indices().rev().nth(SHOWN).map_or(0, |(at, _)| at);
    &log[from..]
}
