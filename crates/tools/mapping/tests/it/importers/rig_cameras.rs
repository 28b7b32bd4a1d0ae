//! Calibrations of rigs, and the poses of the images of a rig from those of one camera.

use veiloc_geometry::Point3;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_map::PosedImages;
use veiloc_mapping::importers::poses::{pose_rig_images, read_posed, read_rig_cameras};

/// A trajectory of the first camera of a rig poses the images of all.
#[test]
fn images_of_a_rig_get_their_poses_from_its_reference_camera() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        std::fs::write(path, text).expect("written");
    };
    let image = |name: &str, width: u32| {
        write(name, "");
        image::GrayImage::new(width, width * 3 / 4).save(folder.path().join(name)).expect("written");
    };
    for (name, width) in
        [("cam0/1.0.png", 40), ("cam0/2.0.png", 40), ("cam1/1.0.png", 80), ("cam1/1.5.png", 80)]
    {
        image(&format!("images/{name}"), width);
    }
    write("walk/poses.txt", "1.0 1 2 3 0 0 0 1\n1.5 1 2 3 0 0 0 1\n2.0 4 5 6 0 0.70710678 0 0.70710678\n");
    write("walk/cameras.txt", "1 PINHOLE 40 30 30 30 20 15\n");
    let camera = |size: &str, focal: u32, more: &str| {
        format!(
            "  camera_model: pinhole\n  distortion_model: none\n  distortion_coeffs: []\n  intrinsics: [{focal}, {focal}, 20, 15]\n  \
             resolution: [{size}]\n{more}"
        )
    };
    let step =
        "  T_cn_cnm1:\n  - [0, 0, 1, 0.1]\n  - [0, 1, 0, 0.2]\n  - [-1, 0, 0, 0.3]\n  - [0, 0, 0, 1]\n";
    let chain = |size: &str| format!("cam0:\n{}cam1:\n{}", camera("40, 30", 31, ""), camera(size, 62, step));
    write("camchain.yaml", &chain("80, 60"));
    let images = folder.path().join("images");
    let posed = read_posed(&folder.path().join("walk/poses.txt"), &images).expect("a trajectory").images;
    let cameras = read_rig_cameras(&folder.path().join("camchain.yaml")).expect("a rig");
    let all = pose_rig_images(&posed, &cameras, &images).expect("posed");
    let mut names = all.names();
    names.sort();
    assert_eq!(names, ["cam0/1.0.png", "cam0/2.0.png", "cam1/1.0.png"]);
    assert!(
        all.remarks().iter().any(|remark| remark.starts_with("1 images of the rig are left out")),
        "{:?}",
        all.remarks()
    );
    let [first, other] = ["cam0/1.0.png", "cam1/1.0.png"].map(|name| all.get(name).expect("posed"));
    assert_eq!(first.camera.to_string(), "SIMPLE_PINHOLE,40,30,31,20.5,15.5");
    assert_eq!((other.camera.width, other.camera.pinhole().mean_focal()), (80, 62.0));
    // x of the first camera is backward of the other, and z its x.
    let point = Point3::new(1.0 + 0.5, 2.0 + 0.25, 3.0 + 2.0);
    let seen = other.cam_from_world.transform(&point).coords;
    assert!((seen - Vector3::new(2.0 + 0.1, 0.25 + 0.2, -0.5 + 0.3)).norm() < 1e-12, "{seen}");
    // A calibration of another size, and images in other folders.
    write("camchain.yaml", &chain("640, 480"));
    let cameras = read_rig_cameras(&folder.path().join("camchain.yaml")).expect("a rig");
    let error = pose_rig_images(&posed, &cameras, &images).expect_err("another size").to_string();
    assert!(error.contains("cam1") && error.contains("640x480"), "{error}");
    let error =
        pose_rig_images(&PosedImages::default(), &cameras, &images).expect_err("no image").to_string();
    assert!(error.contains("cam0/NAME"), "{error}");
}

