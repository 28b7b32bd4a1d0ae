//! `veiloc seal --rig-cameras`: the images of several calibrated cameras are sealed in one session, and give one pose.

use super::common;

use common::{CAMERA, POSITION_TOLERANCE, TestScene, folder, pose, scene};
use serde_json::{Value, json};
use veiloc_geometry::frames::{Camera, Rigid3};
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{Anchor, CameraFromWorld, Intrinsics};
use veiloc_protocol::{Observations, RigMessage, SealedFrame, SealedQuery};
use veiloc_synthetic::{RenderOptions, RenderedRoom};

/// The other camera has a longer focal length, another class of the camera's list, and squints.
const OTHER: &str = "OPENCV,400,300,352,350,203.5,148.5,-0.05,0.01,0.001,-0.0005";

fn other_from_first() -> Rigid3<Camera, Camera> {
    let rotation = Rotation3::from_euler_angles(0.02, 0.14, -0.03);
    Rigid3::new(rotation, Vector3::new(-0.12, 0.01, 0.02))
}

/// What two cameras see from where a query was taken, in `stereo/`.
fn images(scene: &TestScene) {
    let first = scene.pose_of("query-0.png");
    let cameras = [(first, CAMERA, "left"), (other_from_first().compose(&first), OTHER, "right")];
    std::fs::create_dir_all(scene.path("stereo")).expect("a folder");
    for (seed, (pose, camera, name)) in cameras.into_iter().enumerate() {
        let camera: Intrinsics = camera.parse().expect("valid");
        let options = RenderOptions::with_seed(80 + seed as u64);
        let view = RenderedRoom::generate(11).render(&pose, &camera, &options);
        view.rgb().save(scene.path(format!("stereo/{name}.png"))).expect("written");
    }
}

fn matrix(pose: &Rigid3<Camera, Camera>) -> String {
    let (r, t) = (pose.rotation(), pose.translation());
    let rows: Vec<String> =
        (0..3).map(|i| format!("  - [{}, {}, {}, {}]\n", r[(i, 0)], r[(i, 1)], r[(i, 2)], t[i])).collect();
    rows.concat() + "  - [0.0, 0.0, 0.0, 1.0]\n"
}

/// Kalibr's pixels count from the centre of the first; its first camera has no model with one radial term.
fn kalibr() -> String {
    format!(
        "cam0:\n  cam_overlaps: [1]\n  camera_model: pinhole\n  distortion_coeffs: [-0.04, 0.0, 0.0, 0.0]\n  distortion_model: radtan\n  \
         intrinsics: [330.0, 330.0, 200.5, 148.5]\n  resolution: [400, 300]\n  rostopic: /cam0/image_raw\ncam1:\n  T_cn_cnm1:\n{}  \
         cam_overlaps: [0]\n  camera_model: pinhole\n  distortion_coeffs: [-0.05, 0.01, 0.001, -0.0005]\n  distortion_model: radtan\n  \
         intrinsics: [352.0, 350.0, 203.0, 148.0]\n  resolution: [400, 300]\n  rostopic: /cam1/image_raw\n",
        matrix(&other_from_first())
    )
}

fn rig_config() -> Value {
    let pose = other_from_first();
    let t = pose.translation();
    json!([{"cameras": [
        {"image_prefix": "stereo/left/", "ref_sensor": true, "camera_model_name": "SIMPLE_RADIAL",
         "camera_params": [330, 201, 149, -0.04]},
        {"image_prefix": "stereo/right/", "cam_from_rig_rotation": pose.quaternion(),
         "cam_from_rig_translation": [t.x, t.y, t.z], "camera_model_name": "OPENCV",
         "camera_params": [352, 350, 203.5, 148.5, -0.05, 0.01, 0.001, -0.0005]},
    ]}])
}

