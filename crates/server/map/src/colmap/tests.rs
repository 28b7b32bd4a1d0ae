//! Tests of COLMAP models: round trip, agreement of text and binary, and invalid input of every kind.

use std::fs;
use std::path::{Path, PathBuf};

use veiloc_testdata::real_data_test;

use super::{ColmapFrame, ColmapModel, read_model, read_posed, write_binary, write_text};
use crate::{MapError, PosedImages};

/// Written by pycolmap, see `research/oracles/colmap.py`: the same model as text and as binary.
fn fixture(format: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data/colmap").join(format)
}

const CAMERAS: &str =
    "# comment\n1 PINHOLE 640 480 500 500 320 240\n\n7 SIMPLE_RADIAL 640 480 500 320 240 -0.01\n";
const IMAGES: &str = "# comment\n1 1 0 0 0 0 0 0 1 a.jpg\n10 20 5 30 40 -1\n2 1 0 0 0 0.5 0 0 7 sub dir/b c.jpg\n11 22 5\n\
                      3 1 0 0 0 0.5 0 0 1 d.jpg\n\n";
const POINTS: &str = "# comment\n5 0.1 0.2 3 10 20 30 0.25 1 0 2 0\n";

fn read(cameras: &str, images: &str, points: &str) -> Result<ColmapModel, MapError> {
    let dir = tempfile::tempdir().unwrap();
    for (name, content) in [("cameras.txt", cameras), ("images.txt", images), ("points3D.txt", points)] {
        fs::write(dir.path().join(name), content).unwrap();
    }
    read_model(dir.path())
}

#[test]
fn text_model_is_read() {
    let model = read(CAMERAS, IMAGES, POINTS).unwrap();
    assert_eq!(model.cameras().keys().copied().collect::<Vec<_>>(), [1, 7]);
    assert_eq!(model.image_names(), ["a.jpg", "sub dir/b c.jpg", "d.jpg"]);
    let b = model.image_by_name("sub dir/b c.jpg").unwrap();
    assert_eq!((b.id, b.points2d.len(), b.points2d[0].point), (2, 1, Some(5)));
    assert_eq!(model.camera_of(b).model.name(), "SIMPLE_RADIAL");
    assert!(model.image_by_id(3).unwrap().points2d.is_empty());
    let point = &model.points()[0];
    assert_eq!((point.id, point.color, point.error), (5, [10, 20, 30], 0.25));
    assert_eq!(point.track, [(1, 0), (2, 0)]);
}

#[test]
fn line_endings_and_a_missing_last_line_are_accepted() {
    let dos = |text: &str| text.replace('\n', "\r\n");
    let model = read(CAMERAS, IMAGES, POINTS).unwrap();
    assert_eq!(read(&dos(CAMERAS), &dos(IMAGES), &dos(POINTS)).unwrap(), model);
    assert_eq!(read(CAMERAS, IMAGES.trim_end(), POINTS.trim_end()).unwrap(), model);
    let empty = read("", "# nothing\n", "").unwrap();
    assert!(empty.images().is_empty());
}

#[test]
fn pycolmap_text_and_binary_models_are_equal() {
    let (text, binary) = (read_model(&fixture("text")).unwrap(), read_model(&fixture("binary")).unwrap());
    assert_eq!(binary.cameras(), text.cameras());
    assert_eq!(binary.images().len(), 4);
    let sorted = |model: &ColmapModel| {
        let mut points = model.points().to_vec();
        points.sort_by_key(|p| p.id);
        points
    };
    assert_eq!(sorted(&binary), sorted(&text));
    for image in text.images() {
        let other = binary.image_by_name(&image.name).unwrap();
        assert!(image.cam_from_world.rotation_error_degrees(&other.cam_from_world) < 1e-10);
        assert!(image.cam_from_world.translation_error(&other.cam_from_world) < 1e-10);
        assert_eq!(
            (image.id, image.camera_id, &image.points2d),
            (other.id, other.camera_id, &other.points2d)
        );
    }
}

