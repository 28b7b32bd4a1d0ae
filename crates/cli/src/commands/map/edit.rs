//! A map that a command changes.

use std::path::Path;

use veiloc_map::{MapFile, MapLock, MapModel};

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
        Ok(MapFile::open(self.map)?.to_model())
    }

    pub(super) fn write(&self, model: &MapModel) -> Result<(), Failure> {
        Ok(self.lock.write(model)?)
    }
}
