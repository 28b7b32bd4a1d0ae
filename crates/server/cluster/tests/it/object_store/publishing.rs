//! Publishing and fetching are atomic and incremental, also with faults in between.

use super::common;

use std::fs;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use common::{StorageFault, no_progress, regions, run, storage};
use futures_util::TryStreamExt as _;
use object_store::memory::InMemory;
use object_store::{ObjectStore as _, ObjectStoreExt as _};
use veiloc_cluster::ClusterError;
use veiloc_cluster::object_store::{Storage, fetch_folder};
use veiloc_map::regions::{MANIFEST_FILE, ObjectId, RegionFolder};

#[test]
fn published_folder_is_fetched_unchanged() {
    let [from, to, shop] = [(); 3].map(|()| tempfile::tempdir().expect("a folder"));
    let folder = regions(8, from.path());
    let url = url::Url::from_file_path(shop.path().join("maps of mine")).expect("a URL");
    let url = url.as_str();
    let storage = Storage::create(url).expect("a folder");
    let (manifest, id) = (folder.manifest(), folder.manifest().id());
    let count = manifest.objects().count();
    assert!(matches!(run(storage.current("rooms")), Err(ClusterError::NotThere { .. })));

    let progress = std::sync::Mutex::new(Vec::new());
    let watch = |done, total| progress.lock().expect("alone").push((done, total));
    let first = run(storage.publish(&folder, &watch)).expect("published");
    assert_eq!(
        (first.manifest, first.sent, first.sent_bytes, first.there),
        (id, count, manifest.byte_count(), 0)
    );
    let progress = progress.into_inner().expect("alone");
    assert_eq!(
        (progress[0], progress[count]),
        ((0, manifest.byte_count()), (manifest.byte_count(), manifest.byte_count()))
    );
    let again = run(storage.publish(&folder, &no_progress)).expect("published");
    assert_eq!((again.sent, again.there, again.there_bytes), (0, count, manifest.byte_count()));

    // By path instead of URL.
    let reader = Storage::open(shop.path().join("maps of mine").to_str().expect("text")).expect("a folder");
    assert_eq!(run(reader.current("rooms")).expect("a pointer"), id);
    let fetched = run(fetch_folder(&reader, "rooms", id, to.path(), &no_progress)).expect("fetched");
    assert_eq!((fetched.fetched, fetched.there), (count, 0));
    assert_eq!(RegionFolder::open(to.path()).expect("regions").manifest(), manifest);
    for object in manifest.objects() {
        let [a, b] = [&folder, &RegionFolder::open(to.path()).expect("regions")]
            .map(|f| fs::read(f.path_of(&object.sha256)).expect("bytes"));
        assert_eq!(a, b);
    }
    let manifests = [&from, &to].map(|f| fs::read(f.path().join(MANIFEST_FILE)).expect("bytes"));
    assert_eq!(manifests[0], manifests[1]);
    // Only the damaged object is fetched again.
    let region = RegionFolder::open(to.path()).expect("regions").path_of(&manifest.regions[0].sha256);
    let mut bytes = fs::read(&region).expect("bytes");
    bytes[100] ^= 1;
    fs::write(&region, bytes).expect("damaged");
    let mended = run(fetch_folder(&reader, "rooms", id, to.path(), &no_progress)).expect("fetched");
    assert_eq!((mended.fetched, mended.there), (1, count - 1));
}

/// An older version is made current again, and old ones go with what only they need.
#[test]
fn versions_are_restored_and_removed() {
    let [old, new] = [(); 2].map(|()| tempfile::tempdir().expect("a folder"));
    let (old_regions, new_regions) = (regions(8, old.path()), regions(9, new.path()));
    let memory = Arc::new(InMemory::new());
    let storage = storage(&memory, StorageFault::None);
    let ids = [&old_regions, &new_regions].map(|folder| folder.manifest().id());
    for folder in [&old_regions, &new_regions] {
        run(storage.publish(folder, &no_progress)).expect("published");
    }
    let currents = || {
        let versions = run(storage.versions("rooms")).expect("versions");
        let mut found: Vec<_> =
            versions.iter().map(|version| (version.manifest, version.is_current)).collect();
        found.sort_unstable();
        found
    };
    let expected = |current: &[ObjectId], all: &[ObjectId]| {
        let mut found: Vec<_> = all.iter().map(|id| (*id, current.contains(id))).collect();
        found.sort_unstable();
        found
    };
    assert_eq!(currents(), expected(&ids[1..], &ids));
    run(storage.restore("rooms", ids[0])).expect("restored");
    assert_eq!(currents(), expected(&ids[..1], &ids));
    let other = ObjectId::of(b"another manifest");
    assert!(matches!(run(storage.restore("rooms", other)), Err(ClusterError::NotThere { .. })));
    assert!(matches!(run(storage.restore("hall", ids[0])), Err(ClusterError::NotThere { .. })));

    // A map of another name needs the objects of the new version too.
    let mut manifest = new_regions.manifest().clone();
    "hall".clone_into(&mut manifest.map);
    let hall = RegionFolder::of(manifest, new.path());
    run(storage.publish(&hall, &no_progress)).expect("published");
    assert!(matches!(
        run(storage.restore("rooms", hall.manifest().id())),
        Err(ClusterError::Manifest { .. })
    ));
    let (hour, now) = (Duration::from_secs(3600), SystemTime::now());
    let remove = |map: &str, later: u32| run(storage.remove_older(map, hour, now + later * hour));
    let removed = remove("rooms", 0).expect("nothing is old");
    assert_eq!((removed.versions, removed.objects), (0, 0));
    let removed = remove("rooms", 2).expect("removed");
    assert_eq!((removed.versions, removed.objects), (1, 0), "the hall needs them");
    assert_eq!(currents(), expected(&ids[..1], &ids[..1]));
    let to = tempfile::tempdir().expect("a folder");
    run(fetch_folder(&storage, "hall", hall.manifest().id(), to.path(), &no_progress)).expect("complete");

    // The hall gets the old version, and its former one goes with all that only it needs.
    let mut manifest = old_regions.manifest().clone();
    "hall".clone_into(&mut manifest.map);
    run(storage.publish(&RegionFolder::of(manifest, old.path()), &no_progress)).expect("published");
    let kept: Vec<ObjectId> = old_regions.manifest().objects().map(|object| object.sha256).collect();
    let only_new = new_regions.manifest().objects().filter(|object| !kept.contains(&object.sha256));
    let only_new: Vec<_> = only_new.collect();
    let removed = remove("hall", 2).expect("removed");
    let bytes = only_new.iter().map(|object| object.bytes).sum();
    assert_eq!((removed.versions, removed.objects, removed.bytes), (1, only_new.len(), bytes));
    let to = tempfile::tempdir().expect("a folder");
    run(fetch_folder(&storage, "rooms", ids[0], to.path(), &no_progress)).expect("complete");

    // Nothing is removed while it is not known what a version needs.
    let damaged = object_store::path::Path::from(format!("manifests/{}.json", ids[0]));
    let listed = run(memory.list(None).try_collect::<Vec<_>>()).expect("a list");
    let location = listed.iter().map(|meta| &meta.location).find(|at| at.filename() == damaged.filename());
    run(memory.put(location.expect("the manifest"), "{}".into())).expect("written");
    assert!(matches!(remove("hall", 9), Err(ClusterError::Manifest { .. })));
    // An object that is gone makes a version unfit.
    run(storage.publish(&old_regions, &no_progress)).expect("published");
    let name = kept[0].to_string();
    let object = listed.iter().map(|meta| &meta.location).find(|at| at.filename() == Some(&name));
    run(memory.delete(object.expect("an object"))).expect("deleted");
    assert!(matches!(run(storage.restore("rooms", ids[0])), Err(ClusterError::NotThere { .. })));
}

