//! Reads posed images in the formats of other programs, as `research/oracles/pose_formats.py` writes them by the documentation of each,
//! and compares them with the COLMAP model that it writes beside them.

use std::fs;
use std::path::{Path, PathBuf};

use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, Intrinsics, PlanePoint};
use veiloc_map::colmap::{self, ColmapImage, ColmapModel, write_text};
use veiloc_map::{PosedImage, PosedImages};
use veiloc_mapping::MappingError;
use veiloc_mapping::importers::poses::{PoseFormat, PosedInput, read_posed};
use veiloc_testdata::real_data_test;

const TOLERANCE: f64 = 1e-9;

pub(super) fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/importers/poses").join(name)
}

/// A temporary folder with images of the fixtures' size, which have these names.
pub(super) fn images_called(names: &[String], folder: &str) -> (tempfile::TempDir, PathBuf) {
    let temporary = tempfile::tempdir().expect("temporary folder");
    let images = temporary.path().join(folder);
    fs::create_dir_all(&images).expect("a folder");
    for name in names {
        image::GrayImage::new(64, 48).save(images.join(name)).expect("an image");
    }
    (temporary, images)
}

/// Reads a fixture as a format, with images in a folder called `folder`, and compares it with the expected model.
fn check(fixture: &str, file: &str, format: PoseFormat, folder: &str) -> PosedInput {
    let expected = colmap::read_posed(&data("expected").join(fixture)).expect("the expected model");
    let (_kept, images) = images_called(&expected.names(), folder);
    let read = read_posed(&data(fixture).join(file), &images).expect("posed images");
    assert_eq!(read.format, format, "{fixture}");
    assert_same(&read.images, &expected, fixture);
    assert_same(&through_colmap(&read.images), &expected, fixture);
    read
}

pub(super) fn assert_same(read: &PosedImages, expected: &PosedImages, what: &str) {
    let mut names = (read.names(), expected.names());
    names.0.sort();
    names.1.sort();
    assert_eq!(names.0, names.1, "{what}");
    for image in read.images() {
        let other = expected.get(&image.name).expect("the same names");
        let (pose, right) = (&image.cam_from_world, &other.cam_from_world);
        assert!(distance(pose, right) < TOLERANCE, "{what}: {}: {pose:?}, not {right:?}", image.name);
        for (x, y) in [(0.0, 0.0), (0.3, -0.2), (-0.4, 0.3), (0.1, 0.35)] {
            let point = PlanePoint::new(x, y);
            let (pixel, right) = (image.camera.project(point), other.camera.project(point));
            let error = (pixel.u - right.u).hypot(pixel.v - right.v);
            assert!(error < TOLERANCE, "{what}: {}: {}, not {}", image.name, image.camera, other.camera);
        }
    }
}

fn distance(a: &CameraFromWorld, b: &CameraFromWorld) -> f64 {
    let rotation = (a.rotation().matrix() - b.rotation().matrix()).norm();
    rotation.max((a.translation() - b.translation()).norm())
}

/// Writes the images as a COLMAP model and reads it.
fn through_colmap(images: &PosedImages) -> PosedImages {
    let mut cameras: Vec<Intrinsics> = Vec::new();
    let of = |camera: &Intrinsics, cameras: &mut Vec<Intrinsics>| {
        cameras.iter().position(|known| known == camera).unwrap_or_else(|| {
            cameras.push(*camera);
            cameras.len() - 1
        })
    };
    let image = |(id, image): (u32, &PosedImage)| ColmapImage {
        id,
        name: image.name.clone(),
        camera_id: of(&image.camera, &mut cameras) as u32 + 1,
        cam_from_world: image.cam_from_world,
        points2d: Vec::new(),
    };
    let written: Vec<ColmapImage> = (1..).zip(images.images()).map(image).collect();
    let model = ColmapModel::new((1..).zip(cameras).collect(), written, Vec::new()).expect("a model");
    let folder = tempfile::tempdir().expect("temporary folder");
    write_text(&model, folder.path()).expect("written");
    colmap::read_posed(folder.path()).expect("read")
}

