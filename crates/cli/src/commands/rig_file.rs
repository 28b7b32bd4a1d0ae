//! `rig.json`: the sealed queries of a session, with the pose of each camera on the device.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use veiloc_geometry::CameraFromRig;
use veiloc_map::text::without_mark;
use veiloc_protocol::{RigMessage, SealedFrame, SealedIn, SealedQuery, SessionTag};

use crate::output::exit::Failure;
use crate::output::files;

/// Maximum size of a rig file; far more than the maximum number of frames needs.
const MAX_BYTES: u64 = 1 << 20;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RigFile {
    frames: Vec<FrameEntry>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FrameEntry {
    /// The sealed query, relative to the rig file.
    query: PathBuf,
    /// Rig to camera, map units.
    cam_from_rig: PoseEntry,
    /// About each axis, degrees.
    rotation_sd_deg: f64,
    /// Along each axis, map units.
    translation_sd: f64,
    /// The session in which it was sealed, where that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    session: Option<String>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseEntry {
    /// Hamilton quaternion `w x y z`.
    q: [f64; 4],
    t: [f64; 3],
}

/// One frame of the session.
pub(super) struct NamedFrame {
    /// The path as written in the rig file.
    pub(super) file: String,
    pub(super) sealed: SealedFrame,
}

/// Reads a rig file and the queries that it names.
pub(super) fn read(path: &Path) -> Result<Vec<NamedFrame>, Failure> {
    let refused = |what: String, help: &str| Failure::with_help(format!("{}: {what}", path.display()), help);
    let form = "a rig file is {\"frames\": [{\"query\": \"a.vquery\", \"cam_from_rig\": {\"q\": [w, x, y, z], \"t\": [x, y, z]}, \
                \"rotation_sd_deg\": …, \"translation_sd\": …}, …]}";
    if std::fs::metadata(path).is_ok_and(|m| m.len() > MAX_BYTES) {
        return Err(refused(format!("longer than {MAX_BYTES} bytes"), form));
    }
    let bytes = files::read(path)?;
    let file: RigFile = serde_json::from_slice(without_mark(&bytes))
        .map_err(|e| refused(format!("not a rig file: {e}"), form))?;
    let count = file.frames.len();
    if !(1..=RigMessage::MAX_FRAMES).contains(&count) {
        let help = "a session has 1 to 32 frames; localize a longer one in parts";
        return Err(refused(format!("{count} frames"), help));
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    file.frames.into_iter().enumerate().map(|(k, entry)| entry.read(path, folder, k)).collect()
}

/// A query of a rig file, the pose of its camera, which is fixed to the rig, and the session in which it was sealed.
pub(super) type FixedFrame = (String, CameraFromRig, Option<SessionTag>);

/// A rig file of cameras that are fixed to the rig.
pub(super) fn fixed(frames: &[FixedFrame]) -> Result<Vec<u8>, Failure> {
    let entry = |(query, pose, session): &FixedFrame| FrameEntry {
        query: query.into(),
        cam_from_rig: PoseEntry { q: pose.quaternion(), t: (*pose.translation()).into() },
        rotation_sd_deg: 0.0,
        translation_sd: 0.0,
        session: session.map(|session| session.to_string()),
    };
    let file = RigFile { frames: frames.iter().map(entry).collect() };
    serde_json::to_vec_pretty(&file).map_err(Failure::refused)
}

impl FrameEntry {
    fn read(self, rig: &Path, folder: &Path, index: usize) -> Result<NamedFrame, Failure> {
        let file = self.query.display().to_string();
        let refused = |what: String, help: &str| {
            Failure::with_help(format!("{}: frame {index} ({file}): {what}", rig.display()), help)
        };
        let PoseEntry { q, t } = self.cam_from_rig;
        let cam_from_rig = CameraFromRig::from_quaternion(q, t).ok_or_else(|| {
            refused(
                "cam_from_rig is not a pose".to_owned(),
                "give a quaternion `w x y z` that is not 0, and finite numbers",
            )
        })?;
        for (what, value) in
            [("rotation_sd_deg", self.rotation_sd_deg), ("translation_sd", self.translation_sd)]
        {
            if !(value.is_finite() && value >= 0.0) {
                let help = "give a standard deviation, or 0 for a frame that is fixed to the rig";
                return Err(refused(format!("{what} is {value}"), help));
            }
        }
        let bytes = std::fs::read(folder.join(&self.query)).map_err(|e| {
            refused(e.to_string(), "paths are relative to the rig file; check that the file is readable")
        })?;
        let query = SealedQuery::decode(&bytes).map_err(|e| {
            refused(e.to_string(), "seal the image again with `veiloc seal`, and use the file unchanged")
        })?;
        let query = match self.session.map(|session| session.parse::<SessionTag>()) {
            None => query,
            Some(Ok(session)) => query.with_sealed_in(SealedIn::Session(session)),
            Some(Err(e)) => {
                return Err(refused(
                    e.to_string(),
                    "copy `session` as `veiloc seal` printed it, or leave it out",
                ));
            }
        };
        let sealed = SealedFrame {
            query,
            cam_from_rig,
            rotation_sd_deg: self.rotation_sd_deg,
            translation_sd: self.translation_sd,
        };
        Ok(NamedFrame { file, sealed })
    }
}
