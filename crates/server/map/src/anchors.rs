//! The content anchors of a map, in a file beside it: `place.anchors.json` beside `place.vmap`.
//!
//! The file records some images with their poses ([`ContentAnchors::set_frame`]), so that anchors are never taken for those of a
//! map in another coordinate frame that was put in place of theirs.

use std::fs;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use veiloc_geometry::CameraFromWorld;
use veiloc_protocol::ContentAnchors;

use crate::atomic_file::{Permissions, TargetLock, replace_file};
use crate::{MapError, MapFile, MapModel, open_regular_file};

/// The file of the content anchors of a map file.
pub fn anchors_path(map: &Path) -> PathBuf {
    map.with_extension("anchors.json")
}

/// The content anchors beside a map; none without a file.
///
/// # Errors
/// [`MapError::Io`], [`MapError::Anchors`].
pub fn read_anchors(map: &Path) -> Result<ContentAnchors, MapError> {
    let path = anchors_path(map);
    let mut bytes = Vec::new();
    let read = open_regular_file(&path)
        .and_then(|file| file.take(ContentAnchors::MAX_FILE as u64 + 1).read_to_end(&mut bytes));
    match read {
        Ok(_) => ContentAnchors::decode(&bytes).map_err(|source| MapError::Anchors { path, source }),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(ContentAnchors::default()),
        Err(source) => Err(MapError::Io { path, source }),
    }
}

/// The content anchors beside a map, locked against other writers until they are written or dropped.
#[derive(Debug)]
pub struct AnchorsEdit {
    lock: TargetLock,
    /// The anchors.
    pub anchors: ContentAnchors,
}

impl AnchorsEdit {
    /// Waits for the lock, and reads.
    ///
    /// # Errors
    /// As [`read_anchors`].
    pub fn begin(map: &Path) -> Result<Self, MapError> {
        let path = anchors_path(map);
        let lock = TargetLock::acquire(&path).map_err(|source| MapError::Io { path, source })?;
        Ok(Self { lock, anchors: read_anchors(map)? })
    }

    /// Writes the anchors; without any the file is removed.
    ///
    /// # Errors
    /// [`MapError::Io`]; then the old file stays.
    pub fn write(self) -> Result<(), MapError> {
        let path = self.lock.target();
        let done = if self.anchors.anchors().is_empty() {
            match fs::remove_file(path) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
                _ => Ok(()),
            }
        } else {
            let bytes = self.anchors.encode();
            replace_file(&self.lock, Permissions::Preserve, |out| out.write_all(&bytes))
        };
        done.map_err(|source| MapError::Io { path: path.to_owned(), source })
    }
}

impl MapFile {
    /// Names and poses of the images, by which anchors recognize the coordinate frame.
    pub fn frame_images(&self) -> impl ExactSizeIterator<Item = (&str, &CameraFromWorld)> {
        self.images().map(|image| (image.name(), image.cam_from_world()))
    }
}

impl MapModel {
    /// As [`MapFile::frame_images`].
    pub fn frame_images(&self) -> impl ExactSizeIterator<Item = (&str, &CameraFromWorld)> {
        self.images.iter().map(|image| (image.name.as_str(), &image.cam_from_world))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn anchors_are_kept_beside_the_map() {
        let folder = tempfile::tempdir().expect("folder");
        let map = folder.path().join("floor.2.vmap");
        assert_eq!(read_anchors(&map).expect("none").anchors().len(), 0);
        let json =
            br#"{"version":1,"anchors":[{"name":"door","map_from_anchor":{"q":[1,0,0,0],"t":[0,1,2]}}]}"#;
        let mut edit = AnchorsEdit::begin(&map).expect("locked");
        edit.anchors = ContentAnchors::decode(json).expect("valid");
        edit.write().expect("written");
        assert!(folder.path().join("floor.2.anchors.json").is_file());
        assert_eq!(read_anchors(&map).expect("one").anchors()[0].name, "door");
        let mut edit = AnchorsEdit::begin(&map).expect("locked");
        edit.anchors.remove("door");
        edit.write().expect("written");
        assert_eq!(
            fs::read_dir(folder.path()).expect("folder").count(),
            0,
            "neither an empty file nor a lock"
        );
        fs::write(anchors_path(&map), &json[..40]).expect("written");
        let error = read_anchors(&map).expect_err("cut off").to_string();
        assert!(error.contains("floor.2.anchors.json") && error.contains("line 1"), "{error}");
        fs::write(anchors_path(&map), vec![b' '; 2 << 20]).expect("written");
        assert!(matches!(read_anchors(&map), Err(MapError::Anchors { .. })));
    }
}
