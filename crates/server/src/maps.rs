//! The maps that are served: each with its own readiness, exchanged, added and removed while queries are answered.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use std::time::{Instant, SystemTime};

use sha2::{Digest as _, Sha256};
use veiloc_access::is_map_name;
use veiloc_map::{MapError, MapFile, MapMemory};
use veiloc_transport::Attempts;

use crate::error::ServerError;
use crate::geo::GeoFrame;
use crate::options::MapSource;
use crate::problem::Problem;

/// Rows of the largest query, and room for the fields around them.
const QUERY_ROWS: usize = 4096;
const QUERY_FIELDS: usize = 4096;

/// A file gone from the folder is a map taken away when so many looks in a row do not find it.
const LOOKS_WITHOUT: u32 = 2;

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
    fn open(source: &MapSource, memory: MapMemory) -> Result<Self, MapError> {
        let map = MapFile::open_in(&source.path, memory)?;
        let profile = map.profile().encode();
        let hash = Sha256::digest(&profile);
        let digits = hash.iter().fold(String::new(), |text, byte| text + &format!("{byte:02x}"));
        Ok(Self {
            name: source.name.clone(),
            geo: source.geo.clone(),
            longest_query: QUERY_ROWS * (4 + map.profile().descriptor_kind().packed_len())
                + QUERY_FIELDS
                + map.profile().global_model().global_len(),
            etag: format!("\"{digits}\""),
            profile,
            map,
        })
    }
}

/// What tells one state of a file from another without reading it. A file that is replaced by renaming has another
/// number; one that was written into has other times.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Stamp {
    length: u64,
    modified: Option<SystemTime>,
    /// Number of the file, and when its entry changed: seconds and nanoseconds.
    file: [i64; 3],
}

impl Stamp {
    /// `None` when there is no such file now.
    fn of(path: &Path) -> Option<Self> {
        let metadata = fs::metadata(path).ok()?;
        Some(Self {
            length: metadata.len(),
            modified: metadata.modified().ok(),
            file: file_number(&metadata),
        })
    }
}

#[cfg(unix)]
fn file_number(metadata: &fs::Metadata) -> [i64; 3] {
    use std::os::unix::fs::MetadataExt as _;
    [metadata.ino().cast_signed(), metadata.ctime(), metadata.ctime_nsec()]
}

#[cfg(not(unix))]
fn file_number(_: &fs::Metadata) -> [i64; 3] {
    [0; 3]
}

/// One name, and the map it stands for at the moment.
pub(crate) struct Slot {
    source: MapSource,
    memory: MapMemory,
    /// `None` as long as its file could not be opened.
    current: RwLock<Option<Arc<Hosted>>>,
    attempts: Mutex<Attempts<Option<Stamp>>>,
    /// Whether it is there because its file is in the folder, and how many looks did not find it.
    from_folder: Option<Mutex<u32>>,
}

/// What became of an attempt to read a map.
pub(crate) type Reloaded = Result<Arc<Hosted>, MapError>;

impl Slot {
    fn new(source: MapSource, memory: MapMemory, from_folder: bool) -> Self {
        Self {
            source,
            memory,
            current: RwLock::new(None),
            attempts: Mutex::default(),
            from_folder: from_folder.then(Mutex::default),
        }
    }

    pub(crate) fn name(&self) -> &str {
        &self.source.name
    }