#[test]
fn written_models_round_trip() {
    for model in [read_model(&fixture("binary")).unwrap(), read(CAMERAS, IMAGES, POINTS).unwrap()] {
        for write in [write_text, write_binary] {
            let dir = tempfile::tempdir().unwrap();
            write(&model, &dir.path().join("new")).unwrap();
            // Write a second time, over the existing files.
            write(&model, &dir.path().join("new")).unwrap();
            let back = read_model(&dir.path().join("new")).unwrap();
            assert_eq!((back.cameras(), back.points()), (model.cameras(), model.points()));
            for (a, b) in back.images().iter().zip(model.images()) {
                assert_eq!(
                    (a.id, &a.name, a.camera_id, &a.points2d),
                    (b.id, &b.name, b.camera_id, &b.points2d)
                );
                assert!(a.cam_from_world.rotation_error_degrees(&b.cam_from_world) < 1e-10);
                assert_eq!(a.cam_from_world.translation(), b.cam_from_world.translation());
            }
        }
    }
}

#[test]
fn binary_files_equal_those_of_pycolmap() {
    let dir = tempfile::tempdir().unwrap();
    write_binary(&read_model(&fixture("binary")).unwrap(), dir.path()).unwrap();
    for name in ["cameras.bin", "images.bin", "points3D.bin"] {
        let (ours, theirs) =
            (fs::read(dir.path().join(name)).unwrap(), fs::read(fixture("binary").join(name)).unwrap());
        assert_eq!(ours.len(), theirs.len(), "{name}");
        // Quaternions are recomputed from rotations, so their last digits may differ.
        if name != "images.bin" {
            assert!(ours == theirs, "{name}");
        }
    }
}

#[test]
fn text_is_not_written_next_to_a_binary_model() {
    let dir = tempfile::tempdir().unwrap();
    let model = read_model(&fixture("text")).unwrap();
    write_binary(&model, dir.path()).unwrap();
    let before = fs::read(dir.path().join("images.bin")).unwrap();
    assert!(matches!(write_text(&model, dir.path()), Err(MapError::BinaryModelThere { .. })));
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 5);
    assert_eq!(fs::read(dir.path().join("images.bin")).unwrap(), before);
}

