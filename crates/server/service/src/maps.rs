//! The maps that are served: each with its own readiness, exchanged, added and removed while queries are answered.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use std::time::{Instant, SystemTime};

use crate::http::Attempts;
use crate::web_page::{Content, thinned};
use veiloc_map::is_map_name;
use veiloc_map::{MapError, MapFile, MapMemory};
use veiloc_protocol::{Profile, RigMessage};

use crate::asked::Kind;
use crate::elsewhere::{Description, Elsewhere, MapElsewhere};
use crate::error::ServerError;
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
    pub(crate) held: Held,
    pub(crate) images: usize,
    pub(crate) points: usize,
    /// What a device needs.
    pub(crate) profile: Content,
    /// The profile's name.
    pub(crate) profile_id: String,
    /// What a page is shown of its points; nothing of a map that others hold.
    pub(crate) shown: Content,
    /// No query that fits this map is longer.
    longest_query: usize,
}

/// How the files of maps are read.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reading {
    pub(crate) memory: MapMemory,
    /// Most points of each that a page is shown.
    pub(crate) page_points: usize,
}

/// Who holds the map itself.
pub(crate) enum Held {
    /// We do.
    Here(Box<MapFile>),
    /// Others, who described it so.
    Elsewhere { by: Arc<dyn Elsewhere>, as_described: Arc<Description> },
}

impl Hosted {
    fn open(source: &MapSource, reading: Reading) -> Result<Self, MapError> {
        let map = MapFile::open_in(&source.path, reading.memory)?;
        // Made before the first query needs it.
        map.global_index();
        let (images, points, profile) = (map.image_count(), map.point_count(), map.profile().clone());
        let shown = thinned(&map, reading.page_points);
        let hosted = Self::new(&source.name, &profile, [images, points], Held::Here(Box::new(map)));
        Ok(Self { shown, ..hosted })
    }

    fn elsewhere(source: &MapElsewhere, as_described: Arc<Description>) -> Self {
        let counts = [as_described.images, as_described.points];
        let held = Held::Elsewhere { by: source.held_by.clone(), as_described: as_described.clone() };
        Self::new(&source.name, &as_described.profile, counts, held)
    }

    fn new(name: &str, profile: &Profile, [images, points]: [usize; 2], held: Held) -> Self {
        Self {
            name: name.to_owned(),
            held,
            images,
            points,
            longest_query: QUERY_ROWS * (4 + profile.descriptor_kind().packed_len())
                + QUERY_FIELDS
                + profile.global_model().global_len(),
            profile_id: profile.id().to_string(),
            profile: Content::new(profile.encode()),
            shown: Content::new(Vec::new()),
        }
    }

    /// No body of this kind that fits this map, and gets to who holds it, is longer.
    pub(crate) fn longest(&self, kind: Kind) -> usize {
        let longest = match kind {
            Kind::Query => self.longest_query,
            Kind::Rig => RigMessage::longest(self.longest_query),
        };
        match &self.held {
            Held::Here(_) => longest,
            Held::Elsewhere { by, .. } => longest.min(by.longest()),
        }
    }

    /// The map itself, when it is here.
    pub(crate) fn map(&self) -> Option<&MapFile> {
        match &self.held {
            Held::Here(map) => Some(map),
            Held::Elsewhere { .. } => None,
        }
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
    source: Source,
    /// `None` as long as its file could not be opened, or nobody holds it.
    current: RwLock<Option<Arc<Hosted>>>,
    attempts: Mutex<Attempts<Option<Stamp>>>,
    /// Whether it is there because its file is in the folder, and how many looks did not find it.
    from_folder: Option<Mutex<u32>>,
}

/// Where a map comes from.
enum Source {
    File(MapSource, Reading),
    Elsewhere(MapElsewhere),
}

/// What became of an attempt to read a map.
pub(crate) type Reloaded = Result<Arc<Hosted>, MapError>;

impl Slot {
    fn new(source: Source, from_folder: bool) -> Self {
        Self {
            source,
            current: RwLock::new(None),
            attempts: Mutex::default(),
            from_folder: from_folder.then(Mutex::default),
        }
    }

    pub(crate) fn name(&self) -> &str {
        match &self.source {
            Source::File(source, _) => &source.name,
            Source::Elsewhere(source) => &source.name,
        }
    }

    /// Whether it is served from this very file.
    fn is_of(&self, path: &Path) -> bool {
        matches!(&self.source, Source::File(source, _) if source.path == path)
    }

    /// The map as it is now.
    pub(crate) fn current(&self) -> Option<Arc<Hosted>> {
        // Nothing panics while it holds the lock; should it ever, the map in it is still whole.
        let current = self.current.read().unwrap_or_else(PoisonError::into_inner).clone();
        match &self.source {
            Source::File(..) => current,
            Source::Elsewhere(source) => self.as_described_now(source, current),
        }
    }

    /// The map as those describe it who hold it.
    fn as_described_now(&self, source: &MapElsewhere, known: Option<Arc<Hosted>>) -> Option<Arc<Hosted>> {
        let now = source.held_by.describe()?;
        let same = |hosted: &Arc<Hosted>| matches!(&hosted.held, Held::Elsewhere { as_described, .. } if Arc::ptr_eq(as_described, &now));
        if known.as_ref().is_some_and(same) {
            return known;
        }
        let hosted = Arc::new(Hosted::elsewhere(source, now));
        *self.current.write().unwrap_or_else(PoisonError::into_inner) = Some(hosted.clone());
        Some(hosted)
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
    /// Of a map that others hold there is nothing to read.
    pub(crate) fn reload(&self, all: bool, now: Instant) -> Option<Reloaded> {
        let Source::File(source, reading) = &self.source else { return None };
        let before = Stamp::of(&source.path);
        // Held while reading: two who reload at once would only do the same twice.
        let mut attempts = self.attempts();
        if !all && !attempts.is_due(&before, now) {
            return None;
        }
        let opened = Hosted::open(source, *reading);
        match opened {
            Ok(hosted) => {
                let hosted = Arc::new(hosted);
                *self.current.write().unwrap_or_else(PoisonError::into_inner) = Some(hosted.clone());
                // A file exchanged while it was read is read again: its state is that of neither.
                if Stamp::of(&source.path) == before {
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

/// All maps: those given by name in the order given, those that others hold, then those of the folder by name.
pub(crate) struct Maps {
    slots: RwLock<Vec<Arc<Slot>>>,
    folder: Option<PathBuf>,
    reading: Reading,
    ignored: Mutex<Vec<String>>,
}

impl Maps {
    /// Nothing is opened yet.
    pub(crate) fn new(
        sources: &[MapSource],
        elsewhere: &[MapElsewhere],
        folder: Option<PathBuf>,
        reading: Reading,
    ) -> Self {
        let files = sources.iter().map(|source| Source::File(source.clone(), reading));
        let all = files.chain(elsewhere.iter().cloned().map(Source::Elsewhere));
        let slots = all.map(|source| Arc::new(Slot::new(source, false))).collect();
        Self { slots: RwLock::new(slots), folder, reading, ignored: Mutex::default() }
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
            if slots.iter().any(|slot| slot.name() == name && slot.is_of(&path)) {
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
            let slot = Arc::new(Slot::new(Source::File(MapSource { name, path }, self.reading), true));
            slots.push(slot.clone());
            changes.push(Change::Added(slot));
        }
        Ok(changes)
    }
}
