//! The served maps. Each has its own readiness and can be replaced, added and removed while queries are answered.

pub(crate) mod geo_reference;
pub(crate) mod regions;
pub(crate) mod reload;
pub(crate) mod remote;
pub(crate) mod watch;

use std::fs;
use std::num::NonZeroU64;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use std::time::{Instant, SystemTime};

use crate::http::ReloadAttempts;
use crate::web_page::{Content, subsampled_points};
use veiloc_map::is_map_name;
use veiloc_map::{MapError, MapFile, MapMemory};
use veiloc_protocol::{MapCoordinates, Profile, RigMessage};

use crate::error::ServerError;
use crate::http::problem::Problem;
use crate::maps::geo_reference::GeoReference;
use crate::maps::remote::{MapDescription, RemoteBackend, RemoteMap};
use crate::options::MapSource;
use crate::routes::decoded_request::BodyKind;

/// Maximum rows of a query, and bytes for its other fields.
const QUERY_ROWS: usize = 4096;
const QUERY_FIELDS: usize = 4096;

/// A map is removed when this many scans in a row do not find its file.
const SCANS_UNTIL_REMOVED: u32 = 2;

/// One loaded version of a map. A query keeps its `Arc`, so replacing or removing the map does not affect queries in
/// flight.
pub(crate) struct LoadedMap {
    pub(crate) name: String,
    pub(crate) backend: Backend,
    pub(crate) images: usize,
    pub(crate) points: usize,
    /// The profile with which a device seals.
    pub(crate) profile: Content,
    /// Id of the profile.
    pub(crate) profile_id: String,
    /// The pack, where devices get it, with its id.
    pub(crate) pack: Option<(Content, String)>,
    /// The file, beside which its content anchors are; `None` for a remote map and a region.
    pub(crate) file: Option<PathBuf>,
    /// Points shown on the web page; empty for remote maps.
    pub(crate) shown: Content,
    /// Maximum length of a query for this map, bytes.
    max_query_bytes: usize,
}

/// How map files are read.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MapReadOptions {
    pub(crate) memory: MapMemory,
    /// Maximum number of points that a page shows per map.
    pub(crate) page_points: usize,
    /// Whether devices get the packs of the maps.
    pub(crate) packs: bool,
}

/// Where the map is.
pub(crate) enum Backend {
    /// In this process.
    Local(Box<MapFile>),
    /// In a remote backend, with its description.
    Remote { backend: Arc<dyn RemoteBackend>, description: Arc<MapDescription> },
}

impl LoadedMap {
    fn open(source: &MapSource, reading: MapReadOptions) -> Result<Self, MapError> {
        let map = MapFile::open_in(&source.path, reading.memory)?;
        // Build the index now, not on the first query.
        map.global_index();
        let shown = subsampled_points(&map, reading.page_points);
        // A map without points, or too large for a pack, has none.
        let pack = reading.packs.then(|| map.pack()).and_then(Result::ok);
        let pack = pack.map(|(pack, _)| (Content::new(pack.encode()), pack.id().to_string()));
        Ok(Self { pack, shown, file: Some(source.path.clone()), ..Self::local(&source.name, map) })
    }

    /// A map file or a region, without pack and points to show.
    pub(crate) fn local(name: &str, map: MapFile) -> Self {
        let (counts, profile) = ([map.image_count(), map.point_count()], map.profile().clone());
        Self::new(name, &profile, counts, Backend::Local(Box::new(map)))
    }

    fn remote(source: &RemoteMap, description: Arc<MapDescription>) -> Self {
        let counts = [description.images, description.points];
        let backend = Backend::Remote { backend: source.backend.clone(), description: description.clone() };
        Self::new(&source.name, &description.profile, counts, backend)
    }

    fn new(name: &str, profile: &Profile, [images, points]: [usize; 2], backend: Backend) -> Self {
        Self {
            name: name.to_owned(),
            backend,
            images,
            points,
            max_query_bytes: QUERY_ROWS * (4 + profile.descriptor_kind().packed_len())
                + QUERY_FIELDS
                + profile.global_model().global_len(),
            profile_id: profile.id().to_string(),
            profile: Content::new(profile.encode()),
            pack: None,
            file: None,
            shown: Content::new(Vec::new()),
        }
    }

