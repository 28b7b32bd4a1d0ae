//! Samples of the real data sets, and folders written in their layouts and read back.

use std::path::Path;

use veiloc_datasets::seven_scenes::PoseSource;
use veiloc_datasets::write::{DatasetCamera, DatasetLayout, DatasetView, Split, write};
use veiloc_datasets::{DatasetError, DatasetScene, MissingImages, aachen, cambridge, seven_scenes};
use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::Rotation3;
use veiloc_mapping::importers::poses::nvm::{parse, read_nvm};
use veiloc_testdata::real_data_test;

const HERE: MissingImages = MissingImages::LeaveOut;

#[real_data_test]
fn seven_scenes_original_folders_are_read(data: &Path) {
    let root = data.join("formats/7scenes");
    assert_eq!(seven_scenes::scenes(&root).expect("scenes"), ["stairs"]);
    let depth =
        seven_scenes::read_scene(&root, "stairs", &PoseSource::Depth, MissingImages::Refuse).expect("read");
    assert_eq!((depth.mapped.images().len(), depth.queries.len()), (6, 6));
    assert!(!depth.is_official && depth.remarks.is_empty());
    // `frame-000000.pose.txt` of the first sequence, a query, is a camera-to-world matrix: its last column is the
    // centre.
    let first = &depth.queries[0];
    assert_eq!(first.name, "seq-01/frame-000000.color.jpg", "the sample's images are JPEG");
    let center = first.cam_from_world.expect("known").center().coords;
    assert!((center.x + 1.4903377).abs() < 1e-6 && (center.z + 0.054694783).abs() < 1e-6, "{center}");
    assert_eq!(first.camera.to_string(), "SIMPLE_PINHOLE,640,480,525,320,240");

    let sfm = PoseSource::sfm_beside(&root);
    let refused =
        seven_scenes::read_scene(&root, "stairs", &sfm, MissingImages::Refuse).expect_err("most are missing");
    assert!(matches!(&refused, DatasetError::MissingImages { .. }), "{refused}");
    assert!(refused.to_string().contains("rgb-d-dataset-7-scenes"), "{refused}");
    let sfm = seven_scenes::read_scene(&root, "stairs", &sfm, HERE).expect("read");
    assert!(!sfm.is_official && sfm.remarks[0].contains("were left out"), "{:?}", sfm.remarks);
    // Both sources of poses have the same scene and scale: distances between cameras agree.
    let queries: Vec<_> = sfm.queries.iter().filter_map(|q| Some((&q.name, q.cam_from_world?))).collect();
    assert!(queries.len() >= 2);
    let of_depth = |name: &str| {
        let query = depth.queries.iter().find(|query| query.name == name).expect("there");
        query.cam_from_world.expect("known").center()
    };
    for ((a, pose_a), (b, pose_b)) in queries.iter().zip(&queries[1..]) {
        let (ours, theirs) = (pose_a.center().distance(&pose_b.center()), of_depth(a).distance(&of_depth(b)));
        assert!((ours - theirs).abs() < 0.05, "{a} {b}: {ours} m and {theirs} m");
    }
}

#[real_data_test]
fn cambridge_original_lists_are_read(data: &Path) {
    let root = data.join("formats/cambridge");
    let names = cambridge::scenes(&root).expect("scenes");
    assert_eq!(names, ["GreatCourt", "KingsCollege", "OldHospital", "ShopFacade", "StMarysChurch"]);
    // As published; the paper counts 343, 182, 103 and 530 queries in the scenes it evaluates.
    let counts = [(1531, 760), (1220, 343), (895, 182), (231, 103), (1487, 530)];
    for (scene, (train, test)) in names.iter().zip(counts) {
        let of = |file: &str| cambridge::read_list(&root.join(scene).join(file), scene).expect("read");
        let (map, queries) = (of("dataset_train.txt"), of("dataset_test.txt"));
        assert_eq!((map.len(), queries.len()), (train, test), "{scene}");
        assert!(
            map.iter()
                .chain(&queries)
                .all(|image| image.name.starts_with("seq") || image.name.starts_with("img")),
            "{scene}"
        );
        assert!(map.iter().all(|image| queries.iter().all(|query| query.name != image.name)), "{scene}");
    }
    let first =
        &cambridge::read_list(&root.join("ShopFacade/dataset_test.txt"), "ShopFacade").expect("read")[0];
    let center = first.cam_from_world.center().coords;
    assert!((center.x - 236.9956).abs() < 1e-6 && (center.z - 204.774).abs() < 1e-6, "{center}");
    let refused =
        cambridge::read_scene(&root, "ShopFacade", None, MissingImages::Refuse).expect_err("no model");
    assert!(refused.to_string().contains("reconstruction.nvm"), "{refused}");
}