/// The message of a rig file, as it would be sent.
fn message(scene: &TestScene, rig: &str) -> RigMessage {
    let document: Value = serde_json::from_slice(&scene.read(rig)).expect("JSON");
    let above = rig.rsplit_once('/').expect("a folder").0;
    let frame = |frame: &Value| {
        let query = SealedQuery::decode(
            &scene.read(&format!("{above}/{}", frame["query"].as_str().expect("a name"))),
        );
        let pose = pose(&json!({"q": frame["cam_from_rig"]["q"], "t": frame["cam_from_rig"]["t"]}));
        assert_eq!((&frame["rotation_sd_deg"], &frame["translation_sd"]), (&json!(0.0), &json!(0.0)));
        SealedFrame {
            query: query.expect("a query"),
            cam_from_rig: Rigid3::new(*pose.rotation(), *pose.translation()),
            rotation_sd_deg: 0.0,
            translation_sd: 0.0,
        }
    };
    RigMessage { frames: document["frames"].as_array().expect("frames").iter().map(frame).collect() }
}

#[test]
fn a_stereo_pair_shares_its_anchors_and_gives_one_pose() {
    let scene = scene();
    images(scene);
    scene.write("stereo/camchain.yaml", kalibr());
    scene.write("stereo/rig_config.json", rig_config().to_string());
    for (file, out, names) in [
        ("camchain.yaml", "sealed-kalibr", ["cam0.vquery", "cam1.vquery"]),
        ("rig_config.json", "sealed-colmap", ["stereo-left.vquery", "stereo-right.vquery"]),
    ] {
        let seal = format!(
            "seal stereo/left.png stereo/right.png --rig-cameras stereo/{file} --profile place.vprofile -o {out} --json"
        );
        let run = scene.run(&seal).succeeded();
        let document = run.json();
        assert_eq!(document["rig"], format!("{out}/rig.json"), "{run}");
        let outs: Vec<&str> =
            document["images"].as_array().expect("images").iter().filter_map(|i| i["out"].as_str()).collect();
        assert_eq!(outs, names.map(|name| format!("{out}/{name}")));
        let fields = &common::documented::tables()["seal"];
        assert_eq!(common::documented::mistakes(fields, std::slice::from_ref(&document)), [""; 0]);

        let rig = format!("{out}/rig.json");
        let written: Value = serde_json::from_slice(&scene.read(&rig)).expect("JSON");
        let sessions = [0, 1].map(|k| (&written["frames"][k]["session"], &document["images"][k]["session"]));
        assert!(sessions.iter().all(|(a, b)| a.is_string() && a == b && *a == sessions[0].0), "{run}");
        let sent = message(scene, &rig);
        let expected = other_from_first();
        assert!((sent.frames[1].cam_from_rig.translation() - expected.translation()).norm() < 1e-9);
        assert!(sent.frames[1].cam_from_rig.rotation().angle_to(expected.rotation()) < 1e-9);
        // The anchors are the same directions, though the lenses differ.
        let anchor = |frame: &SealedFrame| match frame.query.observations() {
            Observations::Anchored { pencils, .. } => {
                frame.cam_from_rig.rotation().inverse() * pencils.frame(Anchor::FIRST)[0]
            }
            other => panic!("{other:?} have no anchors"),
        };
        let apart = anchor(&sent.frames[0]).angle(&anchor(&sent.frames[1])).to_degrees();
        assert!(apart < 1.5, "{apart} degrees");
        assert_eq!(sent.check_anchors(), Ok(()));

        let run = scene.run(&format!("localize --map place.vmap --rig {rig} --json")).succeeded();
        let found: CameraFromWorld = pose(&run.json()["cam_from_world"]);
        assert!(scene.position_error("query-0.png", &found) < POSITION_TOLERANCE, "{run}");
        assert!(found.rotation_error_degrees(&scene.pose_of("query-0.png")) < 0.5, "{run}");
        assert!(
            run.json()["frames"].as_array().expect("frames").iter().all(|f| f["inliers"].as_u64() > Some(20)),
            "{run}"
        );
    }
    // In the units of a map that are two metres, the cameras are half as far apart.
    let seal =
        "seal stereo/left.png stereo/right.png --rig-cameras stereo/camchain.yaml --profile place.vprofile";
    scene.run(&format!("{seal} -o sealed-units --metres-per-unit 2")).succeeded();
    let half = message(scene, "sealed-units/rig.json").frames[1].cam_from_rig.translation() * 2.0;
    assert!((half - other_from_first().translation()).norm() < 1e-9);
    // Two moments in one session: with the orientation of the rig, whose anchors stay.
    let [w, x, y, z] = scene.pose_of("query-0.png").quaternion();
    for out in ["sealed-now", "sealed-then"] {
        let words = format!("--session stereo.session --orientation={w},{x},{y},{z} -o {out}");
        scene.run(&format!("{seal} {words}")).succeeded();
    }
    let mut both = message(scene, "sealed-now/rig.json");
    both.frames.extend(message(scene, "sealed-then/rig.json").frames);
    assert_eq!(both.check_anchors(), Ok(()));
    let run = scene.run(&format!("{seal} --session stereo.session -o never"));
    assert!(run.code == Some(1) && run.stderr.contains("orientation of the device"), "{run}");
    // One image cannot be sealed: the other is, and the rig file has it alone.
    image::GrayImage::new(400, 300).save(scene.path("stereo/black.png")).expect("written");
    let black = seal.replace("right.png", "black.png");
    let run = scene.run(&format!("{black} -o sealed-half"));
    assert!(run.code == Some(1) && run.stderr.contains("1 of 2 sealed"), "{run}");
    assert_eq!(message(scene, "sealed-half/rig.json").frames.len(), 1);
}

