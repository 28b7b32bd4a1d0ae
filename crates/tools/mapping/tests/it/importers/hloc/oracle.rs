//! Reads files as h5py writes them for hloc (`research/oracles/hloc.py`), and files written here.

use std::path::{Path, PathBuf};

use veiloc_descriptor::{DescriptorKind, Encoding};
use veiloc_features::{Extractor, FeatureError, FeatureStore};
use veiloc_geometry::Pixel;
use veiloc_mapping::MappingError;
use veiloc_mapping::importers::hloc::{
    FeaturesFile, GlobalsFile, ImageFeatures, KeypointMatch, MatchesFile, StoredFeatures, Vectors,
    write_features, write_globals, write_matches,
};

const IMAGES: [&str; 3] = ["db/a.jpg", "db/sub/b.jpg", "query.png"];
const COUNT: usize = 5;
const DIM: usize = 8;

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/importers/hloc").join(name)
}

/// The script's formula.
fn number(index: usize, factor: usize, modulus: usize) -> f32 {
    (index * factor % modulus) as f32 / 64.0
}

fn expected(image: &str) -> ImageFeatures {
    let shift = 3 * IMAGES.iter().position(|name| *name == image).expect("one of them");
    let at = |i: usize| f64::from(number(i, 37, 1024)) + shift as f64;
    let value = |row: usize, column: usize| number(column * COUNT + row, 29, 128) - 1.0;
    let rows = (0..COUNT).flat_map(|row| (0..DIM).map(move |column| value(row, column)));
    ImageFeatures {
        // Half a pixel more than in the file.
        keypoints: (0..COUNT).map(|i| Pixel::new(at(2 * i) + 0.5, at(2 * i + 1) + 0.5)).collect(),
        scores: Some((0..COUNT).map(|i| number(i, 11, 64)).collect()),
        descriptors: Vectors { dim: DIM, values: rows.collect() },
        image_size: Some((640, 480 + shift as u32)),
        uncertainty: Some(1.5),
    }
}

#[test]
fn features_match_h5py_in_every_layout() {
    for name in ["feats-half.h5", "feats-single-packed.h5", "feats-double-v114.h5"] {
        let file = FeaturesFile::open(&data(name)).expect("a file");
        assert_eq!(file.names().expect("names"), IMAGES, "{name}");
        assert_eq!(file.dim().expect("descriptors"), Some(DIM));
        for image in IMAGES {
            let (read, expected) = (file.read(image).expect("features"), expected(image));
            assert_eq!(read.keypoints, expected.keypoints, "{name} {image}");
            assert_eq!(read.descriptors.values, expected.descriptors.values, "{name} {image}");
            assert!(read == expected, "{name} {image}");
        }
        assert!(matches!(file.read("db/c.jpg"), Err(MappingError::MissingInFile { .. })));
        assert!(matches!(file.read("db"), Err(MappingError::MissingInFile { .. })));
        assert!(!file.holds("../query.png") && !file.holds("/query.png") && !file.holds(""));
    }
}

/// HDF5 2.0 has its own chunk packing in its latest format; hloc does not use it.
#[test]
fn unsupported_chunk_format_is_reported() {
    let file = FeaturesFile::open(&data("feats-packed-latest.h5")).expect("a file");
    match file.read(IMAGES[0]) {
        Ok(read) => assert!(read == expected(IMAGES[0])),
        Err(error) => assert!(error.to_string().contains("libver"), "{error}"),
    }
}

#[test]
fn written_files_round_trip() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("feats.h5");
    write_features(&path, IMAGES.map(|image| (image.to_owned(), expected(image)))).expect("written");
    let file = FeaturesFile::open(&path).expect("a file");
    assert_eq!(file.names().expect("names"), IMAGES);
    for image in IMAGES {
        assert!(file.read(image).expect("features") == expected(image), "{image}");
    }
    let twice = [("a.jpg".to_owned(), expected(IMAGES[0])), ("a.jpg".to_owned(), expected(IMAGES[1]))];
    assert!(matches!(write_features(&path, twice), Err(MappingError::Unwritable { .. })));
    let within = [("a".to_owned(), expected(IMAGES[0])), ("a/b".to_owned(), expected(IMAGES[1]))];
    assert!(matches!(write_features(&path, within), Err(MappingError::Unwritable { .. })));
    let empty = ImageFeatures {
        keypoints: Vec::new(),
        scores: Some(Vec::new()),
        descriptors: Vectors { dim: DIM, values: Vec::new() },
        image_size: Some((640, 480)),
        uncertainty: None,
    };
    write_features(&path, [("empty.jpg".to_owned(), empty.clone())]).expect("written");
    assert!(FeaturesFile::open(&path).expect("a file").read("empty.jpg").expect("features") == empty);
}