#[real_data_test]
fn aachen_models_and_queries_are_read(data: &Path) {
    let root = data.join("formats/aachen");
    let version = aachen::AachenVersion::V1;
    let other = aachen::read(&root, aachen::AachenVersion::V1_1, &[], None, MissingImages::Refuse);
    let refused = other.expect_err("there is no model of v1.1").to_string();
    assert!(refused.contains("aachen_v_1_1") && refused.contains("`aachen`"), "{refused}");
    let day = ["day".to_owned()];
    let scene = aachen::read(&root, version, &day, None, MissingImages::Refuse).expect("read");
    assert_eq!((scene.mapped.images().len(), scene.queries.len()), (3, 4));
    assert!(scene.queries.iter().all(|query| query.cam_from_world.is_none()));
    let camera = scene.queries[0].camera.to_string();
    assert_eq!(camera, "SIMPLE_RADIAL,1600,1200,1469.2,800,600,-0.0353019");

    // The Bundler file has the same cameras: rotation rows and translation, with y and z of camera and world
    // inverted.
    let bundler = std::fs::read_to_string(root.join("3D-models/aachen_cvpr2018_db.out")).expect("there");
    let lines: Vec<Vec<f64>> = bundler
        .lines()
        .skip(2)
        .take(15)
        .map(|line| line.split_whitespace().map(|n| n.parse().expect("a number")).collect())
        .collect();
    for (image, bundler) in scene.mapped.images().iter().zip(lines.chunks(5)) {
        let rotation = image.cam_from_world.rotation().matrix();
        let t = image.cam_from_world.translation();
        for row in 0..3 {
            let sign = if row == 0 { 1.0 } else { -1.0 };
            for column in 0..3 {
                let sign = if column == 0 { sign } else { -sign };
                assert!(
                    (rotation[(row, column)] - sign * bundler[1 + row][column]).abs() < 1e-5,
                    "{}",
                    image.name
                );
            }
            assert!(
                (t[row] - sign * bundler[4][row]).abs() < 1e-2,
                "{}: {} {}",
                image.name,
                t[row],
                bundler[4][row]
            );
        }
    }
    // Points project to the model's measurements, in COLMAP's pixel convention (VisualSFM measures from the centre).
    let model = read_nvm(&root.join("3D-models/aachen_cvpr2018_db.nvm")).expect("read");
    assert_eq!((model.cameras.len(), model.points.len(), model.left_out), (3, 5, 0));
    let two = read_nvm(&root.join("3D-models/aachen_two_parts.nvm")).expect("read");
    assert_eq!((two.cameras.len(), two.left_out), (2, 1), "the second model is of another world");

    let night = ["night".to_owned()];
    let refused = aachen::read(&root, version, &night, None, HERE).expect_err("no such list");
    assert!(refused.to_string().contains("visuallocalization.net"), "{refused}");
}

/// Three views of a scene; the second and third are queries.
fn views() -> Vec<DatasetView> {
    let pose = |x: f64| {
        CameraFromWorld::new(Rotation3::from_euler_angles(0.1 * x, 0.3, -0.2), [x, 1.0, 0.25 * x].into())
    };
    let view = |x, split| DatasetView { cam_from_world: pose(x), split };
    vec![view(0.5, Split::Map), view(1.5, Split::Query), view(2.5, Split::NightQuery), view(3.5, Split::Map)]
}

fn written(layout: DatasetLayout, root: &Path) -> DatasetCamera {
    let lens = DatasetCamera::of(layout, (64, 48));
    let save = &mut |_: usize, path: &Path| {
        image::GrayImage::new(64, 48).save(path).expect("saved");
        Ok(())
    };
    write(layout, root, "room", &lens, &views(), save).expect("written");
    lens
}

/// Checks that poses were read as written, with map images and queries in order.
fn check_round_trip(scene: &DatasetScene, lens: &DatasetCamera) {
    let near = |a: &CameraFromWorld, b: &CameraFromWorld| {
        a.translation_error(b) < 1e-9 && a.rotation_error_degrees(b) < 1e-5
    };
    let (map, queries): (Vec<DatasetView>, Vec<DatasetView>) =
        views().into_iter().partition(|view| view.split == Split::Map);
    assert_eq!((scene.mapped.images().len(), scene.queries.len()), (2, 2));
    for (image, view) in scene.mapped.images().iter().zip(&map) {
        assert!(near(&image.cam_from_world, &view.cam_from_world), "{}", image.name);
        assert_eq!(image.camera, lens.camera().expect("a camera"), "{}", image.name);
        assert!(scene.images.join(&image.name).is_file());
    }
    for (query, view) in scene.queries.iter().zip(&queries) {
        assert!(near(&query.cam_from_world.expect("known"), &view.cam_from_world), "{}", query.name);
        assert_eq!(query.camera, lens.camera().expect("a camera"), "{}", query.name);
    }
    assert!(!scene.is_official && scene.remarks.is_empty());
}