#[test]
fn unusable_rigs_are_refused() {
    let scene = folder();
    scene.write("place.vprofile", common::scene().read("place.vprofile"));
    for (name, size) in [("a.png", 400), ("b.png", 400), ("small.png", 200)] {
        image::GrayImage::new(size, size * 3 / 4).save(scene.path(name)).expect("written");
    }
    let run = |images: &str, rig: &str| {
        scene.write("rig", rig);
        scene.run(&format!("seal {images} --rig-cameras rig --profile place.vprofile -o out"))
    };
    let of_colmap = |change: &dyn Fn(&mut Value)| {
        let mut document = rig_config();
        change(&mut document);
        document.to_string()
    };
    let without = |key: &'static str| {
        of_colmap(&move |d| {
            d[0]["cameras"][1].as_object_mut().expect("a camera").remove(key).expect("present");
        })
    };
    for (images, rig, words) in [
        (
            "a.png b.png",
            kalibr().replace("camera_model: pinhole", "camera_model: omni"),
            &["cam0", "omni", "no equal"][..],
        ),
        ("a.png b.png", kalibr().replace("T_cn_cnm1", "T_cam_other"), &["cam1", "T_cn_cnm1 is missing"]),
        ("a.png b.png", kalibr().replace("cam1:", "cam2:"), &["cam1 is missing"]),
        (
            "a.png b.png",
            kalibr().split("cam1:").next().expect("a part").to_owned(),
            &["at least two cameras"],
        ),
        ("a.png b.png", "imu0:\n  rate: 200\n".to_owned(), &["no cam0", "camchain.yaml"]),
        ("a.png", kalibr(), &["1 images of a rig of 2 cameras", "in the order"]),
        ("a.png small.png", kalibr(), &["cam1", "400x300", "200x150"]),
        ("a.png b.png", without("camera_params"), &["cameras[1]", "camera_params"]),
        ("a.png b.png", without("cam_from_rig_rotation"), &["cameras[1]", "cam_from_rig_rotation"]),
        ("a.png b.png", of_colmap(&|d| *d = json!([d[0], d[0]])), &["2 rigs"]),
        (
            "a.png b.png",
            of_colmap(&|d| d[0]["cameras"][1]["image_prefix"] = "stereo/left".into()),
            &["one name"],
        ),
        ("a.png b.png", "[]".to_owned(), &["0 rigs"]),
    ] {
        let run = run(images, &rig);
        assert_eq!(run.code, Some(1), "{words:?}: {run}");
        for word in words {
            assert!(run.stderr.contains(word), "{word:?}: {run}");
        }
    }
    for more in ["--panorama", "--camera unknown", "--gravity 0,1,0"] {
        let run =
            scene.run(&format!("seal a.png b.png --rig-cameras rig --profile place.vprofile -o out {more}"));
        assert_eq!(run.code, Some(2), "{run}");
    }
}
