//! Cutting a map: every image in one core, regions of bounded size, rooms separated, deterministic output.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use proptest::prelude::*;
use veiloc_descriptor::GlobalDescriptor;
use veiloc_map::regions::{
    FolderWriter, MANIFEST_FILE, Manifest, OBJECTS_FOLDER, ObjectId, RegionFolder, SplitOptions, cut,
    verify_file,
};
use veiloc_map::{GravityDirection, ManifestError, MapError, MapFile, MapMemory, MapModel, Region};
use veiloc_protocol::MapCoordinates;
use veiloc_testing::rooms;

fn file(model: &MapModel) -> MapFile {
    MapFile::of_model(model).expect("a map")
}

fn options(images: usize, overlap: f64) -> SplitOptions {
    SplitOptions::default().with_images(images).with_overlap(overlap)
}

fn write(map: &MapFile, name: &str, options: &SplitOptions, folder: &Path) -> Manifest {
    let regions = cut(map, options).expect("regions");
    let writer = FolderWriter::begin(map, name, folder).expect("a folder");
    let entries = regions.iter().map(|region| writer.region(region).expect("a region")).collect();
    writer.finish(&regions, entries).expect("a manifest")
}

/// Each image in one core, and no region above the limit.
fn holds(map: &MapFile, regions: &[Region], images: usize) {
    let mut cores: Vec<u32> = regions
        .iter()
        .flat_map(|region| region.of_images.iter().filter(|image| image.is_core).map(|image| image.whole))
        .collect();
    cores.sort_unstable();
    assert_eq!(cores, (0..map.image_count() as u32).collect::<Vec<_>>());
    for region in regions {
        assert!(region.of_images.len() <= images && region.core_count() > 0);
        assert!(region.of_images.is_sorted_by(|a, b| a.whole < b.whole));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_image_is_in_one_core(count in 1..4_u32, images in 1..30_u32, most in 1..40_usize, overlap in 0.0..0.9) {
        let map = file(&rooms(count, images));
        let regions = cut(&map, &options(most, overlap)).expect("regions");
        holds(&map, &regions, most);
        prop_assert_eq!(&cut(&map, &options(most, overlap)).expect("regions"), &regions);
    }
}

#[test]
fn similar_rooms_are_separated() {
    let map = file(&rooms(3, 16));
    let regions = cut(&map, &options(20, 0.2)).expect("regions");
    assert_eq!(regions.len(), 3);
    for region in &regions {
        let rooms: BTreeSet<u32> = region.of_images.iter().map(|image| image.whole / 16).collect();
        assert_eq!((rooms.len(), region.core_count()), (1, 16));
    }
}

#[test]
fn overlap_has_the_neighbours_of_the_core() {
    let map = file(&rooms(1, 40));
    let regions = cut(&map, &options(20, 0.3)).expect("regions");
    holds(&map, &regions, 20);
    assert_eq!(regions.len(), 3);
    for region in &regions {
        let core: Vec<u32> = region.of_images.iter().filter(|i| i.is_core).map(|i| i.whole).collect();
        let (first, last) = (core[0], core[core.len() - 1]);
        assert_eq!((last - first) as usize, core.len() - 1, "a core is contiguous: {core:?}");
        let beside: Vec<u32> = region.of_images.iter().filter(|i| !i.is_core).map(|i| i.whole).collect();
        assert!(!beside.is_empty());
        // Images share points with five on each side.
        assert!(
            beside.iter().all(|i| i.abs_diff(first) <= 6 || i.abs_diff(last) <= 6),
            "{core:?} {beside:?}"
        );
    }
}

#[test]
fn small_map_is_one_region() {
    let map = file(&rooms(1, 20));
    let regions = cut(&map, &options(20, 0.3)).expect("regions");
    assert_eq!((regions.len(), regions[0].core_count()), (1, 20));
}

#[test]
fn invalid_cuts_are_refused() {
    let map = file(&rooms(1, 8));
    for wrong in [options(0, 0.3), options(5, -0.1), options(5, 0.91), options(5, f64::NAN)] {
        assert!(matches!(cut(&map, &wrong), Err(MapError::Cut { .. })), "{wrong:?}");
    }
    let regions = cut(&map, &options(4, 0.3)).expect("regions");
    let region = file(&map.region(regions[0].clone()).expect("a region"));
    assert!(cut(&region, &options(2, 0.3)).unwrap_err().to_string().contains("cut the whole map"));
    let mut empty = rooms(1, 1);
    (empty.images, empty.points) = (Vec::new(), Vec::new());
    assert!(cut(&file(&empty), &options(4, 0.3)).unwrap_err().to_string().contains("no images"));
}

#[test]
fn folder_has_exactly_the_named_objects() {
    let map = file(&rooms(2, 15));
    let folder = tempfile::tempdir().expect("a folder");
    let first = write(&map, "rooms", &options(10, 0.3), folder.path());
    let names = || -> BTreeSet<String> {
        let entries = fs::read_dir(folder.path().join(OBJECTS_FOLDER)).expect("objects");
        entries.map(|e| e.expect("an entry").file_name().into_string().expect("digits")).collect()
    };
    let named = |manifest: &Manifest| -> BTreeSet<String> {
        manifest.objects().map(|object| object.sha256.to_string()).collect()
    };
    assert_eq!(names(), named(&first));
    let open = RegionFolder::open(folder.path()).expect("regions");
    assert_eq!(open.manifest(), &first);
    for object in first.objects() {
        verify_file(&open.path_of(&object.sha256), &object).expect("its content");
    }
    let down = GravityDirection::new([0.0, -1.0, 0.0]).ok();
    let metric = file(&MapModel { is_metric: true, down, ..rooms(2, 15) });
    let other = tempfile::tempdir().expect("a folder");
    assert_eq!(first.coordinates(), MapCoordinates::default());
    let of_metric = write(&metric, "rooms", &options(10, 0.3), other.path()).coordinates();
    assert_eq!(of_metric, MapCoordinates { metres_per_unit: Some(1.0), down: Some([0.0, -1.0, 0.0]) });
    // Cut again with other options: only shared objects remain, and foreign files stay.
    fs::write(folder.path().join(OBJECTS_FOLDER).join("notes"), "mine").expect("a file");
    let second = write(&map, "rooms", &options(12, 0.0), folder.path());
    assert_ne!(first.id(), second.id());
    let mut expected = named(&second);
    expected.insert("notes".to_owned());
    assert_eq!(names(), expected);
}

#[test]
fn equal_maps_have_equal_bytes() {
    let [one, two] = [tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder")];
    let manifests =
        [&one, &two].map(|folder| write(&file(&rooms(2, 15)), "rooms", &options(10, 0.3), folder.path()));
    assert_eq!(manifests[0], manifests[1]);
    let bytes = [&one, &two].map(|folder| fs::read(folder.path().join(MANIFEST_FILE)).expect("a manifest"));
    assert_eq!(bytes[0], bytes[1]);
    assert_eq!(ObjectId::of(&bytes[0]), manifests[0].id());
}

#[test]
fn regions_and_index_agree() {
    let map = file(&rooms(2, 15));
    let folder = tempfile::tempdir().expect("a folder");
    let regions = cut(&map, &options(10, 0.3)).expect("regions");
    write(&map, "rooms", &options(10, 0.3), folder.path());
    let open = RegionFolder::open(folder.path()).expect("regions");
    for memory in [MapMemory::Copied, MapMemory::Mapped] {
        let index = open.open_index(memory).expect("an index");
        assert_eq!((index.image_count(), index.region_count()), (30, regions.len()));
        for (number, region) in regions.iter().enumerate() {
            assert_eq!(open.open_region(number, memory).expect("a region").part_of(), Some(region));
            for image in &region.of_images {
                let whole = image.whole as usize;
                let is_beside = index.beside(whole).any(|other| other == number);
                assert_eq!((index.core_of(whole) == number, is_beside), (image.is_core, !image.is_core));
            }
        }
        let held: usize = (0..30).map(|image| 1 + index.beside(image).len()).sum();
        assert_eq!(held, regions.iter().map(|region| region.of_images.len()).sum::<usize>());
        for image in 0..30 {
            assert_eq!(index.global(image), map.image(image).global());
        }
    }
    assert!(matches!(open.open_region(regions.len(), MapMemory::Copied), Err(MapError::Mismatch { .. })));
}

#[test]
fn ranking_follows_retrieval_in_the_whole_map() {
    let map = file(&rooms(1, 30));
    let folder = tempfile::tempdir().expect("a folder");
    write(&map, "rooms", &options(10, 0.3), folder.path());
    let open = RegionFolder::open(folder.path()).expect("regions");
    let index = open.open_index(MapMemory::Copied).expect("an index");
    for image in [0, 14, 29] {
        let query = GlobalDescriptor::new(map.image(image).global().to_vec());
        let best = index.retrieve(&query, 6);
        assert_eq!(best[0].0, image);
        let mut all: Vec<(usize, f32)> =
            map.images().enumerate().map(|(i, view)| (i, query.similarity(view.global()))).collect();
        all.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        assert_eq!(best, all[..6]);
        assert_eq!(index.retrieve(&query, 99), all);
        let ranked = index.rank(&query, 6);
        for entry in &ranked {
            let region = open.open_region(entry.region, MapMemory::Copied).expect("a region");
            let holds = |image: usize| {
                let part = region.part_of().expect("a region");
                part.of_images.iter().any(|own| own.whole as usize == image)
            };
            let held: Vec<f32> = best.iter().filter(|(i, _)| holds(*i)).map(|(_, s)| *s).collect();
            assert_eq!((entry.held, entry.similarity), (held.len(), held[0]));
        }
        assert!(ranked.is_sorted_by(|a, b| a.held >= b.held));
    }
    assert!(index.rank(&GlobalDescriptor::new(Vec::new()), 0).is_empty());
    assert_eq!(index.rank(&GlobalDescriptor::new(vec![1]), 3).len(), 1, "unlike all: the first three");
}

#[test]
fn mismatched_objects_are_refused() {
    let map = file(&rooms(2, 15));
    let folder = tempfile::tempdir().expect("a folder");
    let manifest = write(&map, "rooms", &options(10, 0.3), folder.path());
    let open = RegionFolder::open(folder.path()).expect("regions");
    let path = |number: usize| open.path_of(&manifest.regions[number].sha256);
    let good = fs::read(path(0)).expect("bytes");
    let refused = |number| open.open_region(number, MapMemory::Copied).expect_err("another file");
    // Another region, a map that is no region, and a file that is no map.
    fs::copy(path(1), path(0)).expect("a copy");
    assert!(matches!(verify_file(&path(0), &manifest.regions[0].object()), Err(MapError::Object { .. })));
    if manifest.regions[0].images != manifest.regions[1].images
        || manifest.regions[0].points != manifest.regions[1].points
    {
        assert!(matches!(refused(0), MapError::Mismatch { .. }));
    }
    fs::write(path(0), map.as_bytes()).expect("written");
    assert!(refused(0).to_string().contains("no region"));
    fs::write(path(0), b"nothing").expect("written");
    assert!(matches!(refused(0), MapError::Length { .. } | MapError::NotAMap { .. }));
    fs::write(path(0), good).expect("written");
    open.open_region(0, MapMemory::Copied).expect("as it was");

    let other = tempfile::tempdir().expect("a folder");
    let of_other = write(&file(&rooms(1, 15)), "rooms", &options(10, 0.3), other.path());
    let index = other.path().join(OBJECTS_FOLDER).join(of_other.index.sha256.to_string());
    fs::copy(index, open.path_of(&manifest.index.sha256)).expect("a copy");
    assert!(matches!(open.open_index(MapMemory::Copied), Err(MapError::Mismatch { .. })));

    assert!(matches!(FolderWriter::begin(&map, "../x", folder.path()), Err(MapError::Name { .. })));
    let empty = tempfile::tempdir().expect("a folder");
    assert!(matches!(RegionFolder::open(empty.path()), Err(MapError::NoRegions { .. })));
    fs::write(empty.path().join(MANIFEST_FILE), b"{}").expect("written");
    let wrong = RegionFolder::open(empty.path()).expect_err("no manifest");
    assert!(matches!(wrong, MapError::Manifest { source: ManifestError::Json(_), .. }), "{wrong}");
}
