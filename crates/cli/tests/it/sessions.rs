//! `--session`: images of one scene sealed as frames that share their anchors in the world, and errors of invalid
//! sessions.

use super::common;

use common::{CAMERA, TestScene, folder, scene};
use veiloc_geometry::Anchor;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_protocol::{Observations, SealedQuery};

/// The arguments that seal an image of the scene.
fn seal(image: &str, words: &str, out: &str) -> String {
    format!("seal images/{image} --camera {CAMERA} --profile place.vprofile {words} -o {out}")
}

/// Orientation of the camera of an image, as a device would give it.
fn orientation_of(scene: &TestScene, image: &str) -> String {
    let [w, x, y, z] = scene.pose_of(image).quaternion();
    format!("--orientation={w},{x},{y},{z}")
}

/// The first anchor of a query in the world.
fn anchor(scene: &TestScene, image: &str, query: &str) -> Vector3<f64> {
    let query = SealedQuery::decode(&scene.read(query)).expect("a query");
    match query.observations() {
        Observations::Anchored { pencils, .. } => {
            scene.pose_of(image).rotation().inverse() * pencils.frame(Anchor::FIRST)[0]
        }
        other => panic!("{other:?} have no anchors"),
    }
}

#[test]
fn frames_of_a_session_share_their_anchors_and_are_localized() {
    let scene = scene();
    // The third has rotated so far that two halves coincide for it.
    let striped = "dcl:axis=115:sectors=20:anchors=0.23/-0.33+-0.88/-0.47";
    for (name, scheme, frames) in [("plain", "dcl", 2), ("striped", striped, 3)] {
        let mut anchors = Vec::new();
        for k in 0..frames {
            let (image, out) = (format!("query-{k}.png"), format!("{name}-{k}.vquery"));
            let words =
                format!("--scheme {scheme} --session {name}.session {}", orientation_of(scene, &image));
            scene.run(&seal(&image, &words, &out)).succeeded();
            anchors.push(anchor(scene, &image, &out));
            let run = scene.run(&format!("localize --map place.vmap {out} --json")).succeeded();
            assert_eq!(run.json()["queries"][0]["state"], "trusted", "{run}");
        }
        for anchor in &anchors {
            assert!(anchor.angle(&anchors[0]) < 0.01, "{scheme}: {}", anchor.angle(&anchors[0]));
        }
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            let mode =
                std::fs::metadata(scene.path(format!("{name}.session"))).expect("kept").permissions().mode();
            assert_eq!(mode & 0o777, 0o600);
        }
    }
    // The same measure on frames in separate sessions.
    scene.seal("query-1.png", "dcl", "alone.vquery");
    let apart =
        anchor(scene, "query-1.png", "alone.vquery").angle(&anchor(scene, "query-0.png", "plain-0.vquery"));
    assert!(apart > 0.05, "{apart}");
}

#[test]
fn repeated_view_joins_session_without_orientation() {
    let scene = scene();
    for (k, out) in ["rest-0.vquery", "rest-1.vquery", "rest-2.vquery", "rest-3.vquery"].iter().enumerate() {
        let words = format!(
            "--session rest.session --json {}",
            if k == 1 { orientation_of(scene, "query-0.png") } else { String::new() }
        );
        scene.run(&seal("query-0.png", &words, out)).succeeded();
        assert!(
            anchor(scene, "query-0.png", out).angle(&anchor(scene, "query-0.png", "rest-0.vquery")) < 1e-3
        );
    }
}

#[test]
fn third_session_start_at_one_position_is_refused() {
    let scene = scene();
    // The same scene from another viewpoint: a mirrored image has the same descriptors nowhere, so it is cropped and
    // shifted.
    let image = image::open(scene.path("images/query-0.png")).expect("an image").to_rgb8();
    let stretched = |name: &str, factor: u32| {
        let (width, height) = image.dimensions();
        let wide = image::imageops::resize(
            &image,
            width * factor / 100,
            height,
            image::imageops::FilterType::CatmullRom,
        );
        let cut = image::imageops::crop_imm(&wide, 0, 0, width, height).to_image();
        cut.save(scene.path(format!("images/{name}"))).expect("written");
    };
    stretched("wider.png", 108);
    stretched("widest.png", 116);
    let words = "--session starts.session";
    scene.run(&seal("query-0.png", words, "starts-0.vquery")).succeeded();
    scene.run(&seal("wider.png", words, "starts-1.vquery")).succeeded();
    let run = scene.run(&seal("widest.png", words, "starts-2.vquery"));
    assert_eq!(run.code, Some(1), "{run}");
    assert!(run.stderr.contains("2 images of this scene") && run.stderr.contains("orientation"), "{run}");
    assert!(!scene.path("starts-2.vquery").exists());
}

#[test]
fn anchors_are_fixed_to_requested_frame() {
    let scene = scene();
    let image = "query-0.png";
    let words = format!("--session level.session --anchors gravity {}", orientation_of(scene, image));
    let run = scene.run(&seal(image, &words, "level.vquery"));
    assert_eq!(run.code, Some(1), "{run}");
    assert!(run.stderr.contains("no gravity direction"), "{run}");
    let down: [f64; 3] = (scene.pose_of(image).rotation() * Vector3::new(0.0, 0.0, -1.0)).into();
    let layout = "dcl:axis=90:sectors=16:anchors=@90+@0";
    let words = format!("{words} --scheme {layout} --gravity={},{},{}", down[0], down[1], down[2]);
    scene.run(&seal(image, &words, "level.vquery")).succeeded();
    assert!(anchor(scene, image, "level.vquery").z.abs() > 0.999);
    // A session does not continue with other anchors.
    let run = scene.run(&seal(image, "--session level.session --anchors world", "never.vquery"));
    assert!(run.code == Some(1) && run.stderr.contains("--anchors"), "{run}");
}

#[test]
fn invalid_sessions_and_orientations_are_refused() {
    let scene = folder();
    scene.write("images/query-0.png", "never read");
    scene.write("place.vprofile", common::scene().read("place.vprofile"));
    let wrong = |words: &str, code: i32, expected: &[&str]| {
        let run = scene.run(&seal("query-0.png", words, "never.vquery"));
        assert_eq!(run.code, Some(code), "{run}");
        assert!(expected.iter().all(|word| run.stderr.contains(word)), "{run}");
        assert!(!scene.path("never.vquery").exists());
    };
    wrong("--orientation 1,0,0,0", 2, &["--session"]);
    wrong("--anchors world", 2, &["--session"]);
    wrong("--session new.session --orientation 1,0,0", 2, &["quaternion"]);
    wrong("--session new.session --anchors moon", 2, &["gravity"]);
    scene.write("other.session", "something else");
    wrong("--session other.session", 1, &["not a session of veiloc", "begin another"]);
    scene.write("newer.session", [b"VSESSION".as_slice(), &9_u32.to_le_bytes(), &[0; 64]].concat());
    wrong("--session newer.session", 1, &["version 9"]);
    wrong("--session no/such/folder/a.session", 1, &["folder"]);
    let lock = std::fs::File::create(scene.path(".held.session.lock")).expect("made");
    lock.lock().expect("locked");
    wrong("--session held.session", 1, &["another program"]);
    // An unreadable image leaves no session file.
    wrong("--session new.session", 1, &["query-0.png"]);
    assert!(!scene.path("new.session").exists());
}