    /// Maximum length of a body of this kind, bytes.
    pub(crate) fn longest(&self, kind: BodyKind) -> usize {
        match kind {
            BodyKind::Query => self.max_query_bytes,
            BodyKind::Rig => RigMessage::longest(self.max_query_bytes),
        }
    }

    /// What its coordinates mean.
    pub(crate) fn coordinates(&self) -> MapCoordinates {
        match &self.backend {
            Backend::Local(map) => map.coordinates(),
            Backend::Remote { description, .. } => description.coordinates,
        }
    }

    /// The map, if it is local.
    pub(crate) fn map(&self) -> Option<&MapFile> {
        match &self.backend {
            Backend::Local(map) => Some(map),
            Backend::Remote { .. } => None,
        }
    }
}

/// Identifies a version of a file without reading it. A file replaced by renaming has another inode; a file that was
/// overwritten has other times.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Stamp {
    length: u64,
    modified: Option<SystemTime>,
    /// Inode, and time of the last status change: seconds and nanoseconds.
    file: [i64; 3],
}

impl Stamp {
    /// `None` if the file does not exist.
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

/// A map name and the currently loaded map.
pub(crate) struct MapSlot {
    source: Source,
    /// `None` while the file cannot be opened or the remote backend is unreachable.
    current: RwLock<Option<Arc<LoadedMap>>>,
    attempts: Mutex<ReloadAttempts<Option<Stamp>>>,
    /// For maps found in the folder: number of scans in a row that did not find the file.
    from_folder: Option<Mutex<u32>>,
    /// Whether it has a geographic reference, which needs metres.
    has_reference: bool,
}

/// Source of a map.
enum Source {
    File(MapSource, MapReadOptions),
    Remote(RemoteMap),
}

/// Result of an attempt to read a map.
pub(crate) type ReloadResult = Result<Arc<LoadedMap>, MapError>;

impl MapSlot {
    fn new(source: Source, from_folder: bool, references: &[GeoReference]) -> Self {
        let slot = Self {
            source,
            current: RwLock::new(None),
            attempts: Mutex::default(),
            from_folder: from_folder.then(Mutex::default),
            has_reference: false,
        };
        let has_reference = references.iter().any(|reference| reference.map == slot.name());
        Self { has_reference, ..slot }
    }

    /// Warns of a map with a geographic reference that does not say that its unit is metres, or where down is: its GeoPoses are
    /// wrong by the scale of the map, or rotated.
    fn check_reference(&self, loaded: &LoadedMap) {
        if !self.has_reference {
            return;
        }
        let coordinates = loaded.coordinates();
        if coordinates.metres_per_unit.is_none() {
            tracing::warn!(
                map = loaded.name,
                "the unit of this map is not known to be metres, as its geographic reference needs: align it with \
                 `veiloc map align`, or build it with `--metres` if it is"
            );
        }
        if coordinates.down.is_none() {
            tracing::warn!(
                map = loaded.name,
                "the direction of gravity in this map is not known, so its GeoPoses take its z axis as up: align it with \
                 `veiloc map align`, or build it with `--down`"
            );
        }
    }

    pub(crate) fn name(&self) -> &str {
        match &self.source {
            Source::File(source, _) => &source.name,
            Source::Remote(source) => &source.name,
        }
    }

    /// Whether the map is served from this file.
    fn is_of(&self, path: &Path) -> bool {
        matches!(&self.source, Source::File(source, _) if source.path == path)
    }

    /// The currently loaded map.
    pub(crate) fn current(&self) -> Option<Arc<LoadedMap>> {
        // Nothing panics while holding the lock; even if it did, the map would be intact.
        let current = self.current.read().unwrap_or_else(PoisonError::into_inner).clone();
        match &self.source {
            Source::File(..) => current,
            Source::Remote(source) => self.current_remote(source, current),
        }
    }

    /// The remote map as its backend describes it now.
    fn current_remote(&self, source: &RemoteMap, known: Option<Arc<LoadedMap>>) -> Option<Arc<LoadedMap>> {
        let now = source.backend.describe()?;
        let same = |loaded: &Arc<LoadedMap>| match &loaded.backend {
            Backend::Remote { description, .. } => Arc::ptr_eq(description, &now),
            Backend::Local(_) => false,
        };
        if known.as_ref().is_some_and(same) {
            return known;
        }
        let loaded = Arc::new(LoadedMap::remote(source, now));
        self.check_reference(&loaded);
        *self.current.write().unwrap_or_else(PoisonError::into_inner) = Some(loaded.clone());
        Some(loaded)
    }