/// Each invalid text, with the file and position that the message must contain.
#[test]
fn invalid_text_is_refused_with_file_and_line() {
    let i = |pose: &str| format!("{pose}\n\n");
    let cases: Vec<(&str, [String; 3], &str)> = vec![
        ("short camera", [cameras("1 PINHOLE 640"), i(""), p("")], "cameras.txt, line 1"),
        ("parameter count", [cameras("1 PINHOLE 640 480 1 2"), i(""), p("")], "cameras.txt, line 1"),
        ("not a number", [cameras("1 PINHOLE 640 480 a 1 1 1"), i(""), p("")], "cameras.txt, line 1"),
        ("negative size", [cameras("1 PINHOLE -640 480 1 1 1 1"), i(""), p("")], "cameras.txt, line 1"),
        ("unknown model", [cameras("1 SPHERICAL 640 480 1 1 1 1 1"), i(""), p("")], "not supported"),
        ("camera twice", [CAMERAS.repeat(2), i(""), p("")], "camera 1 is defined twice"),
        ("NaN pose", [c(), i("1 1 0 0 0 nan 0 0 1 a.jpg"), p("")], "images.txt, line 1"),
        ("zero quaternion", [c(), i("1 0 0 0 0 0 0 0 1 a.jpg"), p("")], "images.txt, line 1"),
        ("no name", [c(), i("1 1 0 0 0 0 0 0 1"), p("")], "before its NAME"),
        ("unknown camera", [c(), i("1 1 0 0 0 0 0 0 2 a.jpg"), p("")], "\"a.jpg\" has camera 2"),
        (
            "no 2D line",
            [c(), "1 1 0 0 0 0 0 0 1 a.jpg\n2 1 0 0 0 0 0 0 1 b.jpg\n".into(), p("")],
            "images.txt, line 2",
        ),
        ("2D point cut", [c(), "1 1 0 0 0 0 0 0 1 a.jpg\n1 2 -1 3".into(), p("")], "images.txt, line 2"),
        (
            "2D point NaN",
            [c(), "1 1 0 0 0 0 0 0 1 a.jpg\n1 nan -1".into(), p("")],
            "\"a.jpg\" has a 2D point 0",
        ),
        ("point id", [c(), "1 1 0 0 0 0 0 0 1 a.jpg\n1 2 -7".into(), p("")], "POINT3D_ID is -7"),
        (
            "name twice",
            [c(), i("1 1 0 0 0 0 0 0 1 a.jpg") + &i("2 1 0 0 0 0 0 0 1 a.jpg"), p("")],
            "\"a.jpg\" appears twice",
        ),
        (
            "id twice",
            [c(), i("1 1 0 0 0 0 0 0 1 a.jpg") + &i("1 1 0 0 0 0 0 0 1 b.jpg"), p("")],
            "id 1 appears twice",
        ),
        ("point cut", [CAMERAS.into(), IMAGES.into(), p("5 0 0 3 10 20 30")], "points3D.txt, line 1"),
        (
            "track cut",
            [CAMERAS.into(), IMAGES.into(), p("5 0 0 3 10 20 30 0.2 1 0 2")],
            "points3D.txt, line 1",
        ),
        ("color", [CAMERAS.into(), IMAGES.into(), p("5 0 0 3 10 20 300 0.2")], "points3D.txt, line 1"),
    ];
    for (what, [cameras, images, points], expected) in cases {
        let error = read(&cameras, &images, &points).expect_err(what).to_string();
        assert!(error.contains(expected), "{what}: {error}");
    }
}

/// What is odd in one image or camera does not refuse the others.
#[test]
fn odd_images_and_unused_cameras_are_left_out() {
    let two =
        "1 PINHOLE 640 480 500 500 320 240\n2 PINHOLE 640 480 -500 500 320 240\n3 SPHERICAL 640 480 1\n";
    let image = |id: u32, pose: &str, camera: u32| format!("{id} {pose} {camera} {id}.jpg\n1 2 5\n");
    let right = "1 0 0 0 0 0 0";
    let point = "5 0 0 3 10 20 30 0.2 1 0 2 0";
    for (second, remark) in [
        (image(2, right, 1), None),
        (image(2, right, 2), Some("cameras.txt, line 2")),
        (image(2, right, 3), Some("cameras.txt, line 3")),
        (image(2, "0 0 0 0 0 0 0", 1), Some("images.txt, line 3")),
        (image(2, "1 0 0 0 0 nan 0", 1), Some("images.txt, line 3")),
    ] {
        let model = read(two, &(image(1, right, 1) + &second), point).expect("a model");
        let names: Vec<&str> = model.images().iter().map(|image| image.name.as_str()).collect();
        let remarks = model.remarks().join("; ");
        match remark {
            None => assert!(names == ["1.jpg", "2.jpg"] && remarks.is_empty(), "{names:?}: {remarks}"),
            Some(remark) => {
                assert_eq!(names, ["1.jpg"], "{remarks}");
                assert!(
                    remarks.starts_with("1 of 2 images are left out") && remarks.contains(remark),
                    "{remarks}"
                );
                assert_eq!(model.points()[0].track, [(1, 0)], "{remarks}");
            }
        }
        // A model in binary form has the same images.
        let folder = tempfile::tempdir().unwrap();
        write_binary(&model, folder.path()).unwrap();
        assert_eq!(read_model(folder.path()).unwrap().images().len(), names.len());
    }
}

