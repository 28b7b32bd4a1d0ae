//! Arbitrary bytes as a map file or a COLMAP model: an error, or a consistent result that can be written and read
//! again. The same properties as in `fuzz/`, in every test run.

use std::cell::Cell;
use std::fs;
use std::path::Path;

use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use veiloc_map::MapFile;
use veiloc_map::colmap::{ColmapImage, read_model, write_text};

const FILES: [&str; 3] = ["cameras", "images", "points3D"];

/// A small valid model as text.
const TEXT: [&str; 3] = [
    "# comment\n1 SIMPLE_RADIAL 640 480 500 320 240 0.01\n7 PINHOLE 100 50 90 91 50 25\n",
    "1 1 0 0 0 0.5 -1 2 1 a b.jpg\n10.5 20.25 3 30 40 -1\n4 0.5 0.5 0.5 0.5 0 0 1 7 c.jpg\n5 6 3\n",
    "3 0.5 1.5 4 10 20 30 0.25 1 0 4 0\n",
];

/// The images, with the poses of `others` where they agree: converting a rotation matrix to a quaternion and back may
/// change the last bits.
fn with_poses_of(images: &[ColmapImage], others: &[ColmapImage]) -> Vec<ColmapImage> {
    let mut images = images.to_vec();
    for (image, other) in images.iter_mut().zip(others) {
        let (ours, theirs) = (image.cam_from_world, other.cam_from_world);
        if ours.translation() == theirs.translation() && ours.rotation_error_degrees(&theirs) < 1e-12 {
            image.cam_from_world = theirs;
        }
    }
    images
}

fn is_consistent(folder: &Path) -> Result<bool, TestCaseError> {
    let Ok(model) = read_model(folder) else { return Ok(false) };
    let text = folder.join("again");
    prop_assert!(write_text(&model, &text).is_ok());
    let again = read_model(&text);
    prop_assert!(again.is_ok(), "what is written can be read: {:?}", again.err());
    let again = again.expect("checked");
    prop_assert_eq!(with_poses_of(again.images(), model.images()), model.images());
    prop_assert_eq!(again.points(), model.points());
    Ok(true)
}

fn write_model(folder: &Path, extension: &str, files: &[Vec<u8>; 3]) {
    for (name, bytes) in FILES.iter().zip(files) {
        fs::write(folder.join(format!("{name}.{extension}")), bytes).expect("written");
    }
}

#[test]
fn the_base_model_is_valid() {
    let folder = tempfile::tempdir().expect("temporary folder");
    write_model(folder.path(), "txt", &TEXT.map(|text| text.as_bytes().to_vec()));
    assert!(is_consistent(folder.path()).expect("holds together"));
    assert_eq!(read_model(folder.path()).expect("a model").images().len(), 2);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn arbitrary_bytes_are_refused_or_consistent(
        files in prop::array::uniform3(prop::collection::vec(any::<u8>(), 0..120)),
        binary: bool,
        count in 0..3_u64,
    ) {
        let mut files = files;
        if binary {
            // A plausible number of records, so that more than the first eight bytes are read.
            for file in &mut files {
                file.splice(..file.len().min(8), count.to_le_bytes());
            }
        }
        let folder = tempfile::tempdir().expect("temporary folder");
        write_model(folder.path(), if binary { "bin" } else { "txt" }, &files);
        is_consistent(folder.path())?;
        let path = folder.path().join("m.vmap");
        fs::write(&path, files.concat()).expect("written");
        prop_assert!(MapFile::open(&path).is_err());
    }
}

/// Both results occur: damage in a comment or a number leaves a valid model.
#[test]
fn damaged_text_is_refused_or_consistent() {
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
        let answers = if is_consistent(folder.path())? { &models } else { &refused };
        answers.set(answers.get() + 1);
        Ok(())
    };
    let config = ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() };
    TestRunner::new(config).run(&prop::collection::vec(edit, 1..4), holds).unwrap();
    // At least one in fifteen is a valid model, so zero cannot occur by chance.
    assert!(models.get() > 0 && refused.get() > 0, "{} models, {} refused", models.get(), refused.get());
}