fn down(read: &PosedInput) -> Option<[f64; 3]> {
    read.down.map(|down| down.in_world())
}

#[test]
fn nerfstudio_is_read_and_its_transform_undone() {
    let read = check("nerfstudio", "transforms.json", PoseFormat::Nerfstudio, "images");
    assert!(read.images.remarks()[0].contains("applied_transform"), "{:?}", read.images.remarks());
    check("nerfstudio", "", PoseFormat::Nerfstudio, "photos");
}

/// As `colmap model_converter --output_type Bundler` writes them.
#[test]
fn bundler_is_read_with_colmaps_names() {
    let expected = colmap::read_posed(&data("expected").join("bundler")).expect("the expected model");
    let (kept, images) = images_called(&expected.names(), "images");
    for (from, to) in [("bundle.out", "hall.bundle.out"), ("list.txt", "hall.list.txt")] {
        fs::copy(data("bundler").join(from), kept.path().join(to)).expect("copied");
    }
    let read = read_posed(&kept.path().join("hall.bundle.out"), &images).expect("posed images");
    assert_same(&read.images, &expected, "COLMAP's names");
}

#[test]
fn bundler_is_read_with_its_points() {
    let read = check("bundler", "bundle.out", PoseFormat::Bundler, "images");
    assert_eq!(read.images.points().len(), 1);
    let seen: Vec<bool> = read.images.images().iter().map(|image| image.seen == [0]).collect();
    assert_eq!(seen, [true, true, false, false]);
}

#[test]
fn nvm_is_read_with_its_points() {
    let read = check("nvm", "place.nvm", PoseFormat::Nvm, "images");
    assert_eq!(read.images.get("b.jpg").map(|image| image.seen.clone()), Some(vec![0]));
}

#[test]
fn largest_reconstruction_of_opensfm_is_read() {
    let read = check("opensfm", "reconstruction.json", PoseFormat::OpenSfm, "images");
    assert_eq!(down(&read), Some([0.0, 0.0, -1.0]));
    assert!(read.images.remarks()[0].starts_with("1 images of 1 further reconstructions"));
}

#[test]
fn metashape_is_read_with_the_transform_of_its_component() {
    let read = check("metashape", "", PoseFormat::Metashape, "images");
    assert!(read.images.remarks()[0].starts_with("1 cameras are left out: they have no pose"));
}

#[test]
fn reality_capture_is_read() {
    let read = check("reality_capture", "", PoseFormat::RealityCapture, "images");
    assert_eq!(down(&read), Some([0.0, 0.0, -1.0]));
    assert!(read.images.remarks().is_empty(), "no distortion, no remark");
}

#[test]
fn kapture_is_read_with_rigs() {
    let read = check("kapture", "", PoseFormat::Kapture, "images");
    assert!(read.images.remarks().iter().any(|remark| remark.contains("without a known camera")));
}

#[test]
fn trajectories_are_read_with_their_cameras() {
    let read = check("tum", "groundtruth.txt", PoseFormat::Tum, "rgb");
    assert!(read.images.remarks()[0].starts_with("1 images are left out"), "{:?}", read.images.remarks());
    // The camera is that of the folder: image_2 is half a metre to the right of image_0.
    check("kitti", "00.txt", PoseFormat::Kitti, "image_2");
    check("euroc", "", PoseFormat::Euroc, "data");
    check("euroc", "mav0", PoseFormat::Euroc, "data");
}

#[test]
fn ar_captures_are_read() {
    for (fixture, file, format) in [
        ("polycam", "", PoseFormat::Polycam),
        ("record3d", "metadata.json", PoseFormat::Record3d),
        ("scanner_app", "", PoseFormat::ScannerApp),
    ] {
        let read = check(fixture, file, format, "images");
        assert_eq!(down(&read), Some([0.0, -1.0, 0.0]), "{fixture}");
    }
}

