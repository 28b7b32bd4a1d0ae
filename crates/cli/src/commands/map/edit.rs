//! A map that a command changes, and the content anchors beside it.

use std::path::Path;

use veiloc_map::{AnchorsEdit, MapError, MapFile, MapLock, MapModel, anchors_path, read_anchors};
use veiloc_protocol::ContentAnchors;

use crate::output::exit::Failure;
use crate::output::ui::Ui;

/// A map that is being changed; it is locked against other writers from reading to writing.
pub(super) struct MapEdit<'a> {
    map: &'a Path,
    pub(super) out: &'a Path,
    lock: MapLock,
}

impl<'a> MapEdit<'a> {
    /// Waits for the lock of the map, and reports the wait.
    pub(super) fn begin(map: &'a Path, out: Option<&'a Path>, ui: &Ui) -> Result<Self, Failure> {
        let out = out.unwrap_or(map);
        let lock = if let Some(lock) = MapLock::try_acquire(out)? {
            lock
        } else {
            ui.info(format!("{}: waiting for another program that changes it", out.display()));
            MapLock::acquire(out)?
        };
        Ok(Self { map, out, lock })
    }

    pub(super) fn read(&self) -> Result<MapModel, Failure> {
        let model = MapFile::open(self.map)?.to_model();
        check_anchors(self.map, self.out, &model)?;
        Ok(model)
    }

    /// Writes a map in the coordinate frame that it had.
    pub(super) fn write(&self, model: &MapModel) -> Result<(), Failure> {
        self.write_with(model, |_| Ok(()))
    }

    /// Writes a map whose content anchors change by `carry`.
    pub(super) fn write_with(
        &self,
        model: &MapModel,
        carry: impl FnOnce(&mut ContentAnchors) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        write_with_anchors(self.map, self.out, model, carry, || self.lock.write(model))
    }
}

/// Refuses a change after which content anchors would be lost or in wrong places, before it takes minutes.
pub(super) fn check_anchors(map: &Path, out: &Path, model: &MapModel) -> Result<(), Failure> {
    let own = read_anchors(map)?;
    if !own.is_of_frame(model.frame_images()) {
        return Err(other_frame(map));
    }
    let stay = !own.anchors().is_empty() && anchors_path(map) != anchors_path(out);
    if stay && !read_anchors(out)?.anchors().is_empty() {
        return Err(Failure::with_help(
            format!("{} and {} both have content anchors", map.display(), out.display()),
            format!("move {} away, or write to another file", anchors_path(out).display()),
        ));
    }
    Ok(())
}

/// The error about anchors of another coordinate frame.
pub(super) fn other_frame(map: &Path) -> Failure {
    Failure::with_help(
        format!("{}: of another coordinate frame than {}", anchors_path(map).display(), map.display()),
        "carry them with `veiloc map anchors --carry` or `--carry-from OLD`, or move the file away",
    )
}

/// Writes a map with the content anchors of the map that it was made of. Those of a file that a service changes meanwhile are read
/// under their lock.
pub(super) fn write_with_anchors(
    map: &Path,
    out: &Path,
    model: &MapModel,
    carry: impl FnOnce(&mut ContentAnchors) -> Result<(), Failure>,
    write: impl FnOnce() -> Result<(), MapError>,
) -> Result<(), Failure> {
    let mut edit = AnchorsEdit::begin(out)?;
    if anchors_path(map) != anchors_path(out) {
        let own = read_anchors(map)?;
        if own.anchors().is_empty() && !edit.anchors.anchors().is_empty() {
            // Anchors of the file that is replaced: without a transform they stay as they are.
            return Ok(write()?);
        }
        edit.anchors = own;
    }
    carry(&mut edit.anchors)?;
    edit.anchors.set_frame(model.frame_images());
    write()?;
    Ok(edit.write()?)
}

/// Warns of content anchors beside a new map that are of the one it replaced.
pub(super) fn warn_of_anchors(out: &Path, model: &MapModel, ui: &Ui) {
    if let Ok(anchors) = read_anchors(out)
        && !anchors.is_of_frame(model.frame_images())
    {
        ui.warn(format_args!(
            "warning: {} is of another coordinate frame, so no service gives these anchors; carry them with `veiloc map anchors \
             --carry` or `--carry-from OLD`",
            anchors_path(out).display()
        ));
    }
}
