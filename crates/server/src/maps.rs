//! The maps that are served, and exchanging one for another while queries are being answered.

use std::fs;
use std::path::Path;
use std::sync::{Arc, PoisonError, RwLock};
use std::time::SystemTime;

use sha2::{Digest as _, Sha256};
use veiloc_map::{MapError, MapFile};

use crate::error::ServerError;
use crate::geo::GeoFrame;
use crate::options::MapSource;

/// Rows of the largest query, and room for the fields around them.
const QUERY_ROWS: usize = 4096;
const QUERY_FIELDS: usize = 4096;

/// A map as it is now. Whoever answers a query keeps this one, whatever becomes of its name meanwhile.
pub(crate) struct Hosted {
    pub(crate) name: String,
    pub(crate) map: MapFile,
    pub(crate) geo: Option<GeoFrame>,
    /// What a device needs.
    pub(crate) profile: Vec<u8>,
    /// SHA-256 of the profile in quotation marks, as HTTP wants it.
    pub(crate) etag: String,
    /// No query that fits this map is longer.
    pub(crate) longest_query: usize,
}

impl Hosted {
    fn open(source: &MapSource) -> Result<Self, MapError> {
        let map = MapFile::open(&source.path)?;
        let profile = map.profile().encode();
        let hash = Sha256::digest(&profile);
        let digits = hash.iter().fold(String::new(), |text, byte| text + &format!("{byte:02x}"));
        Ok(Self {
            name: source.name.clone(),
            geo: source.geo.clone(),
            longest_query: QUERY_ROWS * (4 + map.profile().descriptor_kind().dim())
                + QUERY_FIELDS
                + map.profile().global_model().global_len(),
            etag: format!("\"{digits}\""),
            profile,
            map,
        })
    }
}

/// What tells one state of a file from another without reading it. A file that is replaced by renaming has another
/// number, even when size and time are the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Stamp {
    length: u64,
    modified: Option<SystemTime>,
    file: u64,
}

impl Stamp {
    /// `None` when there is no such file now.
    pub(crate) fn of(path: &Path) -> Option<Self> {
        let metadata = fs::metadata(path).ok()?;
        Some(Self {
            length: metadata.len(),
            modified: metadata.modified().ok(),
            file: file_number(&metadata),
        })
    }
}

#[cfg(unix)]
fn file_number(metadata: &fs::Metadata) -> u64 {
    std::os::unix::fs::MetadataExt::ino(metadata)
}

#[cfg(not(unix))]
fn file_number(_: &fs::Metadata) -> u64 {
    0
}

/// One name, and the map it stands for at the moment.
pub(crate) struct Slot {
    source: MapSource,
    current: RwLock<Arc<Hosted>>,
    /// State of the file when it was last looked into, refused files included: a broken one is refused once.
    seen: RwLock<Option<Stamp>>,
}

impl Slot {
    fn open(source: MapSource) -> Result<Self, ServerError> {
        let seen = Stamp::of(&source.path);
        let hosted =
            Hosted::open(&source).map_err(|e| ServerError::Map { name: source.name.clone(), source: e })?;
        Ok(Self { source, current: RwLock::new(Arc::new(hosted)), seen: RwLock::new(seen) })
    }

    pub(crate) fn name(&self) -> &str {
        &self.source.name
    }

    /// The map as it is now.
    pub(crate) fn current(&self) -> Arc<Hosted> {
        // Nothing panics while it holds the lock; should it ever, the map in it is still whole.
        self.current.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Whether the file is another than the one looked into last.
    pub(crate) fn is_stale(&self) -> bool {
        let stamp = Stamp::of(&self.source.path);
        // A file that is missing is about to be there again, or is nothing to change over to.
        stamp.is_some() && stamp != *self.seen.read().unwrap_or_else(PoisonError::into_inner)
    }

    /// Opens the file again and serves it from now on. When it cannot be opened, the old map stays.
    pub(crate) fn reload(&self) -> Result<(), MapError> {
        // Taken before opening: a file exchanged in between looks stale next time.
        *self.seen.write().unwrap_or_else(PoisonError::into_inner) = Stamp::of(&self.source.path);
        let hosted = Arc::new(Hosted::open(&self.source)?);
        *self.current.write().unwrap_or_else(PoisonError::into_inner) = hosted;
        Ok(())
    }
}

/// All maps, in the order given.
pub(crate) struct Maps {
    slots: Vec<Slot>,
}

impl Maps {
    /// Opens all of them; one that cannot be opened is an error.
    pub(crate) fn open(sources: &[MapSource]) -> Result<Self, ServerError> {
        let slots = sources.iter().cloned().map(Slot::open).collect::<Result<_, _>>()?;
        Ok(Self { slots })
    }

    /// The map of this name as it is now.
    pub(crate) fn find(&self, name: &str) -> Option<Arc<Hosted>> {
        self.slots.iter().find(|slot| slot.name() == name).map(Slot::current)
    }

    pub(crate) fn slots(&self) -> &[Slot] {
        &self.slots
    }
}
