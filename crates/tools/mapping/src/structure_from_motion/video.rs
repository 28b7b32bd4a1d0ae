//! Frames of a video for structure from motion: decoded by ffmpeg, and chosen by movement and sharpness in `video.py`.
//!
//! ```text
//! frames/000001.jpg, …   the kept frames, in the order of the video
//! frames/video.json      the file that they are of, and their numbers in it, from 0; written last
//! ```

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use veiloc_features::Progress;
use veiloc_map::atomic_file::write_atomic;

use super::pycolmap::run_script;
use crate::error::MappingError;

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
    let record = folder.join("video.json");
    let file = video.metadata().map_err(MappingError::io(video))?;
    let changed = file.modified().ok().and_then(|time| time.duration_since(std::time::UNIX_EPOCH).ok());
    let file = json!([path, file.len(), changed.map(|time| time.as_nanos() as u64)]);
    let numbers = |document: &Value| document.get("frames").and_then(Value::as_array).map_or(0, Vec::len);
    // Their names; none if a file is missing.
    let names = |document: &Value| -> Vec<String> {
        let names: Vec<String> = (1..=numbers(document)).map(|number| format!("{number:06}.jpg")).collect();
        if names.iter().all(|name| folder.join(name).is_file()) { names } else { Vec::new() }
    };
    let known = fs::read_to_string(&record).ok().and_then(|text| serde_json::from_str::<Value>(&text).ok());
    let fault = |document: &Value| {
        document.get("fault").and_then(Value::as_str).filter(|fault| !fault.is_empty()).map(str::to_owned)
    };
    if let Some(known) = known.filter(|known| known.get("video") == Some(&file)) {
        let names = names(&known);
        if !names.is_empty() {
            return Ok(VideoFrames { folder, names, of: None, fault: fault(&known) });
        }
    }
    match fs::remove_file(&record) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            return Err(MappingError::io(&record)(error));
        }
        _ => {}
    }
    let python = python.unwrap_or_else(|| Path::new("python3"));
    let mut kept = Value::Null;
    run_script(python, SCRIPT, &json!({ "video": path, "folder": written }), progress, &mut |fields| {
        if fields.contains_key("frames") {
            kept = Value::Object(fields);
        }
    })
    .map_err(|reason| {
        let remedy = if reason.contains("No module named") { INSTALL_FFMPEG } else { "" };
        faulty(format!("ffmpeg and Python gave no frames: {reason}\n{remedy}").trim_end().to_owned())
    })?;
    let names = names(&kept);
    if names.is_empty() {
        return Err(faulty("ffmpeg wrote fewer frames than were chosen".to_owned()));
    }
    let text = json!({ "video": file, "frames": kept.get("frames"), "fault": kept.get("fault") }).to_string();
    write_atomic(&record, text.as_bytes()).map_err(MappingError::io(&record))?;
    let of = kept.get("of").and_then(Value::as_u64).map(|n| n as usize);
    Ok(VideoFrames { folder, names, of, fault: fault(&kept) })
}