#[test]
fn colmap_is_found_in_sparse_0() {
    let place = tempfile::tempdir().expect("temporary folder");
    let expected = data("expected/nvm");
    let copy = |to: &str, lines: usize| {
        let folder = place.path().join(to);
        fs::create_dir_all(&folder).expect("a folder");
        fs::copy(expected.join("cameras.txt"), folder.join("cameras.txt")).expect("copied");
        let images = fs::read_to_string(expected.join("images.txt")).expect("read");
        let images: Vec<&str> = images.lines().take(lines).collect();
        fs::write(folder.join("images.txt"), images.join("\n") + "\n").expect("written");
    };
    copy("sparse/0", 2);
    let read = || read_posed(place.path(), place.path()).expect("posed images");
    assert_eq!((read().format, read().images.images().len()), (PoseFormat::Colmap, 1));
    copy("sparse/1", 8);
    let read = read();
    assert_eq!((read.path, read.images.images().len()), (place.path().join("sparse/1"), 4), "the largest");
    assert!(read.images.remarks()[0].contains("sparse/0"), "{:?}", read.images.remarks());
    let by_file = read_posed(&place.path().join("sparse/0/images.txt"), place.path()).expect("posed images");
    assert_eq!(by_file.images.images().len(), 1);
}

#[test]
fn unknown_and_ambiguous_folders_are_refused() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let read = |name: &str| read_posed(&folder.path().join(name), folder.path());
    fs::write(folder.path().join("notes.txt"), "a walk\n").expect("written");
    for name in ["", "notes.txt"] {
        let error = read(name).expect_err("refused");
        assert!(matches!(error, MappingError::UnknownPoses { .. }), "{error}");
        assert!(error.to_string().contains("transforms.json"), "{error}");
    }
    for (fixture, file) in [("nerfstudio", "transforms.json"), ("opensfm", "reconstruction.json")] {
        fs::copy(data(fixture).join(file), folder.path().join(file)).expect("copied");
    }
    let error = read("").expect_err("refused");
    assert!(matches!(&error, MappingError::AmbiguousPoses { found, .. } if found.len() == 2), "{error}");
    assert!(read("missing.json").expect_err("refused").to_string().contains("missing.json"));
}

/// The same cameras as VisualSFM wrote them in both of its formats; it turns the world by half a turn about x between them.
#[real_data_test]
fn formats_of_visual_sfm_agree(data: &Path) {
    let aachen = data.join("formats/aachen");
    let read = |file: &str| {
        read_posed(&aachen.join("3D-models").join(file), &aachen.join("images_upright"))
            .expect("posed images")
    };
    let (nvm, bundler) = (read("aachen_cvpr2018_db.nvm"), read("aachen_cvpr2018_db.out"));
    assert_eq!((nvm.format, bundler.format), (PoseFormat::Nvm, PoseFormat::Bundler));
    assert_eq!(nvm.images.names(), bundler.images.names());
    let turn = Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    for (a, b) in nvm.images.points().iter().zip(bundler.images.points()) {
        assert!((a.coords - turn * b.coords).norm() < 1e-2, "{a:?}, {b:?}");
    }
    for (a, b) in nvm.images.images().iter().zip(bundler.images.images()) {
        let b_in_world_of_a = CameraFromWorld::new(
            b.cam_from_world.rotation() * turn.inverse(),
            *b.cam_from_world.translation(),
        );
        let turned = a.cam_from_world.rotation_error_degrees(&b_in_world_of_a);
        let moved = (a.cam_from_world.center().coords - b_in_world_of_a.center().coords).norm();
        // Ten digits of a rotation and of coordinates of some hundred metres.
        assert!(turned < 1e-4 && moved < 1e-3, "{}: {turned} degrees, {moved}", a.name);
        assert_eq!(a.seen, b.seen, "{}", a.name);
    }
}