#[test]
fn matches_are_found_under_either_name_and_order() {
    let file = MatchesFile::open(&data("matches.h5")).expect("a file");
    let found = |first, second, score| KeypointMatch { first, second, score };
    let matches = file.read("query.png", "db/a.jpg").expect("readable");
    assert_eq!(matches.expect("a pair"), [found(0, 3, 0.5), found(2, 0, 0.25), found(4, 4, 1.0)]);
    let turned = file.read("db/a.jpg", "query.png").expect("readable");
    assert_eq!(turned.expect("a pair"), [found(3, 0, 0.5), found(0, 2, 0.25), found(4, 4, 1.0)]);
    let old = file.read("db/sub/b.jpg", "query.png").expect("readable");
    assert_eq!(old.expect("a pair"), [found(2, 1, 1.0)]);
    assert_eq!(file.read("query.png", "db/c.jpg").expect("readable"), None);

    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("matches.h5");
    let written = vec![found(1, 70_000, 0.5), found(3, 0, 1.0)];
    write_matches(&path, [("db/a.jpg", "db/b.jpg", 4, written.clone())]).expect("written");
    let again = MatchesFile::open(&path).expect("a file").read("db/a.jpg", "db/b.jpg").expect("readable");
    assert_eq!(again.expect("a pair"), written);
    assert!(write_matches(&path, [("a", "b", 1, written)]).is_err());
}

