//! `--session`: images of one scene sealed as frames that share their anchors in the world, and errors of invalid
//! sessions.

use super::common;

use common::{CAMERA, Place, folder, place};
use veiloc_geometry::Anchor;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_protocol::{Observations, SealedQuery};

/// The arguments that seal an image of the scene.
fn seal(image: &str, words: &str, out: &str) -> String {
    format!("seal images/{image} --camera {CAMERA} --profile place.vprofile {words} -o {out}")
}

/// Orientation of the camera of an image, as a device would give it.
fn held(place: &Place, image: &str) -> String {
    let [w, x, y, z] = place.pose_of(image).quaternion();
    format!("--orientation={w},{x},{y},{z}")
}

/// The first anchor of a query in the world.
fn anchor(place: &Place, image: &str, query: &str) -> Vector3<f64> {
    let query = SealedQuery::decode(&place.read(query)).expect("a query");
    match query.observations() {
        Observations::Anchored { pencils, .. } => {
            place.pose_of(image).rotation().inverse() * pencils.frame(Anchor::FIRST)[0]
        }
        other => panic!("{other:?} have no anchors"),
    }
}

#[test]
fn frames_of_a_session_share_their_anchors_and_are_localized() {
    let place = place();
    // The third has rotated so far that two halves coincide for it.
    let striped = "dcl:axis=115:sectors=20:anchors=0.23/-0.33+-0.88/-0.47";
    for (name, scheme, frames) in [("plain", "dcl", 2), ("striped", striped, 3)] {
        let mut anchors = Vec::new();
        for k in 0..frames {
            let (image, out) = (format!("query-{k}.png"), format!("{name}-{k}.vquery"));
            let words = format!("--scheme {scheme} --session {name}.session {}", held(place, &image));
            place.run(&seal(&image, &words, &out)).succeeded();
            anchors.push(anchor(place, &image, &out));
            let run = place.run(&format!("localize --map place.vmap {out} --json")).succeeded();
            assert_eq!(run.json()["queries"][0]["state"], "trusted", "{run}");
        }
        for anchor in &anchors {
            assert!(anchor.angle(&anchors[0]) < 0.01, "{scheme}: {}", anchor.angle(&anchors[0]));
        }
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            let mode =
                std::fs::metadata(place.path(format!("{name}.session"))).expect("kept").permissions().mode();
            assert_eq!(mode & 0o777, 0o600);
        }
    }
    // The same measure on frames in separate sessions.
    place.seal("query-1.png", "dcl", "alone.vquery");
    let apart =
        anchor(place, "query-1.png", "alone.vquery").angle(&anchor(place, "query-0.png", "plain-0.vquery"));
    assert!(apart > 0.05, "{apart}");
}

#[test]
fn an_image_that_is_seen_again_is_of_the_session_without_an_orientation() {
    let place = place();
    for (k, out) in ["rest-0.vquery", "rest-1.vquery", "rest-2.vquery", "rest-3.vquery"].iter().enumerate() {
        let words = format!(
            "--session rest.session --json {}",
            if k == 1 { held(place, "query-0.png") } else { String::new() }
        );
        place.run(&seal("query-0.png", &words, out)).succeeded();
        assert!(
            anchor(place, "query-0.png", out).angle(&anchor(place, "query-0.png", "rest-0.vquery")) < 1e-3
        );
    }
}

#[test]
fn the_third_start_at_one_place_is_refused() {
    let place = place();
    // The same scene from another viewpoint: a mirrored image has the same descriptors nowhere, so it is cropped and
    // shifted.
    let image = image::open(place.path("images/query-0.png")).expect("an image").to_rgb8();
    let stretched = |name: &str, factor: u32| {
        let (width, height) = image.dimensions();
        let wide = image::imageops::resize(
            &image,
            width * factor / 100,
            height,
            image::imageops::FilterType::CatmullRom,
        );
        let cut = image::imageops::crop_imm(&wide, 0, 0, width, height).to_image();
        cut.save(place.path(format!("images/{name}"))).expect("written");
    };
    stretched("wider.png", 108);
    stretched("widest.png", 116);
    let words = "--session starts.session";
    place.run(&seal("query-0.png", words, "starts-0.vquery")).succeeded();
    place.run(&seal("wider.png", words, "starts-1.vquery")).succeeded();
    let run = place.run(&seal("widest.png", words, "starts-2.vquery"));
    assert_eq!(run.code, Some(1), "{run}");
    assert!(run.stderr.contains("2 images of this scene") && run.stderr.contains("orientation"), "{run}");
    assert!(!place.path("starts-2.vquery").exists());
}

#[test]
fn anchors_are_tied_to_what_is_asked_for() {
    let place = place();
    let image = "query-0.png";
    let words = format!("--session level.session --anchors gravity {}", held(place, image));
    let run = place.run(&seal(image, &words, "level.vquery"));
    assert_eq!(run.code, Some(1), "{run}");
    assert!(run.stderr.contains("gives no gravity direction"), "{run}");
    let down: [f64; 3] = (place.pose_of(image).rotation() * Vector3::new(0.0, 0.0, -1.0)).into();
    let layout = "dcl:axis=90:sectors=16:anchors=@90+@0";
    let words = format!("{words} --scheme {layout} --gravity={},{},{}", down[0], down[1], down[2]);
    place.run(&seal(image, &words, "level.vquery")).succeeded();
    assert!(anchor(place, image, "level.vquery").z.abs() > 0.999);
    // A session does not continue with other anchors.
    let run = place.run(&seal(image, "--session level.session --anchors world", "never.vquery"));
    assert!(run.code == Some(1) && run.stderr.contains("--anchors"), "{run}");
}

#[test]
fn what_is_no_session_or_orientation_is_told() {
    let place = folder();
    place.write("images/query-0.png", "never read");
    place.write("place.vprofile", common::place().read("place.vprofile"));
    let wrong = |words: &str, code: i32, told: &[&str]| {
        let run = place.run(&seal("query-0.png", words, "never.vquery"));
        assert_eq!(run.code, Some(code), "{run}");
        assert!(told.iter().all(|word| run.stderr.contains(word)), "{run}");
        assert!(!place.path("never.vquery").exists());
    };
    wrong("--orientation 1,0,0,0", 2, &["--session"]);
    wrong("--anchors world", 2, &["--session"]);
    wrong("--session new.session --orientation 1,0,0", 2, &["quaternion"]);
    wrong("--session new.session --anchors moon", 2, &["gravity"]);
    place.write("other.session", "something else");
    wrong("--session other.session", 1, &["not a session of veiloc", "begin another"]);
    place.write("newer.session", [b"VSESSION".as_slice(), &9_u32.to_le_bytes(), &[0; 64]].concat());
    wrong("--session newer.session", 1, &["version 9"]);
    wrong("--session no/such/folder/a.session", 1, &["folder"]);
    let lock = std::fs::File::create(place.path(".held.session.lock")).expect("made");
    lock.lock().expect("locked");
    wrong("--session held.session", 1, &["another program"]);
    // An unreadable image leaves no session file.
    wrong("--session new.session", 1, &["query-0.png"]);
    assert!(!place.path("new.session").exists());
}