fn cameras(line: &str) -> String {
    line.to_owned()
}

fn c() -> String {
    "1 PINHOLE 640 480 500 500 320 240".to_owned()
}

fn p(line: &str) -> String {
    line.to_owned()
}

/// Points and observations that only one of the files has are left out and counted; the rest stays.
#[test]
fn points_on_which_the_files_disagree_are_left_out() {
    // Image, its points, expected observations of point 5, and parts of the remarks.
    let whole = "5 0.1 0.2 3 10 20 30 0.25 1 0 2 0\n";
    let cases = [
        (IMAGES, String::new(), None, ["2 observations", "2 are only in images, 0 only in points3D"]),
        (IMAGES, p("5 0 0 nan 10 20 30 0.2 1 0 2 0"), None, ["1 of 1 points", "2 are only in images"]),
        (IMAGES, whole.repeat(2), Some(2), ["1 of 2 points have", "the id of another point"]),
        (
            IMAGES,
            p("5 0 0 3 1 2 3 0.2 1 0 9 0"),
            Some(1),
            ["2 observations", "1 are only in images, 1 only in"],
        ),
        (IMAGES, p("5 0 0 3 1 2 3 0.2 1 0 2 1"), Some(1), ["2 observations", "1 are in both"]),
        (IMAGES, p("5 0 0 3 1 2 3 0.2 1 0 1 1 2 0"), Some(2), ["1 observations", "0 are only in images"]),
        (IMAGES, p("5 0 0 3 1 2 3 0.2 1 0 1 0 2 0"), Some(2), ["1 observations", "1 only in points3D"]),
    ];
    for (images, points, observations, expected) in cases {
        let model = read(CAMERAS, images, &points).unwrap();
        let track = model.points().first().map(|point| point.track.len());
        assert_eq!(track, observations, "{points}");
        let linked = model.images().iter().flat_map(|i| &i.points2d).filter(|p| p.point.is_some()).count();
        assert_eq!(linked, observations.unwrap_or(0), "{points}");
        let remarks = model.remarks().join("; ");
        assert!(expected.iter().all(|part| remarks.contains(part)), "{points}: {remarks}");
        assert_eq!(PosedImages::from(&model).remarks(), model.remarks());
    }
    assert!(read(CAMERAS, IMAGES, POINTS).unwrap().remarks().is_empty());
    let parts = read(CAMERAS, IMAGES, POINTS).unwrap();
    let built =
        ColmapModel::new(vec![(1, *parts.camera_of(&parts.images()[0]))], parts.images()[..1].into(), vec![]);
    assert!(built.is_err_and(|e| e.to_string().contains("sees point 5")), "a model of a program is checked");
}

/// Cameras and poses do not depend on points.
#[test]
fn posed_images_are_read_without_damaged_points() {
    let dir = tempfile::tempdir().unwrap();
    for (name, content) in [("cameras.txt", CAMERAS), ("images.txt", IMAGES), ("points3D.txt", "5 0 0\n")] {
        fs::write(dir.path().join(name), content).unwrap();
    }
    let posed = read_posed(dir.path()).unwrap();
    assert_eq!((posed.images().len(), posed.points().len()), (3, 0));
    assert!(posed.images().iter().all(|image| image.seen.is_empty()));
    let [remark] = posed.remarks() else { panic!("{:?}", posed.remarks()) };
    assert!(remark.contains("points3D.txt, line 1") && remark.contains("not used"), "{remark}");
    assert!(read_model(dir.path()).is_err(), "an import needs its points");
}