#[test]
fn layouts_round_trip() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let at = |name: &str| folder.path().join(name);
    let lens = written(DatasetLayout::SevenScenes, &at("7scenes"));
    for truth in [PoseSource::Depth, PoseSource::sfm_beside(&at("7scenes"))] {
        check_round_trip(
            &seven_scenes::read_scene(&at("7scenes"), "room", &truth, MissingImages::Refuse).expect("read"),
            &lens,
        );
    }
    let lens = written(DatasetLayout::Cambridge, &at("cambridge"));
    check_round_trip(
        &cambridge::read_scene(&at("cambridge"), "room", None, MissingImages::Refuse).expect("read"),
        &lens,
    );
    let conditions = aachen::CONDITIONS.map(str::to_owned);
    for (layout, version) in [
        (DatasetLayout::Aachen, aachen::AachenVersion::V1),
        (DatasetLayout::AachenV1_1, aachen::AachenVersion::V1_1),
    ] {
        let root = at(layout.name());
        let lens = written(layout, &root);
        let truth = aachen::read_poses(&root.join("queries/poses.txt")).expect("read");
        let scene =
            aachen::read(&root, version, &conditions, Some(&truth), MissingImages::Refuse).expect("read");
        check_round_trip(&scene, &lens);
        let conditions: Vec<_> = scene.queries.iter().map(|query| query.condition.as_deref()).collect();
        assert_eq!(conditions, [Some("day"), Some("night")]);
    }
}

#[test]
fn damaged_lists_are_reported_with_line() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let root = folder.path();
    written(DatasetLayout::SevenScenes, root);
    let read =
        || seven_scenes::read_scene(root, "room", &PoseSource::sfm_beside(root), MissingImages::Refuse);
    let check_error = |file: &str, content: &str, what: &str| {
        let path = root.join(file);
        let old = std::fs::read(&path).expect("there");
        std::fs::write(&path, content).expect("written");
        let error = read().expect_err("refused").to_string();
        assert!(error.contains(what), "{file}: {error}");
        std::fs::write(&path, old).expect("written");
    };
    check_error(
        "room/TrainSplit.txt",
        "sequence1\nsecond\n",
        "TrainSplit.txt:2: \"second\" is not a sequence",
    );
    check_error(
        "pgt_sfm/room_train.txt",
        "seq-01/a.png 1 0 0 0 0 0 nan 500\n",
        "room_train.txt:1: the translation is not finite",
    );
    check_error("pgt_sfm/room_train.txt", "seq-01/a.png 0 0 0 0 0 0 0 500\n", "not a rotation");
    check_error("pgt_sfm/room_train.txt", "seq-02/a.png 1 0 0 0 0 0 0 500\n", "of the other split");
    check_error("pgt_sfm/room_train.txt", "seq-01/a.png 1 0 0 0 0 0 0\n", "the focal length is missing");
    std::fs::remove_file(root.join("pgt_sfm/room_test.txt")).expect("there");
    assert!(read().expect_err("refused").to_string().contains("visloc_pseudo_gt_limitations"));
    std::fs::write(root.join("room/seq-01/frame-000000.pose.txt"), "1 0 0 0\n0 2 0 0\n0 0 1 0\n0 0 0 1\n")
        .expect("written");
    let depth = seven_scenes::read_scene(root, "room", &PoseSource::Depth, MissingImages::Refuse);
    assert!(depth.expect_err("refused").to_string().contains("invalid rotation"));
}

#[test]
fn damaged_models_are_reported_with_line() {
    let camera = "a.jpg 500 1 0 0 0 0 0 0 0 0\n";
    let check_error = |text: String, what: &str| {
        let error = parse(Path::new("a.nvm"), &text).expect_err("refused").to_string();
        assert!(error.contains(what), "{text:?}: {error}");
    };
    check_error(String::new(), "ends before its first line");
    check_error("NVM_V2\n".to_owned(), "does not begin with NVM_V3");
    check_error("NVM_V3 FixedK 1 2 3 4 5\n".to_owned(), "FixedK");
    check_error(format!("NVM_V3\n2\n{camera}"), "ends before its cameras");
    check_error("NVM_V3\n18446744073709551615\n".to_owned(), "ends before its cameras");
    check_error("NVM_V3\n1\na.jpg 500 1 0 0\n".to_owned(), "a.nvm:3: a camera needs");
    check_error(format!("NVM_V3\n1\n{camera}1\n0 0 0 1 2 3 1 7 0 0 0\n"), "camera 7, which does not exist");
    check_error(
        format!("NVM_V3\n1\n{camera}1\n0 0 0 1 2 3 18446744073709551615 0 0 0 0\n"),
        "a camera's number is missing",
    );
    check_error(format!("NVM_V3\n1\n{camera}5\n0 0 0 1 2 3 0\n"), "ends before its points");
    let named =
        parse(Path::new("a.nvm"), "NVM_V3\n\n1\nmy image.jpg 500 1 0 0 0 0 0 0 0 0\n\n0\n").expect("read");
    assert_eq!(named.cameras[0].name, "my image.jpg");
    // What is odd by itself is left out with a remark.
    let odd = parse(Path::new("a.nvm"), &format!("NVM_V3\n2\n{camera}b.jpg 500 0 0 0 0 0 0 0 0 0\n0\n"))
        .expect("read");
    assert_eq!(odd.cameras.len(), 1);
    let remark = odd.remark_on_odd().expect("a remark");
    assert!(remark.contains("1 odd lines") && remark.contains("b.jpg: the pose is no rotation"), "{remark}");
}
