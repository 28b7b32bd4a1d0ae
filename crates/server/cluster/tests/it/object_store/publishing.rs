//! Publishing and fetching are atomic and incremental, also with faults in between.

use super::common;

use std::fs;
use std::sync::Arc;

use common::{StorageFault, no_progress, regions, run, storage};
use object_store::memory::InMemory;
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