#[test]
fn spellings_of_other_programs_are_read() {
    let model = read(CAMERAS, IMAGES, POINTS).unwrap();
    let mark = |text: &str| format!("\u{feff}{text}");
    assert_eq!(read(&mark(CAMERAS), &mark(IMAGES), &mark(POINTS)).unwrap(), model);
    let cameras = CAMERAS.replace("640 480", "640.0 480.0").replace("PINHOLE", "pinhole");
    let images = IMAGES.replace("40 -1", "40 18446744073709551615");
    let points = POINTS.replace("10 20 30", "10.0 19.6 30.2");
    assert_eq!(read(&cameras, &images, &points).unwrap(), model);
    assert!(read(&CAMERAS.replace("640", "640.5"), IMAGES, POINTS).is_err());
    assert!(read(CAMERAS, IMAGES, &POINTS.replace("10 20 30", "10 20 256")).is_err());
}

#[test]
fn non_utf8_text_names_the_line() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("cameras.txt"), b"# fine\n1 PINHOLE \xff\n").unwrap();
    for name in ["images.txt", "points3D.txt"] {
        fs::write(dir.path().join(name), "").unwrap();
    }
    let error = read_model(dir.path()).unwrap_err().to_string();
    assert!(error.contains("cameras.txt, line 2"), "{error}");
}

#[test]
fn folder_without_a_model_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("cameras.txt"), CAMERAS).unwrap();
    for dir in [dir.path(), Path::new("no/such/folder")] {
        assert!(matches!(read_model(dir), Err(MapError::NoColmapModel { .. })));
    }
}

#[test]
fn folder_of_models_names_them() {
    let dir = tempfile::tempdir().unwrap();
    let add = |folder: &str| {
        let folder = dir.path().join(folder);
        fs::create_dir(&folder).unwrap();
        for file in ["cameras.txt", "images.txt", "points3D.txt"] {
            fs::copy(fixture("text").join(file), folder.join(file)).unwrap();
        }
    };
    let message = || read_posed(dir.path()).unwrap_err().to_string();
    assert!(message().contains("give the folder that holds them"), "{}", message());
    add("0");
    assert!(
        message().ends_with(&format!("the model in it: {}", dir.path().join("0").display())),
        "{}",
        message()
    );
    add("1");
    assert!(message().contains("one of the 2 models in it"), "{}", message());
}

/// Copies the binary fixture and changes one file.
fn damaged(file: &str, change: impl FnOnce(&mut Vec<u8>)) -> Result<ColmapModel, MapError> {
    let dir = tempfile::tempdir().unwrap();
    let mut change = Some(change);
    for name in ["cameras.bin", "images.bin", "points3D.bin"] {
        let mut bytes = fs::read(fixture("binary").join(name)).unwrap();
        if name == file {
            change.take().unwrap()(&mut bytes);
        }
        fs::write(dir.path().join(name), bytes).unwrap();
    }
    read_model(dir.path())
}

#[test]
fn truncated_binary_files_are_refused() {
    for file in ["cameras.bin", "images.bin", "points3D.bin"] {
        let length = fs::read(fixture("binary").join(file)).unwrap().len();
        for cut in 0..length {
            let error = damaged(file, |bytes| bytes.truncate(cut)).expect_err("cut");
            assert!(error.to_string().contains(file), "{cut}: {error}");
        }
        let error = damaged(file, |bytes| bytes.push(0)).expect_err("appended");
        assert!(error.to_string().contains("follow the last"), "{error}");
    }
}

#[test]
fn hostile_counts_are_refused_before_allocation() {
    for file in ["cameras.bin", "images.bin", "points3D.bin"] {
        for count in [u64::MAX, 1 << 40, 1 << 33] {
            let error = damaged(file, |bytes| bytes[..8].copy_from_slice(&count.to_le_bytes())).unwrap_err();
            assert!(error.to_string().contains("announced") && error.to_string().contains(file), "{error}");
        }
    }
    // The track length of the first point, after id, position, colour and error.
    let error = damaged("points3D.bin", |bytes| bytes[51..59].copy_from_slice(&(1_u64 << 60).to_le_bytes()));
    assert!(error.unwrap_err().to_string().contains("announced"));
}