#[test]
fn global_descriptors_are_vectors() {
    let file = GlobalsFile::open(&data("globals.h5")).expect("a file");
    assert_eq!(file.names().expect("names"), IMAGES);
    for (i, image) in IMAGES.iter().enumerate() {
        let expected: Vec<f32> = (0..16).map(|k| number(k, 13, 64) + i as f32).collect();
        assert_eq!(file.read(image).expect("a vector"), expected);
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("globals.h5");
    write_globals(&path, [("db/a.jpg".to_owned(), vec![0.5, -0.25])]).expect("written");
    assert_eq!(GlobalsFile::open(&path).expect("a file").read("db/a.jpg").expect("a vector"), [0.5, -0.25]);
}

#[test]
fn stored_features_match_path_suffix() {
    let stored = StoredFeatures::open(&data("feats-half.h5"), "mine", None).expect("a file");
    let kind = DescriptorKind::new("mine", DIM, Encoding::Signed, 91).expect("a kind");
    assert_eq!(stored.kind(), kind);
    let lookup = stored.stored().expect("stored features");
    let features = lookup.features(Path::new("/data/images/db/a.jpg"), (640, 480)).expect("features");
    assert_eq!(features.keypoints.len(), COUNT);
    assert!(features.keypoints.windows(2).all(|pair| pair[0].response >= pair[1].response));
    // The strongest has the largest score.
    let expected = expected("db/a.jpg");
    let scores = expected.scores.expect("scores");
    let best = (0..COUNT).max_by(|a, b| scores[*a].total_cmp(&scores[*b])).expect("some");
    assert_eq!(features.keypoints[0].pixel, expected.keypoints[best]);

    for (path, size, word) in [
        ("/data/images/db/c.jpg", (640, 480), "has no features of"),
        ("/data/images/db/a.jpg", (320, 240), "640x480"),
    ] {
        let Err(FeatureError::Extractor { reason, .. }) = lookup.features(Path::new(path), size) else {
            panic!("{path} was taken");
        };
        assert!(reason.contains(word), "{reason}");
    }
    let compact = StoredFeatures::open(&data("feats-half.h5"), "compact", Some(DescriptorKind::COMPACT));
    assert!(compact.is_err_and(|e| e.to_string().contains("--features")));
    assert!(StoredFeatures::open(&data("feats-half.h5"), "No Name", None).is_err());
    assert!(StoredFeatures::open(&data("globals.h5"), "mine", None).is_err());
}

/// Which features images of a folder get: the number of their keypoints, or a part of the message.
fn names_found(held: &[(&str, usize)], images: &[&str], expected: &[Result<usize, &str>]) {
    let place = tempfile::tempdir().expect("a folder");
    let folder = place.path().join("images");
    let features = |count: usize| ImageFeatures {
        keypoints: (0..count).map(|i| Pixel::new(i as f64, 0.5)).collect(),
        scores: None,
        descriptors: Vectors { dim: 2, values: [1.0, 0.0].repeat(count) },
        image_size: None,
        uncertainty: None,
    };
    let path = place.path().join("f.h5");
    write_features(&path, held.iter().map(|(name, count)| (name.to_string(), features(*count))))
        .expect("written");
    for name in images {
        let file = folder.join(name);
        std::fs::create_dir_all(file.parent().expect("a folder")).expect("a folder");
        std::fs::write(file, "an image").expect("written");
    }
    let alone = StoredFeatures::open(&path, "mine", None).expect("a file");
    let together = alone.stored().and_then(|own| own.of_images(&folder, images)).expect("names matter");
    for (name, expected) in images.iter().zip(expected) {
        let found = together.stored().expect("stored").features(&folder.join(name), (640, 480));
        match (found, expected) {
            (Ok(found), Ok(count)) => assert_eq!(found.keypoints.len(), *count, "{name} of {images:?}"),
            (Err(error), Err(part)) => assert!(error.to_string().contains(part), "{error}"),
            (found, _) => panic!("{name} of {images:?}: {:?}", found.map(|f| f.keypoints.len())),
        }
        // A single image has no other names to compare with; the longest end of its path counts.
        let ends = held.iter().filter(|(own, _)| folder.join(name).ends_with(own));
        if let (Ok(found), Some(longest)) =
            (alone.features(&folder.join(name), (640, 480)), ends.max_by_key(|(own, _)| own.len()))
        {
            assert_eq!(found.keypoints.len(), longest.1, "{name}");
        }
    }
}

#[test]
fn no_image_gets_the_features_of_another() {
    names_found(&[("a.jpg", 1), ("cam1/a.jpg", 2)], &["a.jpg", "cam1/a.jpg"], &[Ok(1), Ok(2)]);
    let missing = Err("may be those of a.jpg");
    names_found(&[("a.jpg", 1)], &["a.jpg", "cam1/a.jpg"], &[Ok(1), missing]);
    let either = [Err("may be those of cam1/a.jpg"), Err("may be those of cam0/a.jpg")];
    names_found(&[("a.jpg", 1)], &["cam0/a.jpg", "cam1/a.jpg"], &either);
    names_found(&[("a.jpg", 1), ("cam1/a.jpg", 2)], &["cam0/a.jpg", "cam1/a.jpg"], &[Ok(1), Ok(2)]);
    // Names with more or fewer folders than the image's name, for one image only.
    names_found(&[("a.jpg", 1), ("b.jpg", 2)], &["db/a.jpg", "db/b.jpg"], &[Ok(1), Ok(2)]);
    names_found(&[("images/a.jpg", 1), ("images/b.jpg", 2)], &["a.jpg", "b.jpg"], &[Ok(1), Ok(2)]);
    names_found(&[("b.jpg", 1)], &["a.jpg", "b.jpg"], &[Err("has no features"), Ok(1)]);
    names_found(&[("K\u{fc}che/a.jpg", 3)], &["Ku\u{308}che/a.jpg"], &[Ok(3)]);
}

/// Without a list, the features of a file in a folder above are not taken either.
#[test]
fn single_image_does_not_get_the_features_of_a_file_above() {
    let place = tempfile::tempdir().expect("a folder");
    std::fs::create_dir_all(place.path().join("db/sub")).expect("folders");
    for name in ["db/a.jpg", "db/sub/db/a.jpg"] {
        let file = place.path().join(name);
        std::fs::create_dir_all(file.parent().expect("a folder")).expect("a folder");
        std::fs::write(file, "an image").expect("written");
    }
    let stored = StoredFeatures::open(&data("feats-half.h5"), "mine", None).expect("a file");
    assert!(stored.features(&place.path().join("db/a.jpg"), (640, 480)).is_ok());
    let error = stored.features(&place.path().join("db/sub/db/a.jpg"), (640, 480)).expect_err("of db/a.jpg");
    assert!(error.to_string().contains("may be those of"), "{error}");
}

/// Features written here are read back to the same bytes.
#[test]
fn descriptor_bytes_round_trip() {
    let kind = DescriptorKind::XFEAT;
    let bytes: Vec<u8> = (0..4 * 64_u32).map(|i| (128 + (i * 97 % 61)) as u8 - 30).collect();
    let descriptors = veiloc_descriptor::Descriptors::new(kind, bytes).expect("rows");
    let keypoint = |i: u8| veiloc_features::Keypoint {
        pixel: Pixel::new(f64::from(i) * 3.25 + 0.5, 7.5),
        scale: 1.0,
        orientation: 0.0,
        response: 1.0 - f32::from(i) / 8.0,
    };
    let features =
        veiloc_features::Features { keypoints: (0..4).map(keypoint).collect(), descriptors, global: None };
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("feats.h5");
    let lengths: Vec<f64> = (0..4)
        .map(|i| {
            features.descriptors.view().values(i).map(|v| f64::from(v).powi(2)).sum::<f64>().sqrt() / 256.0
        })
        .collect();
    assert!(lengths.iter().all(|length| (0.5..1.1).contains(length)), "{lengths:?}");
    write_features(&path, [("a.png".to_owned(), ImageFeatures::of(&features, (64, 48)))]).expect("written");
    let back = FeaturesFile::open(&path).expect("a file").read("a.png").expect("features");
    let back = back.features(kind, 1.0).expect("of the kind");
    assert_eq!(back.keypoints, features.keypoints);
    let whole = lengths.iter().all(|length| (0.9..1.1).contains(length));
    assert!(!whole || back.descriptors.as_bytes() == features.descriptors.as_bytes());
}
