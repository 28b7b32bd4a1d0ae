//! Bags of ROS: their images with poses as files, by the Python package `veiloc[ros]`, which reads them.
//!
//! ```text
//! FOLDER/images/TOPIC/TIME.jpg, …     images, as `python -m veiloc.ros frames` writes them
//! FOLDER/posed/                       their cameras and poses, a COLMAP model as text
//! FOLDER/bag.json                     the bag and the options that they are of; with the result, which is written last
//! ```

use std::ffi::OsStr;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use veiloc_features::Progress;
use veiloc_map::GravityDirection;

use crate::error::MappingError;
use crate::python::{PythonFailure, RunRecord, file_state, run_python};

/// What brings the reader of bags.
pub const INSTALL_ROS: &str =
    "reading a bag needs the Python package: pip install 'veiloc[ros]', or give --python";

/// Which messages of a bag are read.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct BagOptions {
    /// Topics of images; empty for the only one.
    pub topics: Vec<String>,
    /// Topic of the poses. Default: the only one, or those of the transforms.
    pub odometry: Option<String>,
}

/// Images of a bag with poses.
#[derive(Debug)]
#[non_exhaustive]
pub struct BagFrames {
    /// The folder of the images.
    pub images: PathBuf,
    /// Their cameras and poses, for [`read_posed`](super::poses::read_posed).
    pub posed: PathBuf,
    /// Number of the images.
    pub count: usize,
    /// What was left out, for people.
    pub remarks: Vec<String>,
    /// The direction of gravity in the frame of the poses.
    pub down: Option<GravityDirection>,
    /// Whether lengths are metres.
    pub is_metric: bool,
    /// Whether they are of an earlier run.
    pub is_reused: bool,
}

/// Whether this is a bag: a file of MCAP, of ROS 2's SQLite or of ROS 1, or the folder of one.
pub fn is_bag(path: &Path) -> bool {
    let mut head = Vec::new();
    let metadata = path.join("metadata.yaml");
    let file = if path.is_dir() { &metadata } else { path };
    let read = std::fs::File::open(file).and_then(|file| file.take(4096).read_to_end(&mut head));
    if read.is_err() {
        return false;
    }
    let of_sqlite =
        path.extension().is_some_and(|extension| extension == "db3") && head.starts_with(b"SQLite format 3");
    if path.is_dir() {
        return String::from_utf8_lossy(&head).contains("rosbag2_bagfile_information");
    }
    head.starts_with(b"\x89MCAP0\r\n") || head.starts_with(b"#ROSBAG V") || of_sqlite
}

/// Writes the images of a bag and their poses into a folder. What an earlier run wrote of the same bag and options is used again.
/// `python`: a Python with the package; without one `python3` of the PATH.
///
/// # Errors
/// [`MappingError::Bag`]: the package is missing, it cannot read the bag, or the folder has something else.
pub fn frames_of_bag(
    bag: &Path,
    folder: &Path,
    options: &BagOptions,
    python: Option<&Path>,
    progress: &dyn Progress,
) -> Result<BagFrames, MappingError> {
    let faulty = |reason: String| MappingError::Bag { path: bag.to_owned(), reason };
    let mut files = vec![bag.to_owned()];
    if bag.is_dir() {
        files.extend(
            std::fs::read_dir(bag).map_err(MappingError::io(bag))?.flatten().map(|entry| entry.path()),
        );
        files.sort();
    }
    let files = files.iter().filter(|file| file.is_file()).map(|file| file_state(file));
    let input = json!({
        "files": files.collect::<Result<Vec<Value>, MappingError>>()?,
        "topics": options.topics,
        "odometry": options.odometry,
    });
    let record = RunRecord::new(folder.join("bag.json"));
    let before = record.read();
    let is_same = before.as_ref().is_some_and(|before| before.get("bag") == Some(&input));
    if let Some(result) = before.as_ref().and_then(|before| before.get("result")).filter(|_| is_same)
        && let Some(frames) = BagFrames::of(folder, result, true)
    {
        return Ok(frames);
    }
    let is_empty = std::fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_none());
    if folder.exists() && !is_empty && !is_same {
        let of = if before.is_some() { "images of another bag, or of other topics" } else { "other files" };
        return Err(faulty(format!(
            "the folder of its images, {}, has {of}; give a new folder with --images, or remove this one",
            folder.display()
        )));
    }
    std::fs::create_dir_all(folder).map_err(MappingError::io(folder))?;
    record.write(&json!({ "bag": input }))?;
    let mut arguments: Vec<&OsStr> = ["-m", "veiloc.ros", "frames"].map(OsStr::new).to_vec();
    arguments.extend([bag.as_os_str(), OsStr::new("--out"), folder.as_os_str(), OsStr::new("--json")]);
    let topics = options.topics.iter().map(|topic| ("--topic", topic));
    for (option, value) in topics.chain(options.odometry.iter().map(|topic| ("--odometry", topic))) {
        arguments.extend([OsStr::new(option), OsStr::new(value)]);
    }
    let mut result = Value::Null;
    let python = python.unwrap_or_else(|| Path::new("python3"));
    let done =
        run_python(python, &arguments, &Value::Null, progress, &mut |fields| result = Value::Object(fields));
    done.map_err(|failure| match &failure {
        PythonFailure::Ended(_, log) if log.starts_with("error: ") => {
            faulty(log["error: ".len()..].to_owned())
        }
        _ if failure.is_missing() => faulty(format!("{INSTALL_ROS} ({failure})")),
        _ => faulty(format!("{}: veiloc.ros failed {failure}", python.display())),
    })?;
    let frames = BagFrames::of(folder, &result, false)
        .ok_or_else(|| faulty(format!("{}: veiloc.ros wrote no images with poses", python.display())))?;
    record.write(&json!({ "bag": input, "result": result }))?;
    Ok(frames)
}

impl BagFrames {
    /// As a result says; `None` if its files are missing.
    fn of(folder: &Path, result: &Value, is_reused: bool) -> Option<Self> {
        let (images, posed) = (folder.join("images"), folder.join("posed"));
        let remarks = result.get("remarks").and_then(Value::as_array).into_iter().flatten();
        let down: Option<[f64; 3]> =
            result.get("down").and_then(|down| serde_json::from_value(down.clone()).ok());
        Some(Self {
            count: result.get("images").and_then(Value::as_u64).filter(|n| *n > 0)? as usize,
            remarks: remarks.filter_map(Value::as_str).map(str::to_owned).collect(),
            down: down.and_then(|down| GravityDirection::new(down).ok()),
            is_metric: result.get("metres").and_then(Value::as_bool) == Some(true),
            is_reused,
            images: Some(images).filter(|folder| folder.is_dir())?,
            posed: Some(posed).filter(|folder| folder.join("images.txt").is_file())?,
        })
    }
}