#[test]
fn invalid_binary_records_are_refused() {
    let error = damaged("cameras.bin", |bytes| bytes[12] = 99).unwrap_err().to_string();
    assert!(error.contains("cameras.bin") && error.contains("not supported"), "{error}");
    let error = damaged("cameras.bin", |bytes| bytes[12] = 17).unwrap_err().to_string();
    assert!(error.contains("cameras.bin") && error.contains("panorama"), "{error}");
    let nan = f64::NAN.to_le_bytes();
    let model = damaged("images.bin", |bytes| bytes[12..20].copy_from_slice(&nan)).unwrap();
    let remark = &model.remarks()[0];
    assert!(remark.starts_with("1 of 4 images are left out") && remark.contains("images.bin"), "{remark}");
    let model = damaged("points3D.bin", |bytes| bytes[16..24].copy_from_slice(&nan)).unwrap();
    assert!(model.remarks()[0].contains("1 of 12 points"), "{:?}", model.remarks());
}

/// Copies a fixture with rigs and changes one of its text files.
fn with_rigs(file: &str, change: impl Fn(&str) -> String) -> Result<ColmapModel, MapError> {
    let dir = tempfile::tempdir().unwrap();
    for entry in fs::read_dir(fixture("rigs-text")).unwrap() {
        let path = entry.unwrap().path();
        let text = fs::read_to_string(&path).unwrap();
        let name = path.file_name().unwrap();
        fs::write(dir.path().join(name), if name == file { change(&text) } else { text }).unwrap();
    }
    read_model(dir.path())
}

fn assert_same_poses(a: &ColmapModel, b: &ColmapModel) {
    assert_eq!(a.images().len(), b.images().len());
    for image in a.images() {
        let other = b.image_by_name(&image.name).unwrap();
        assert!(image.cam_from_world.rotation_error_degrees(&other.cam_from_world) < 1e-10, "{}", image.name);
        assert!(image.cam_from_world.translation_error(&other.cam_from_world) < 1e-10, "{}", image.name);
    }
}

/// The poses of pycolmap's images file are those that it computes from rigs and frames.
#[test]
fn poses_of_rigs_and_frames_agree_with_pycolmap() {
    for format in ["rigs-text", "rigs-binary"] {
        let dir = tempfile::tempdir().unwrap();
        let model = read_model(&fixture(format)).unwrap();
        let extension = format.replace("rigs-", "").replace("text", "txt").replace("binary", "bin");
        for file in ["cameras", "images", "points3D"].map(|file| format!("{file}.{extension}")) {
            fs::copy(fixture(format).join(&file), dir.path().join(&file)).unwrap();
        }
        let of_images = read_model(dir.path()).unwrap();
        assert_same_poses(&model, &of_images);
        assert!(model.remarks().is_empty(), "{:?}", model.remarks());
        let rigs = model.rigs().unwrap();
        assert_eq!((rigs.rigs.len(), rigs.frames.len(), rigs.rigs[0].sensors.len()), (2, 4, 1));
        assert!(of_images.rigs().is_none());
    }
    let (text, binary) = (read_model(&fixture("rigs-text")), read_model(&fixture("rigs-binary")));
    assert_same_poses(&text.unwrap(), &binary.unwrap());
}