/// Wherever publishing fails, a reader gets the old or the new regions completely.
#[test]
fn readers_see_the_old_or_the_new_map_completely() {
    let [old, new] = [(); 2].map(|()| tempfile::tempdir().expect("a folder"));
    let (old, new) = (regions(8, old.path()), regions(9, new.path()));
    // New objects, a manifest, and a pointer.
    let there: Vec<ObjectId> = old.manifest().objects().map(|object| object.sha256).collect();
    let all = new.manifest().objects().filter(|object| !there.contains(&object.sha256)).count() + 2;
    let mut currents = Vec::new();
    for writes in 0..=all {
        let memory = Arc::new(InMemory::new());
        run(storage(&memory, StorageFault::None).publish(&old, &no_progress)).expect("published");
        let published = run(storage(&memory, StorageFault::WritesAfter(writes)).publish(&new, &no_progress));
        assert_eq!(published.is_ok(), writes == all, "{writes}");
        let reader = storage(&memory, StorageFault::None);
        let current = run(reader.current("rooms")).expect("a pointer");
        let to = tempfile::tempdir().expect("a folder");
        run(fetch_folder(&reader, "rooms", current, to.path(), &no_progress)).expect("all of it is there");
        currents.push(current);
    }
    let (last, before) = currents.split_last().expect("some");
    assert_eq!(*last, new.manifest().id());
    assert!(before.iter().all(|current| *current == old.manifest().id()));
}

#[test]
fn transient_errors_are_retried_and_permanent_ones_reported() {
    let from = tempfile::tempdir().expect("a folder");
    let folder = regions(8, from.path());
    let id = folder.manifest().id();
    let memory = Arc::new(InMemory::new());
    run(storage(&memory, StorageFault::First(2)).publish(&folder, &no_progress))
        .expect("at the third attempt");
    for (fault, is_well) in [(StorageFault::First(2), true), (StorageFault::First(99), false)] {
        let to = tempfile::tempdir().expect("a folder");
        let reader = storage(&memory, fault);
        let fetched = run(fetch_folder(&reader, "rooms", id, to.path(), &no_progress));
        assert_eq!(fetched.is_ok(), is_well, "{fetched:?}");
        assert!(is_well || matches!(fetched, Err(ClusterError::Storage { .. })));
    }
}

#[test]
fn damaged_regions_are_not_published() {
    let from = tempfile::tempdir().expect("a folder");
    let folder = regions(8, from.path());
    let path = folder.path_of(&folder.manifest().regions[1].sha256);
    let bytes = fs::read(&path).expect("bytes");
    let memory = Arc::new(InMemory::new());
    let storage = storage(&memory, StorageFault::None);
    let mut wrong = bytes.clone();
    wrong[99] ^= 1;
    for content in [Some(&wrong[..]), Some(&bytes[..50]), None] {
        match content {
            Some(content) => fs::write(&path, content).expect("damaged"),
            None => fs::remove_file(&path).expect("removed"),
        }
        let refused = run(storage.publish(&folder, &no_progress)).expect_err("damaged");
        assert!(matches!(refused, ClusterError::Map(_)), "{refused}");
        assert!(refused.to_string().contains(path.to_str().expect("text")), "{refused}");
        assert!(matches!(run(storage.current("rooms")), Err(ClusterError::NotThere { .. })));
    }
    fs::write(&path, &bytes).expect("mended");
    run(storage.publish(&folder, &no_progress)).expect("published");
}
