//! Faulty or hostile storage gives a typed error, and only valid objects enter the cache.

use super::common;

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use common::{StorageFault, no_progress, regions, run, storage};
use object_store::ObjectStoreExt as _;
use object_store::memory::InMemory;
use object_store::path::Path as Location;
use veiloc_cluster::ClusterError;
use veiloc_cluster::object_store::{ManifestPointer, ObjectCache};
use veiloc_map::ManifestError;
use veiloc_map::regions::{OBJECTS_FOLDER, ObjectId, ObjectRef, RegionFolder};

/// A map of two rooms in storage.
fn published() -> (Arc<InMemory>, RegionFolder, tempfile::TempDir) {
    let from = tempfile::tempdir().expect("a folder");
    let folder = regions(8, from.path());
    let memory = Arc::new(InMemory::new());
    run(storage(&memory, StorageFault::None).publish(&folder, &no_progress)).expect("published");
    (memory, folder, from)
}

fn put(memory: &InMemory, path: &str, bytes: impl Into<Vec<u8>>) {
    run(memory.put(&Location::parse(path).expect("a path"), bytes.into().into())).expect("memory");
}

fn files(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("a folder");
    let mut names: Vec<String> =
        entries.map(|e| e.expect("an entry").file_name().into_string().expect("text")).collect();
    names.sort();
    names
}

#[test]
fn invalid_objects_are_refused_and_leave_no_files() {
    let (memory, folder, from) = published();
    let object = folder.manifest().regions[0].object();
    let good = fs::read(folder.path_of(&object.sha256)).expect("bytes");
    let name = format!("maps/objects/{}", object.sha256);
    let to = tempfile::tempdir().expect("a folder");
    let cache = ObjectCache::open(to.path(), 1 << 30).expect("a cache");
    let objects = to.path().join(OBJECTS_FOLDER);
    let mut other = good.clone();
    other[77] ^= 4;
    let longer = [&good[..], b"more"].concat();
    for wrong in [&other[..], &good[..good.len() - 1], &longer[..], b""] {
        put(&memory, &name, wrong);
        let refused =
            run(cache.object(&storage(&memory, StorageFault::None), &object)).expect_err("wrong bytes");
        assert!(matches!(refused, ClusterError::Object { .. }), "{refused}");
        assert!(refused.to_string().contains("memory://maps/objects/"), "{refused}");
        assert_eq!(files(&objects), [] as [String; 0]);
    }
    put(&memory, &name, good.clone());
    for (fault, is_right) in [
        (StorageFault::Endless, (|e| matches!(e, ClusterError::Object { .. })) as fn(&ClusterError) -> bool),
        (StorageFault::Stalls, |e| matches!(e, ClusterError::Stalled { .. })),
        (StorageFault::First(9), |e| matches!(e, ClusterError::Storage { .. })),
    ] {
        let refused = run(cache.object(&storage(&memory, fault), &object)).expect_err("no end");
        assert!(is_right(&refused), "{fault:?}: {refused}");
        assert_eq!(files(&objects), [] as [String; 0]);
    }
    let missing = ObjectRef::of(b"never published");
    let refused = run(cache.object(&storage(&memory, StorageFault::None), &missing)).expect_err("not there");
    assert!(matches!(refused, ClusterError::NotThere { .. }), "{refused}");
    let path = run(cache.object(&storage(&memory, StorageFault::None), &object)).expect("sound again");
    assert_eq!(fs::read(path).expect("bytes"), good);
    drop(from);
}