#[test]
fn poses_of_rigs_and_frames_overrule_those_of_images() {
    let truth = read_model(&fixture("rigs-text")).unwrap();
    // Another state of the reconstruction: half the scale for the images of camera 2.
    let halved = |text: &str| {
        let half = |line: &str| {
            let mut words: Vec<String> = line.split(' ').map(str::to_owned).collect();
            words[5..8].iter_mut().for_each(|word| *word = (word.parse::<f64>().unwrap() / 2.0).to_string());
            words.join(" ")
        };
        let lines =
            text.lines().map(|line| if line.contains(" camera2/") { half(line) } else { line.to_owned() });
        lines.collect::<Vec<_>>().join("\n")
    };
    let model = with_rigs("images.txt", halved).unwrap();
    assert_same_poses(&model, &truth);
    let [remark] = model.remarks() else { panic!("{:?}", model.remarks()) };
    assert!(
        remark.contains("3 of 6 poses in images differ") && remark.contains("frames are used"),
        "{remark}"
    );
    assert_eq!(PosedImages::from(&model).remarks(), model.remarks());

    // A camera whose pose on its rig is not known, and an image without a frame, keep their own poses.
    let without = |text: &str| {
        let rig = text.lines().find(|line| line.starts_with('5')).unwrap();
        let words: Vec<&str> = rig.split(' ').take(6).collect();
        text.replace(rig, &format!("{} 0", words.join(" ")))
    };
    let model = with_rigs("rigs.txt", without).unwrap();
    assert_same_poses(&model, &truth);
    assert!(model.remarks()[0].starts_with("3 of 6 images have no frame"), "{:?}", model.remarks());
    let fewer =
        |text: &str| text.lines().filter(|line| !line.starts_with('4')).collect::<Vec<_>>().join("\n");
    let model = with_rigs("frames.txt", fewer).unwrap();
    assert!(model.remarks()[0].starts_with("1 of 6 images"), "{:?}", model.remarks());
}

#[test]
fn rigs_and_frames_are_written() {
    let model = read_model(&fixture("rigs-binary")).unwrap();
    let plain = read_model(&fixture("binary")).unwrap();
    for write in [write_text, write_binary] {
        let dir = tempfile::tempdir().unwrap();
        write(&model, dir.path()).unwrap();
        let back = read_model(dir.path()).unwrap();
        assert_same_poses(&back, &model);
        assert!(back.remarks().is_empty(), "{:?}", back.remarks());
        let (a, b) = (back.rigs().unwrap(), model.rigs().unwrap());
        for (a, b) in a.rigs.iter().zip(&b.rigs) {
            assert_eq!((a.id, a.reference, a.sensors.len()), (b.id, b.reference, b.sensors.len()));
            for ((sensor, a), (other, b)) in a.sensors.iter().zip(&b.sensors) {
                assert_eq!(sensor, other);
                assert!(a.unwrap().rotation_error_degrees(&b.unwrap()) < 1e-10);
            }
        }
        let data = |frame: &ColmapFrame| (frame.id, frame.rig_id, frame.data.clone());
        assert!(a.frames.iter().map(data).eq(b.frames.iter().map(data)));

        // A model without rigs, over the files of one with rigs.
        write(&plain, dir.path()).unwrap();
        let back = read_model(dir.path()).unwrap();
        assert_same_poses(&back, &plain);
        assert!(back.remarks().is_empty(), "{:?}", back.remarks());
        let rigs = back.rigs().unwrap();
        assert_eq!((rigs.rigs.len(), rigs.frames.len()), (plain.cameras().len(), plain.images().len()));
    }
}