    /// Whether queries can be answered in every part of the map.
    pub(crate) fn is_complete(&self) -> bool {
        self.current().is_some_and(|loaded| match &loaded.backend {
            Backend::Local(_) => true,
            Backend::Remote { backend, .. } => backend.is_complete(),
        })
    }

    /// Whether the newest version of the file could not be read.
    pub(crate) fn is_failing(&self) -> bool {
        self.attempts().is_failing()
    }

    fn attempts(&self) -> MutexGuard<'_, ReloadAttempts<Option<Stamp>>> {
        self.attempts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reads the file if it changed or if `all` is set, and serves it from now on. If the file cannot be read, the
    /// previous map stays and the reload is retried. Does nothing for remote maps.
    pub(crate) fn reload(&self, all: bool, now: Instant) -> Option<ReloadResult> {
        let Source::File(source, reading) = &self.source else { return None };
        let before = Stamp::of(&source.path);
        // The lock is held while maps are read: two reloads at once would do the same work twice.
        let mut attempts = self.attempts();
        if !all && !attempts.is_due(&before, now) {
            return None;
        }
        let opened = LoadedMap::open(source, *reading);
        match opened {
            Ok(loaded) => {
                let loaded = Arc::new(loaded);
                self.check_reference(&loaded);
                *self.current.write().unwrap_or_else(PoisonError::into_inner) = Some(loaded.clone());
                // If the file was replaced while it was being read, its stamp is ambiguous: read it again.
                if Stamp::of(&source.path) == before {
                    attempts.succeeded(before);
                } else {
                    *attempts = ReloadAttempts::default();
                }
                Some(Ok(loaded))
            }
            Err(error) => {
                attempts.failed(before, now);
                Some(Err(error))
            }
        }
    }
}

/// Result of looking up a map name.
pub(crate) enum MapLookup {
    Served(Arc<LoadedMap>),
    /// The map is configured, but its file cannot be opened.
    Broken,
    /// The map is remote, and its backend does not know it yet.
    Pending,
    Unknown,
}

/// A change of the maps folder.
pub(crate) enum FolderChange {
    Added(Arc<MapSlot>),
    Removed(Arc<MapSlot>),
    /// A file whose name is not a valid map name or belongs to another map.
    Ignored(String),
}

/// All maps: local maps in configured order, then remote maps, then maps of the folder by name.
pub(crate) struct Maps {
    slots: RwLock<Vec<Arc<MapSlot>>>,
    folder: Option<PathBuf>,
    reading: MapReadOptions,
    references: Vec<GeoReference>,
    ignored: Mutex<Vec<String>>,
}

impl Maps {
    /// Creates the table; no file is opened yet.
    pub(crate) fn new(
        sources: &[MapSource],
        remote: &[RemoteMap],
        folder: Option<PathBuf>,
        reading: MapReadOptions,
        references: &[GeoReference],
    ) -> Self {
        let files = sources.iter().map(|source| Source::File(source.clone(), reading));
        let all = files.chain(remote.iter().cloned().map(Source::Remote));
        let slots = all.map(|source| Arc::new(MapSlot::new(source, false, references))).collect();
        Self {
            slots: RwLock::new(slots),
            folder,
            reading,
            references: references.to_vec(),
            ignored: Mutex::default(),
        }
    }

    /// Looks up the current map of this name.
    pub(crate) fn find(&self, name: &str) -> MapLookup {
        let slots = self.slots.read().unwrap_or_else(PoisonError::into_inner);
        match slots
            .iter()
            .find(|slot| slot.name() == name)
            .map(|slot| (matches!(slot.source, Source::Remote(_)), slot.current()))
        {
            None => MapLookup::Unknown,
            Some((true, None)) => MapLookup::Pending,
            Some((false, None)) => MapLookup::Broken,
            Some((_, Some(loaded))) => MapLookup::Served(loaded),
        }
    }

