//! Published and fetched: all of it or the old, nothing twice, whatever breaks in between.

use super::common;

use std::fs;
use std::sync::Arc;

use common::{Fault, nobody, regions, run, storage};
use object_store::memory::InMemory;
use veiloc_cluster::ClusterError;
use veiloc_cluster::object_store::{Storage, fetch_folder};
use veiloc_map::regions::{Folder, MANIFEST_FILE, ObjectId};

#[test]
fn a_folder_comes_back_as_it_was() {
    let [from, to, shop] = [(); 3].map(|()| tempfile::tempdir().expect("a folder"));
    let folder = regions(8, from.path());
    let url = url::Url::from_file_path(shop.path().join("maps of mine")).expect("a URL");
    let url = url.as_str();
    let storage = Storage::create(url).expect("a folder");
    let (manifest, id) = (folder.manifest(), folder.manifest().id());
    let count = manifest.objects().count();
    assert!(matches!(run(storage.current("rooms")), Err(ClusterError::NotThere { .. })));

    let told = std::sync::Mutex::new(Vec::new());
    let watch = |done, total| told.lock().expect("alone").push((done, total));
    let first = run(storage.publish(&folder, &watch)).expect("published");
    assert_eq!(
        (first.manifest, first.sent, first.sent_bytes, first.there),
        (id, count, manifest.byte_count(), 0)
    );
    let told = told.into_inner().expect("alone");
    assert_eq!(
        (told[0], told[count]),
        ((0, manifest.byte_count()), (manifest.byte_count(), manifest.byte_count()))
    );
    let again = run(storage.publish(&folder, &nobody)).expect("published");
    assert_eq!((again.sent, again.there, again.there_bytes), (0, count, manifest.byte_count()));

    // By path as by URL.
    let reader = Storage::open(shop.path().join("maps of mine").to_str().expect("text")).expect("a folder");
    assert_eq!(run(reader.current("rooms")).expect("a pointer"), id);
    let fetched = run(fetch_folder(&reader, "rooms", id, to.path(), &nobody)).expect("fetched");
    assert_eq!((fetched.fetched, fetched.there), (count, 0));
    assert_eq!(Folder::open(to.path()).expect("regions").manifest(), manifest);
    for object in manifest.objects() {
        let [a, b] = [&folder, &Folder::open(to.path()).expect("regions")]
            .map(|f| fs::read(f.path_of(&object.sha256)).expect("bytes"));
        assert_eq!(a, b);
    }
    let manifests = [&from, &to].map(|f| fs::read(f.path().join(MANIFEST_FILE)).expect("bytes"));
    assert_eq!(manifests[0], manifests[1]);
    // One that was damaged here is fetched again, and no other.
    let region = Folder::open(to.path()).expect("regions").path_of(&manifest.regions[0].sha256);
    let mut bytes = fs::read(&region).expect("bytes");
    bytes[100] ^= 1;
    fs::write(&region, bytes).expect("damaged");
    let mended = run(fetch_folder(&reader, "rooms", id, to.path(), &nobody)).expect("fetched");
    assert_eq!((mended.fetched, mended.there), (1, count - 1));
}

/// Wherever publishing breaks off, a reader gets the old regions whole or the new ones whole.
#[test]
fn who_reads_meanwhile_finds_all_of_the_old_or_all_of_the_new() {
    let [old, new] = [(); 2].map(|()| tempfile::tempdir().expect("a folder"));
    let (old, new) = (regions(8, old.path()), regions(9, new.path()));
    // Objects of the new that the old does not have, a manifest, a pointer.
    let there: Vec<ObjectId> = old.manifest().objects().map(|object| object.sha256).collect();
    let all = new.manifest().objects().filter(|object| !there.contains(&object.sha256)).count() + 2;
    let mut currents = Vec::new();
    for writes in 0..=all {
        let memory = Arc::new(InMemory::new());
        run(storage(&memory, Fault::None).publish(&old, &nobody)).expect("published");
        let published = run(storage(&memory, Fault::WritesAfter(writes)).publish(&new, &nobody));
        assert_eq!(published.is_ok(), writes == all, "{writes}");
        let reader = storage(&memory, Fault::None);
        let current = run(reader.current("rooms")).expect("a pointer");
        let to = tempfile::tempdir().expect("a folder");
        run(fetch_folder(&reader, "rooms", current, to.path(), &nobody)).expect("all of it is there");
        currents.push(current);
    }
    let (last, before) = currents.split_last().expect("some");
    assert_eq!(*last, new.manifest().id());
    assert!(before.iter().all(|current| *current == old.manifest().id()));
}

#[test]
fn what_passes_is_tried_again_and_what_does_not_is_told() {
    let from = tempfile::tempdir().expect("a folder");
    let folder = regions(8, from.path());
    let id = folder.manifest().id();
    let memory = Arc::new(InMemory::new());
    run(storage(&memory, Fault::First(2)).publish(&folder, &nobody)).expect("at the third attempt");
    for (fault, is_well) in [(Fault::First(2), true), (Fault::First(99), false)] {
        let to = tempfile::tempdir().expect("a folder");
        let reader = storage(&memory, fault);
        let fetched = run(fetch_folder(&reader, "rooms", id, to.path(), &nobody));
        assert_eq!(fetched.is_ok(), is_well, "{fetched:?}");
        assert!(is_well || matches!(fetched, Err(ClusterError::Storage { .. })));
    }
}

#[test]
fn what_is_damaged_is_not_published() {
    let from = tempfile::tempdir().expect("a folder");
    let folder = regions(8, from.path());
    let path = folder.path_of(&folder.manifest().regions[1].sha256);
    let bytes = fs::read(&path).expect("bytes");
    let memory = Arc::new(InMemory::new());
    let storage = storage(&memory, Fault::None);
    let mut wrong = bytes.clone();
    wrong[99] ^= 1;
    for content in [Some(&wrong[..]), Some(&bytes[..50]), None] {
        match content {
            Some(content) => fs::write(&path, content).expect("damaged"),
            None => fs::remove_file(&path).expect("removed"),
        }
        let refused = run(storage.publish(&folder, &nobody)).expect_err("damaged");
        assert!(matches!(refused, ClusterError::Map(_)), "{refused}");
        assert!(refused.to_string().contains(path.to_str().expect("text")), "{refused}");
        assert!(matches!(run(storage.current("rooms")), Err(ClusterError::NotThere { .. })));
    }
    fs::write(&path, &bytes).expect("mended");
    run(storage.publish(&folder, &nobody)).expect("published");
}