#[test]
fn damaged_cache_files_are_fetched_again() {
    let (memory, folder, from) = published();
    let object = folder.manifest().regions[0].object();
    let to = tempfile::tempdir().expect("a folder");
    let cache = ObjectCache::open(to.path(), 1 << 30).expect("a cache");
    let path = run(cache.object(&storage(&memory, StorageFault::None), &object)).expect("fetched");
    let good = fs::read(&path).expect("bytes");
    // A valid object is served from the cache even if storage fails.
    run(cache.object(&storage(&memory, StorageFault::First(99)), &object)).expect("from the cache");
    for damaged in [&good[1..], b""] {
        fs::write(&path, damaged).expect("damaged");
        assert!(
            run(cache.object(&storage(&memory, StorageFault::First(99)), &object)).is_err(),
            "never used"
        );
        fs::write(&path, damaged).expect("damaged");
        run(cache.object(&storage(&memory, StorageFault::None), &object)).expect("fetched again");
        assert_eq!(fs::read(&path).expect("bytes"), good);
    }
    let id = folder.manifest().id();
    let manifest = |fault| run(cache.manifest(&storage(&memory, fault), "rooms", id));
    assert_eq!(&manifest(StorageFault::None).expect("a manifest"), folder.manifest());
    manifest(StorageFault::First(99)).expect("from the cache");
    fs::write(to.path().join(format!("manifests/{id}.json")), "{}").expect("damaged");
    assert!(manifest(StorageFault::First(99)).is_err());
    assert_eq!(&manifest(StorageFault::None).expect("fetched again"), folder.manifest());
    drop(from);
}

#[test]
fn invalid_pointers_and_manifests_are_refused() {
    let (memory, folder, _from) = published();
    let reader = || storage(&memory, StorageFault::None);
    let id = folder.manifest().id();
    let text = String::from_utf8(ManifestPointer::new("rooms", id).encode()).expect("text");
    for wrong in [
        text.replace(&id.to_string(), "../../../etc/passwd"),
        text.replace("rooms", "hall"),
        text.replace("\"version\": 1", "\"version\": 9"),
        "[]".to_owned(),
    ] {
        put(&memory, "maps/rooms.json", wrong);
        let refused = run(reader().current("rooms")).expect_err("no pointer");
        assert!(matches!(refused, ClusterError::Pointer { .. }), "{refused}");
    }
    put(&memory, "maps/rooms.json", vec![b' '; 5000]);
    assert!(matches!(run(reader().current("rooms")), Err(ClusterError::ObjectTooLong { most: 4096, .. })));
    let endless = run(storage(&memory, StorageFault::Endless).current("rooms"));
    assert!(matches!(endless, Err(ClusterError::ObjectTooLong { .. })), "{endless:?}");
    for name in ["../rooms", "a/b", "", ".."] {
        assert!(matches!(run(reader().current(name)), Err(ClusterError::Map(_))), "{name}");
    }

    let manifest = run(reader().manifest("hall", id));
    assert!(
        matches!(&manifest, Err(ClusterError::Manifest { source: ManifestError::OtherMap { .. }, .. })),
        "{manifest:?}"
    );
    // Another manifest under this id, and one with a path outside of the folder.
    let own = String::from_utf8(folder.manifest().encode()).expect("text");
    let region = folder.manifest().regions[0].sha256.to_string();
    put(&memory, &format!("maps/manifests/{id}.json"), own.replace("rooms", "other"));
    let other = run(reader().manifest("rooms", id));
    assert!(
        matches!(&other, Err(ClusterError::Manifest { source: ManifestError::OtherId { .. }, .. })),
        "{other:?}"
    );
    let way_out = own.replace(&region, "../../x");
    let named = ObjectId::of(way_out.as_bytes());
    put(&memory, &format!("maps/manifests/{named}.json"), way_out);
    let refused = run(reader().manifest("rooms", named));
    assert!(
        matches!(&refused, Err(ClusterError::Manifest { source: ManifestError::Json(_), .. })),
        "{refused:?}"
    );
}