    /// The map as it is now.
    pub(crate) fn current(&self) -> Option<Arc<Hosted>> {
        // Nothing panics while it holds the lock; should it ever, the map in it is still whole.
        self.current.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Whether the newest state of its file could not be read.
    pub(crate) fn is_failing(&self) -> bool {
        self.attempts().is_failing()
    }

    fn attempts(&self) -> MutexGuard<'_, Attempts<Option<Stamp>>> {
        self.attempts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reads the file and serves it from now on, if it is another than before or `all` is wished. When it cannot be read,
    /// the old map stays, and it is tried again.
    pub(crate) fn reload(&self, all: bool, now: Instant) -> Option<Reloaded> {
        let before = Stamp::of(&self.source.path);
        // Held while reading: two who reload at once would only do the same twice.
        let mut attempts = self.attempts();
        if !all && !attempts.is_due(&before, now) {
            return None;
        }
        let opened = Hosted::open(&self.source, self.memory);
        match opened {
            Ok(hosted) => {
                let hosted = Arc::new(hosted);
                *self.current.write().unwrap_or_else(PoisonError::into_inner) = Some(hosted.clone());
                // A file exchanged while it was read is read again: its state is that of neither.
                if Stamp::of(&self.source.path) == before {
                    attempts.took(before);
                } else {
                    *attempts = Attempts::default();
                }
                Some(Ok(hosted))
            }
            Err(error) => {
                attempts.failed(before, now);
                Some(Err(error))
            }
        }
    }
}

/// What a name stands for.
pub(crate) enum Named {
    Served(Arc<Hosted>),
    /// There should be a map, and its file cannot be opened.
    Broken,
    Unknown,
}

/// What changed in the folder.
pub(crate) enum Change {
    Added(Arc<Slot>),
    Removed(Arc<Slot>),
    /// A file whose name cannot be one of a map, or is another's.
    Ignored(String),
}

/// All maps: those given by name in the order given, then those of the folder by name.
pub(crate) struct Maps {
    slots: RwLock<Vec<Arc<Slot>>>,
    folder: Option<PathBuf>,
    memory: MapMemory,
    ignored: Mutex<Vec<String>>,
}

impl Maps {
    /// Nothing is opened yet.
    pub(crate) fn new(sources: &[MapSource], folder: Option<PathBuf>, memory: MapMemory) -> Self {
        let slots = sources.iter().map(|source| Arc::new(Slot::new(source.clone(), memory, false))).collect();
        Self { slots: RwLock::new(slots), folder, memory, ignored: Mutex::default() }
    }

    /// The map of this name as it is now.
    pub(crate) fn find(&self, name: &str) -> Named {
        let slots = self.slots.read().unwrap_or_else(PoisonError::into_inner);
        match slots.iter().find(|slot| slot.name() == name).map(|slot| slot.current()) {
            None => Named::Unknown,
            Some(None) => Named::Broken,
            Some(Some(hosted)) => Named::Served(hosted),
        }
    }

    /// The same for whoever needs it.
    pub(crate) fn served(&self, name: &str) -> Result<Arc<Hosted>, Problem> {
        match self.find(name) {
            Named::Served(hosted) => Ok(hosted),
            Named::Broken => Err(Problem::MapUnavailable),
            Named::Unknown => Err(Problem::UnknownMap),
        }
    }

    pub(crate) fn slots(&self) -> Vec<Arc<Slot>> {
        self.slots.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(crate) fn has_folder(&self) -> bool {
        self.folder.is_some()
    }

    /// Looks which files the folder holds, and makes and takes away names accordingly. New ones are not opened yet.
    ///
    /// # Errors
    /// When the folder cannot be read; then nothing changes.
    pub(crate) fn look_into_folder(&self) -> Result<Vec<Change>, ServerError> {
        let Some(folder) = &self.folder else { return Ok(Vec::new()) };
        let wrong = |source| ServerError::Io { path: folder.clone(), source };
        let mut found = Vec::new();
        for entry in fs::read_dir(folder).map_err(wrong)? {
            let path = entry.map_err(wrong)?.path();
            if path.extension().is_some_and(|extension| extension == "vmap")
                && let Some(name) = path.file_stem().and_then(|stem| stem.to_str())
                && !name.starts_with('.')
            {
                found.push((name.to_owned(), path));
            }
        }
        found.sort();
        let mut changes = Vec::new();
        let mut slots = self.slots.write().unwrap_or_else(PoisonError::into_inner);
        slots.retain(|slot| {
            let Some(looks) = &slot.from_folder else { return true };
            let mut looks = looks.lock().unwrap_or_else(PoisonError::into_inner);
            let is_there = found.iter().any(|(name, _)| name == slot.name());
            *looks = if is_there { 0 } else { *looks + 1 };
            if *looks >= LOOKS_WITHOUT {
                changes.push(Change::Removed(slot.clone()));
            }
            *looks < LOOKS_WITHOUT
        });
        let mut ignored = self.ignored.lock().unwrap_or_else(PoisonError::into_inner);
        for (name, path) in found {
            if slots.iter().any(|slot| slot.name() == name && slot.source.path == path) {
                continue;
            }
            let taken = slots.iter().any(|slot| slot.name() == name);
            if taken || !is_map_name(&name) {
                let file = path.display().to_string();
                if !ignored.contains(&file) {
                    ignored.push(file.clone());
                    changes.push(Change::Ignored(file));
                }
                continue;
            }
            let slot = Arc::new(Slot::new(MapSource { name, path, geo: None }, self.memory, true));
            slots.push(slot.clone());
            changes.push(Change::Added(slot));
        }
        Ok(changes)
    }
}