#[test]
fn calibrations_of_rigs_agree_in_all_forms() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).expect("written");
    let camera = "  camera_model: pinhole\n  distortion_model: none\n  distortion_coeffs: []\n  intrinsics: [30, 30, 19.5, 14.5]\n  resolution: [40, 30]\n";
    let rows = |rows: [[f64; 4]; 3]| {
        let row = |r: [f64; 4]| format!("  - [{}, {}, {}, {}]\n", r[0], r[1], r[2], r[3]);
        rows.map(row).concat() + "  - [0, 0, 0, 1]\n"
    };
    let quarter = [[0.0, 0.0, 1.0, 0.1], [0.0, 1.0, 0.0, 0.2], [-1.0, 0.0, 0.0, 0.3]];
    let quarter_twice = [[-1.0, 0.0, 0.0, 0.4], [0.0, 1.0, 0.0, 0.4], [0.0, 0.0, -1.0, 0.2]];
    // A chain of three, and the same by an inertial sensor that has the frame of the first camera moved by (1, 0, 0).
    let step = rows(quarter);
    write(
        "chain.yaml",
        &format!("cam0:\n{camera}cam1:\n  T_cn_cnm1:\n{step}{camera}cam2:\n  T_cn_cnm1:\n{step}{camera}"),
    );
    let by_imu = |m: [[f64; 4]; 3]| rows(m.map(|[a, b, c, t]| [a, b, c, t + a]));
    let identity = by_imu([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);
    let [one, two] = [quarter, quarter_twice].map(by_imu);
    write(
        "imu.yaml",
        &format!(
            "imu0:\n  rate: 200\ncam0:\n{camera}  T_cam_imu:\n{identity}cam1:\n{camera}  T_cam_imu:\n{one}cam2:\n{camera}  T_cam_imu:\n{two}"
        ),
    );
    let params = "\"camera_model_name\": \"PINHOLE\", \"camera_params\": [30, 30, 20, 15]";
    let h = std::f64::consts::FRAC_1_SQRT_2;
    write(
        "rig_config.json",
        &format!(
            "[{{\"cameras\": [{{\"image_prefix\": \"cam0/\", \"ref_sensor\": true, {params}}}, \
             {{\"image_prefix\": \"cam1/\", \"cam_from_rig_rotation\": [{h}, 0, {h}, 0], \"cam_from_rig_translation\": [0.1, 0.2, 0.3], {params}}}, \
             {{\"image_prefix\": \"cam2/\", \"cam_from_rig_rotation\": [0, 0, 1, 0], \"cam_from_rig_translation\": [0.4, 0.4, 0.2], {params}}}]}}]"
        ),
    );
    let line = |id: u32| format!("{id} PINHOLE 40 30 30 30 20 15\n");
    std::fs::create_dir(folder.path().join("model")).expect("a folder");
    write("model/cameras.txt", &[1, 2, 3].map(line).concat());
    let image = |id: u32| format!("{id} 1 0 0 0 0 0 0 {id} cam{}/1.png\n\n", id - 1);
    write("model/images.txt", &[1, 2, 3].map(image).concat());
    write("model/points3D.txt", "");
    write(
        "model/rigs.txt",
        &format!("1 3 CAMERA 1 CAMERA 2 1 {h} 0 {h} 0 0.1 0.2 0.3 CAMERA 3 1 0 0 1 0 0.4 0.4 0.2\n"),
    );
    write("model/frames.txt", "1 1 1 0 0 0 0 0 0 3 CAMERA 1 1 CAMERA 2 2 CAMERA 3 3\n");
    for file in ["chain.yaml", "imu.yaml", "rig_config.json", "model"] {
        let cameras = read_rig_cameras(&folder.path().join(file)).unwrap_or_else(|e| panic!("{file}: {e}"));
        let names: Vec<&str> = cameras.iter().map(|camera| camera.name.as_str()).collect();
        assert_eq!(names, ["cam0", "cam1", "cam2"], "{file}");
        for (camera, expected) in cameras[1..].iter().zip([quarter, quarter_twice]) {
            let (r, t) = (camera.cam_from_rig.rotation(), camera.cam_from_rig.translation());
            for (i, row) in expected.iter().enumerate() {
                let own = [r[(i, 0)], r[(i, 1)], r[(i, 2)], t[i]];
                assert!(own.iter().zip(row).all(|(a, b)| (a - b).abs() < 1e-9), "{file}: {own:?} {row:?}");
            }
            let own = camera.camera((40, 30)).expect("its size");
            assert_eq!((own.pinhole().principal, own.pinhole().mean_focal()), ([20.0, 15.0], 30.0), "{file}");
        }
    }
}
