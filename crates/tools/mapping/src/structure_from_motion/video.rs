//! Frames of a video for structure from motion: decoded by ffmpeg, and chosen by movement and sharpness in `video.py`.
//!
//! ```text
//! frames/000001.jpg, …   the kept frames, in the order of the video
//! frames/video.json      the file that they are of, and their numbers in it, from 0; written last
//! ```

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use veiloc_features::Progress;

use crate::error::MappingError;
use crate::python::{RunRecord, file_state, run_python};

const SCRIPT: &str = include_str!("video.py");

/// The commands that bring what a video needs.
pub const INSTALL_FFMPEG: &str =
    "a video needs ffmpeg and Python with NumPy: python3 -m pip install numpy imageio-ffmpeg";

/// Frames of a video.
#[derive(Debug)]
#[non_exhaustive]
pub struct VideoFrames {
    /// The folder of the kept frames.
    pub folder: PathBuf,
    /// Their names, in the order of the video.
    pub names: Vec<String>,
    /// Number of frames of the video; `None` if the frames are of an earlier run.
    pub of: Option<usize>,
    /// What ffmpeg says about damage of the video, such as a missing end: frames behind it are not there.
    pub fault: Option<String>,
}

/// Decodes a video with ffmpeg and keeps the frames that structure from motion needs, in the folder `frames` of `work`. Frames that an
/// earlier run kept of the same file are used again. `python`: a Python with NumPy; without one `python3` of the PATH.
///
/// # Errors
/// [`MappingError::Video`]: NumPy or ffmpeg is missing, ffmpeg cannot decode the file, or the video has fewer than three different views.
pub fn frames_of_video(
    video: &Path,
    work: &Path,
    python: Option<&Path>,
    progress: &dyn Progress,
) -> Result<VideoFrames, MappingError> {
    let faulty = |reason: String| MappingError::Video { path: video.to_owned(), reason };
    let folder = work.join("frames");
    let (Some(path), Some(written)) = (video.to_str(), folder.to_str()) else {
        return Err(faulty("its path is not UTF-8".to_owned()));
    };
    let record = RunRecord::new(folder.join("video.json"));
    let file = file_state(video)?;
    let numbers = |document: &Value| document.get("frames").and_then(Value::as_array).map_or(0, Vec::len);
    // Their names; none if a file is missing.
    let names = |document: &Value| -> Vec<String> {
        let names: Vec<String> = (1..=numbers(document)).map(|number| format!("{number:06}.jpg")).collect();
        if names.iter().all(|name| folder.join(name).is_file()) { names } else { Vec::new() }
    };
    let fault = |document: &Value| {
        document.get("fault").and_then(Value::as_str).filter(|fault| !fault.is_empty()).map(str::to_owned)
    };
    if let Some(known) = record.read().filter(|known| known.get("video") == Some(&file)) {
        let names = names(&known);
        if !names.is_empty() {
            return Ok(VideoFrames { folder, names, of: None, fault: fault(&known) });
        }
    }
    record.remove()?;
    let python = python.unwrap_or_else(|| Path::new("python3"));
    let mut kept = Value::Null;
    let (script, input) = (["-c", SCRIPT].map(OsStr::new), json!({ "video": path, "folder": written }));
    run_python(python, &script, &input, progress, &mut |fields| {
        if fields.contains_key("frames") {
            kept = Value::Object(fields);
        }
    })
    .map_err(|failure| {
        let remedy = if failure.is_missing() { INSTALL_FFMPEG } else { "" };
        faulty(format!("ffmpeg and Python gave no frames: {failure}\n{remedy}").trim_end().to_owned())
    })?;
    let names = names(&kept);
    if names.is_empty() {
        return Err(faulty("ffmpeg wrote fewer frames than were chosen".to_owned()));
    }
    record.write(&json!({ "video": file, "frames": kept.get("frames"), "fault": kept.get("fault") }))?;
    let of = kept.get("of").and_then(Value::as_u64).map(|n| n as usize);
    Ok(VideoFrames { folder, names, of, fault: fault(&kept) })
}
