//! Runs programs in a Python that print their progress, and records what a folder was made of.

use std::ffi::OsStr;
use std::fmt;
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};

use serde_json::{Map, Value, json};
use veiloc_features::Progress;
use veiloc_map::atomic_file::write_atomic;

use crate::error::MappingError;

/// Characters of the program's output that an error shows.
const SHOWN: usize = 2000;

/// Why a program gave no result.
#[derive(Debug)]
pub(crate) enum PythonFailure {
    /// It could not be run.
    NotRun(String),
    /// It ended with this status and this log.
    Ended(ExitStatus, String),
}

impl PythonFailure {
    /// Whether Python, or a module, is not there.
    pub(crate) fn is_missing(&self) -> bool {
        match self {
            Self::NotRun(_) => true,
            Self::Ended(_, log) => log.contains("No module named"),
        }
    }
}

impl fmt::Display for PythonFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotRun(reason) => f.write_str(reason),
            Self::Ended(status, log) => write!(f, "({status}): {log}"),
        }
    }
}

/// Runs a program that reads a document on stdin and prints an object a line: `{"stage": name, "total": n}` and `{"done": n}` are
/// its progress, the others are passed to `each`.
pub(crate) fn run_python(
    python: &Path,
    arguments: &[&OsStr],
    input: &Value,
    progress: &dyn Progress,
    each: &mut dyn FnMut(Map<String, Value>),
) -> Result<(), PythonFailure> {
    let broken = |error: std::io::Error| PythonFailure::NotRun(format!("{}: {error}", python.display()));
    let mut child = Command::new(python)
        .args(arguments)
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
    // A program that ends before it reads says why in its log.
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
    if status.success() { Ok(()) } else { Err(PythonFailure::Ended(status, tail(&log).to_owned())) }
}

/// The end of a log.
pub(crate) fn tail(log: &str) -> &str {
    let log = log.trim_end();
    let from = log.char_indices().rev().nth(SHOWN).map_or(0, |(at, _)| at);
    &log[from..]
}

/// The file that says what a folder was made of, with the result: written last, so that a folder without it is incomplete.
pub(crate) struct RunRecord {
    path: PathBuf,
}

impl RunRecord {
    pub(crate) const fn new(path: PathBuf) -> Self {
        Self { path }
    }

    /// What is recorded; `None` if there is nothing that can be read.
    pub(crate) fn read(&self) -> Option<Value> {
        fs::read_to_string(&self.path).ok().and_then(|text| serde_json::from_str(&text).ok())
    }

    pub(crate) fn remove(&self) -> Result<(), MappingError> {
        match fs::remove_file(&self.path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(MappingError::io(&self.path)(error))
            }
            _ => Ok(()),
        }
    }

    pub(crate) fn write(&self, document: &Value) -> Result<(), MappingError> {
        write_atomic(&self.path, document.to_string().as_bytes()).map_err(MappingError::io(&self.path))
    }
}

/// A file as a record knows it: another one of its name has another length or time.
pub(crate) fn file_state(path: &Path) -> Result<Value, MappingError> {
    let file = path.metadata().map_err(MappingError::io(path))?;
    let changed = file.modified().ok().and_then(|time| time.duration_since(std::time::UNIX_EPOCH).ok());
    Ok(json!([path.to_string_lossy(), file.len(), changed.map(|time| time.as_nanos() as u64)]))
}