    /// As [`Self::find`], with a refusal when there is no map.
    pub(crate) fn served(&self, name: &str) -> Result<Arc<LoadedMap>, Problem> {
        match self.find(name) {
            MapLookup::Served(loaded) => Ok(loaded),
            MapLookup::Broken => Err(Problem::MapUnavailable),
            // A gateway that has just started reads its map within a second.
            MapLookup::Pending => Err(Problem::Unreached { retry_after: NonZeroU64::MIN }),
            MapLookup::Unknown => Err(Problem::UnknownMap),
        }
    }

    pub(crate) fn slots(&self) -> Vec<Arc<MapSlot>> {
        self.slots.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(crate) fn has_folder(&self) -> bool {
        self.folder.is_some()
    }

    /// Scans the folder, and adds and removes maps accordingly. New maps are not opened yet.
    ///
    /// # Errors
    /// The folder cannot be read; then nothing changes.
    pub(crate) fn scan_folder(&self) -> Result<Vec<FolderChange>, ServerError> {
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
            let Some(misses) = &slot.from_folder else { return true };
            let mut misses = misses.lock().unwrap_or_else(PoisonError::into_inner);
            let is_there = found.iter().any(|(name, _)| name == slot.name());
            *misses = if is_there { 0 } else { *misses + 1 };
            if *misses >= SCANS_UNTIL_REMOVED {
                changes.push(FolderChange::Removed(slot.clone()));
            }
            *misses < SCANS_UNTIL_REMOVED
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
                    changes.push(FolderChange::Ignored(file));
                }
                continue;
            }
            let source = Source::File(MapSource { name, path }, self.reading);
            let slot = Arc::new(MapSlot::new(source, true, &self.references));
            slots.push(slot.clone());
            changes.push(FolderChange::Added(slot));
        }
        Ok(changes)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
    use veiloc_protocol::Profile;

    use super::*;
    use crate::maps::remote::{AnswerFuture, MapDescription, RemoteBackend, RemoteRequest};

    /// A backend whose map can be replaced.
    struct Replaced(Mutex<Arc<MapDescription>>);

    impl RemoteBackend for Replaced {
        fn describe(&self) -> Option<Arc<MapDescription>> {
            Some(self.0.lock().unwrap().clone())
        }
        fn is_complete(&self) -> bool {
            true
        }
        fn localize(&self, _: RemoteRequest) -> AnswerFuture<'_> {
            unreachable!("no query is sent")
        }
    }

    #[derive(Clone, Default)]
    struct Log(Arc<Mutex<Vec<u8>>>);

    impl Write for Log {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().write(bytes)
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn remote_map_in_an_unknown_unit_is_warned_of_once_if_it_has_a_geographic_reference() {
        let described = |is_metric: bool| {
            let coordinates = MapCoordinates { metres_per_unit: is_metric.then_some(1.0), down: None };
            let words = Descriptors::new(DescriptorKind::ROOT_SIFT, vec![9; 512]).unwrap();
            let profile = Profile::vlad(Vocabulary::new(words).unwrap());
            Arc::new(MapDescription { profile, images: 1, points: 1, coordinates })
        };
        let log = Log::default();
        let writer = log.clone();
        let subscriber = tracing_subscriber::fmt().with_writer(move || writer.clone()).finish();
        let warnings = || {
            String::from_utf8(log.0.lock().unwrap().clone())
                .unwrap()
                .matches("not known to be metres")
                .count()
        };
        tracing::subscriber::with_default(subscriber, || {
            for (map, expected) in [("lobby", [1, 1, 2]), ("hall", [2, 2, 2])] {
                let backend = Arc::new(Replaced(Mutex::new(described(false))));
                let remote = RemoteMap { name: map.to_owned(), backend: backend.clone() };
                let reference: GeoReference = "lobby=47.3769,8.5417,455".parse().unwrap();
                let slot = MapSlot::new(Source::Remote(remote), false, &[reference]);
                slot.current().unwrap();
                slot.current().unwrap();
                assert_eq!(warnings(), expected[0], "{map}: the same map");
                *backend.0.lock().unwrap() = described(true);
                slot.current().unwrap();
                assert_eq!(warnings(), expected[1], "{map}: in metres");
                *backend.0.lock().unwrap() = described(false);
                slot.current().unwrap();
                assert_eq!(warnings(), expected[2], "{map}: replaced");
            }
        });
    }
}
