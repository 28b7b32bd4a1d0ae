//! Any bytes where a map file or a COLMAP model is expected: an error, or something that holds together and can be
//! written and read again. The same as `fuzz/`, for every run of the tests.

use std::cell::Cell;
use std::fs;
use std::path::Path;

use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use veiloc_map::MapFile;
use veiloc_map::colmap::{ColmapImage, read_model, write_text};

const FILES: [&str; 3] = ["cameras", "images", "points3D"];

/// A small model that is right, as text.
const TEXT: [&str; 3] = [
    "# comment\n1 SIMPLE_RADIAL 640 480 500 320 240 0.01\n7 PINHOLE 100 50 90 91 50 25\n",
    "1 1 0 0 0 0.5 -1 2 1 a b.jpg\n10.5 20.25 3 30 40 -1\n4 0.5 0.5 0.5 0.5 0 0 1 7 c.jpg\n5 6 3\n",
    "3 0.5 1.5 4 10 20 30 0.25 1 0 4 0\n",
];

/// The images with the poses of `others` where they are the same: a rotation is kept as a matrix and written as a
/// quaternion, and turning one into the other may cost the last bits.
fn poses_aside(images: &[ColmapImage], others: &[ColmapImage]) -> Vec<ColmapImage> {
    let mut images = images.to_vec();
    for (image, other) in images.iter_mut().zip(others) {
        let (ours, theirs) = (image.cam_from_world, other.cam_from_world);
        if ours.translation() == theirs.translation() && ours.rotation_error_degrees(&theirs) < 1e-12 {
            image.cam_from_world = theirs;
        }
    }
    images
}

fn holds_together(folder: &Path) -> Result<bool, TestCaseError> {
    let Ok(model) = read_model(folder) else { return Ok(false) };
    let text = folder.join("again");
    prop_assert!(write_text(&model, &text).is_ok());
    let again = read_model(&text);
    prop_assert!(again.is_ok(), "what is written can be read: {:?}", again.err());
    let again = again.expect("checked");
    prop_assert_eq!(poses_aside(again.images(), model.images()), model.images());
    prop_assert_eq!(again.points(), model.points());
    Ok(true)
}

fn write_model(folder: &Path, extension: &str, files: &[Vec<u8>; 3]) {
    for (name, bytes) in FILES.iter().zip(files) {
        fs::write(folder.join(format!("{name}.{extension}")), bytes).expect("written");
    }
}

#[test]
fn the_model_the_others_are_made_from_is_right() {
    let folder = tempfile::tempdir().expect("temporary folder");
    write_model(folder.path(), "txt", &TEXT.map(|text| text.as_bytes().to_vec()));
    assert!(holds_together(folder.path()).expect("holds together"));
    assert_eq!(read_model(folder.path()).expect("a model").images().len(), 2);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_bytes_are_refused_or_hold_together(
        files in prop::array::uniform3(prop::collection::vec(any::<u8>(), 0..120)),
        binary: bool,
        count in 0..3_u64,
    ) {
        let mut files = files;
        if binary {
            // A number of records that is believable, so that more than the first eight bytes are read.
            for file in &mut files {
                file.splice(..file.len().min(8), count.to_le_bytes());
            }
        }
        let folder = tempfile::tempdir().expect("temporary folder");
        write_model(folder.path(), if binary { "bin" } else { "txt" }, &files);
        holds_together(folder.path())?;
        let path = folder.path().join("m.vmap");
        fs::write(&path, files.concat()).expect("written");
        prop_assert!(MapFile::open(&path).is_err());
    }
}

/// Both answers come up: damage in a comment or a number leaves a model.
#[test]
fn damaged_text_is_refused_or_holds_together() {
    let edit = (0..3_usize, any::<prop::sample::Index>(), "[-0-9eE. \nA-Z_#naif]{0,3}");
    let [models, refused] = [const { Cell::new(0) }; 2];
    let holds = |edits: Vec<(usize, prop::sample::Index, String)>| {
        let mut files = TEXT.map(|text| text.as_bytes().to_vec());
        for (file, at, new) in edits {
            let at = at.index(files[file].len());
            files[file].splice(at..=at, new.bytes());
            files[file].push(b'\n');
        }
        let folder = tempfile::tempdir().expect("temporary folder");
        write_model(folder.path(), "txt", &files);
        let answers = if holds_together(folder.path())? { &models } else { &refused };
        answers.set(answers.get() + 1);
        Ok(())
    };
    let config = ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() };
    TestRunner::new(config).run(&prop::collection::vec(edit, 1..4), holds).unwrap();
    // One in fifteen or more is a model, so that none at all does not happen by chance.
    assert!(models.get() > 0 && refused.get() > 0, "{} models, {} refused", models.get(), refused.get());
}