#[test]
fn cache_stays_within_its_limit() {
    let (memory, folder, _from) = published();
    let reader = storage(&memory, StorageFault::None);
    let objects: Vec<ObjectRef> = folder.manifest().objects().collect();
    let to = tempfile::tempdir().expect("a folder");
    let largest = objects.iter().map(|o| o.bytes).max().expect("some");
    let cache = ObjectCache::open(to.path(), largest * 2).expect("a cache");
    let huge = ObjectRef { bytes: 1 << 40, ..objects[0] };
    assert!(matches!(run(cache.object(&reader, &huge)), Err(ClusterError::CacheTooSmall { .. })));
    let hour = |hours: u64| SystemTime::now() - Duration::from_secs(3600 * hours);
    for (age, object) in (0..).zip(&objects) {
        let path = run(cache.object(&reader, object)).expect("fetched");
        let file = fs::File::options().append(true).open(path).expect("there");
        file.set_modified(hour(20 - age)).expect("a time");
    }
    // Using the oldest object makes it the newest.
    run(cache.object(&reader, &objects[0])).expect("there");
    let folder_of = to.path().join(OBJECTS_FOLDER);
    let partial = folder_of.join(format!(".{}.1-0.partial", objects[0].sha256));
    let fresh = folder_of.join(format!(".{}.1-1.partial", objects[0].sha256));
    // Written when the clock was ahead.
    let ahead = folder_of.join(format!(".{}.1-2.partial", objects[0].sha256));
    let written =
        [(&partial, hour(2)), (&fresh, hour(0)), (&ahead, SystemTime::now() + Duration::from_secs(7200))];
    for (path, time) in written {
        fs::write(path, "half").expect("written");
        fs::File::options().append(true).open(path).expect("there").set_modified(time).expect("a time");
    }
    let needed = BTreeSet::from([objects[1].sha256]);
    let trimmed = cache.trim(&needed).expect("trimmed");
    assert!(trimmed.bytes <= largest * 2 && trimmed.removed > 0, "{trimmed:?}");
    let left = files(&folder_of);
    let is_left = |object: &ObjectRef| left.contains(&object.sha256.to_string());
    assert!(is_left(&objects[0]) && is_left(&objects[1]), "the newest and the needed objects stay");
    assert!(!is_left(&objects[2]), "the oldest object is removed");
    assert!(!partial.exists() && fresh.exists() && !ahead.exists());
    let bytes: u64 = objects.iter().filter(|o| is_left(o)).map(|o| o.bytes).sum();
    assert_eq!(bytes, trimmed.bytes);
    // Needed objects are kept even above the limit.
    let all: BTreeSet<ObjectId> = objects.iter().map(|o| o.sha256).collect();
    for object in &objects {
        run(cache.object(&reader, object)).expect("fetched");
    }
    assert_eq!(cache.trim(&all).expect("trimmed").removed, 0);
}

#[test]
fn space_is_freed_before_fetching() {
    let (memory, folder, _from) = published();
    let reader = storage(&memory, StorageFault::None);
    let objects: Vec<ObjectRef> = folder.manifest().objects().collect();
    let bytes_of = |objects: &[ObjectRef]| objects.iter().map(|object| object.bytes).sum::<u64>();
    let (old, new) = objects.split_at(objects.len() / 2);
    let to = tempfile::tempdir().expect("a folder");
    let most = bytes_of(&objects) - 1;
    let cache = ObjectCache::open(to.path(), most).expect("a cache");
    for object in old {
        run(cache.object(&reader, object)).expect("fetched");
    }
    let ids = |objects: &[ObjectRef]| objects.iter().map(|object| object.sha256).collect::<BTreeSet<_>>();
    // Needed objects stay; others are evicted, and no more than necessary.
    let held = ids(&objects);
    assert_eq!(cache.trim_for(new, &held).expect("looked").removed, 0);
    let made = cache.trim_for(new, &ids(new)).expect("made");
    assert!(made.removed == 1 && made.bytes + bytes_of(new) <= most, "{made:?}");
    // Existing objects need no space.
    assert_eq!(cache.trim_for(&old[1..], &ids(new)).expect("looked").removed, 0);
}

#[test]
fn last_manifest_is_recorded_and_damage_is_ignored() {
    let to = tempfile::tempdir().expect("a folder");
    let cache = ObjectCache::open(to.path(), 1 << 30).expect("a cache");
    assert_eq!(cache.recorded_manifest("rooms"), None);
    for id in [ObjectId::of(b"one"), ObjectId::of(b"two")] {
        cache.record_manifest("rooms", id).expect("written");
        assert_eq!(cache.recorded_manifest("rooms"), Some(id));
    }
    assert_eq!((cache.recorded_manifest("hall"), cache.recorded_manifest("../pointers/rooms")), (None, None));
    let path = to.path().join("pointers/rooms.json");
    let whole = fs::read_to_string(&path).expect("text");
    for damaged in [&whole[1..], "", &whole.replace("rooms", "hall")] {
        fs::write(&path, damaged).expect("written");
        assert_eq!(cache.recorded_manifest("rooms"), None, "{damaged}");
    }
}