#[test]
fn invalid_rigs_and_frames_are_refused() {
    type Case = (&'static str, fn(&str) -> String, &'static str);
    let cases: [Case; 8] = [
        ("rigs.txt", |text| text.replace("5 2 CAMERA", "5 2 SONAR"), "SENSOR_TYPE is \"SONAR\""),
        ("rigs.txt", |text| text.replace("6 1 CAMERA 3", "5 1 CAMERA 3"), "rig 5 is defined twice"),
        ("rigs.txt", |text| text.replace("6 1 CAMERA 3", "6 1 CAMERA 2"), "sensor CAMERA 2 is on two rigs"),
        ("rigs.txt", |text| text.replace("5 2 CAMERA", "5 3 CAMERA"), "ends before its SENSOR_TYPE"),
        ("rigs.txt", |text| text.replace("6 1 CAMERA 3", "6 1 CAMERA 3 4"), "follows the last field"),
        ("frames.txt", |text| text.replace("\n4 6 ", "\n4 7 "), "frame 4 has rig 7"),
        ("frames.txt", |text| text.replace("\n4 6 ", "\n3 6 "), "frame 3 is defined twice"),
        ("frames.txt", |text| text.replace("CAMERA 3 6", "CAMERA 3 5"), "image 5 is in two frames"),
    ];
    for (file, change, expected) in cases {
        let error = with_rigs(file, change).expect_err(expected).to_string();
        assert!(error.contains(expected), "{error}");
    }
    for file in ["rigs.bin", "frames.bin"] {
        let whole = fs::read(fixture("rigs-binary").join(file)).unwrap();
        for cut in (0..whole.len()).step_by(5) {
            let dir = tempfile::tempdir().unwrap();
            for entry in fs::read_dir(fixture("rigs-binary")).unwrap() {
                let path = entry.unwrap().path();
                fs::copy(&path, dir.path().join(path.file_name().unwrap())).unwrap();
            }
            fs::write(dir.path().join(file), &whole[..cut]).unwrap();
            let error = read_model(dir.path()).expect_err("cut").to_string();
            assert!(error.contains(file), "{cut}: {error}");
        }
    }
}

#[real_data_test]
fn lund_door_is_read_completely(data: &Path) {
    let model = read_model(&data.join("lund-door/sparse")).unwrap();
    assert_eq!((model.images().len(), model.points().len()), (12, 11384));
    let observations: usize = model.points().iter().map(|p| p.track.len()).sum();
    assert_eq!(observations, 73327);
    for posed in ["redkitchen", "herzjesu"] {
        let model = read_model(&data.join(posed).join("posed")).unwrap();
        assert_eq!(model.images().len(), if posed == "redkitchen" { 112 } else { 25 });
        assert!(model.points().is_empty() && model.images().iter().all(|i| i.points2d.is_empty()));
    }
}

#[test]
fn posed_images_need_no_points_file() {
    for format in ["text", "binary"] {
        let whole = read_model(&fixture(format)).unwrap();
        let posed = PosedImages::from(&whole);
        assert_eq!(read_posed(&fixture(format)).unwrap(), posed);
        assert_eq!((posed.images().len(), posed.points().len()), (4, 12));
        let dir = tempfile::tempdir().unwrap();
        let extension = if format == "text" { "txt" } else { "bin" };
        for file in ["cameras", "images"] {
            let name = format!("{file}.{extension}");
            fs::copy(fixture(format).join(&name), dir.path().join(&name)).unwrap();
        }
        let without = read_posed(dir.path()).unwrap();
        assert!(without.points().is_empty() && without.images().iter().all(|i| i.seen.is_empty()));
        for (image, of_whole) in without.images().iter().zip(posed.images()) {
            assert_eq!((&image.name, image.camera), (&of_whole.name, of_whole.camera));
            assert_eq!(image.cam_from_world, of_whole.cam_from_world);
        }
        let error = read_model(dir.path()).unwrap_err().to_string();
        assert!(error.contains("points3D"), "{error}");
        fs::remove_file(dir.path().join(format!("images.{extension}"))).unwrap();
        let error = read_posed(dir.path()).unwrap_err();
        assert!(matches!(error, MapError::NoColmapModel { .. }), "{error}");
    }
}

#[test]
fn posed_images_have_the_points_of_the_2d_points() {
    let model = read_model(&fixture("text")).unwrap();
    let posed = PosedImages::from(&model);
    for (image, colmap) in posed.images().iter().zip(model.images()) {
        let ids: Vec<u64> = colmap.points2d.iter().filter_map(|p| p.point).collect();
        let seen: Vec<u64> = image.seen.iter().map(|i| model.points()[*i as usize].id).collect();
        assert_eq!(seen, ids);
    }
    assert!(posed.images().iter().any(|i| i.seen.len() > 5));
}
