//! Trusted, doubtful, not found: the same in text, JSON and exit codes, for one query and for several.

use super::common;

use common::{CAMERA, TestScene, scene};

/// Seals three images: one of the scene, one that shows just enough of it for a doubtful pose, one of another scene.
fn sealed() -> &'static TestScene {
    static READY: std::sync::Once = std::sync::Once::new();
    let scene = scene();
    READY.call_once(|| {
        seal_window(scene, "whole", 100);
        seal_window(scene, "none", 0);
        // The result of a sealed query is deterministic: the first window with a doubtful pose serves all tests.
        let found = (8..80).step_by(3).any(|percent| {
            seal_window(scene, "half", percent);
            let run = scene.run("localize --map place.vmap states-half.vquery --json");
            run.json()["queries"][0]["state"] == "doubtful"
        });
        assert!(found, "no window of the image has a doubtful pose");
    });
    scene
}

/// Seals an image whose middle part, in percent of the width, shows the scene, and the rest other texture.
fn seal_window(scene: &TestScene, name: &str, percent: u32) {
    let mut image = image::open(scene.path("images/query-0.png")).expect("an image").to_rgb8();
    let width = image.width();
    let shown = width * percent / 100;
    let from = (width - shown) / 2;
    for (x, y, pixel) in image.enumerate_pixels_mut().filter(|(x, ..)| !(from..from + shown).contains(x)) {
        let hash = (x / 3).wrapping_mul(0x9E37_79B1) ^ (y / 3).wrapping_mul(0x85EB_CA77);
        *pixel = image::Rgb([(hash.wrapping_mul(0xC2B2_AE3D) >> 24) as u8; 3]);
    }
    image.save(scene.path(format!("states-{name}.png"))).expect("written");
    let seal = format!("seal states-{name}.png --camera {CAMERA} --profile place.vprofile --scheme points");
    scene.run(&format!("{seal} -o states-{name}.vquery")).succeeded();
}

fn localize(names: &str, options: &str) -> common::Run {
    let files: Vec<String> = names.split(' ').map(|name| format!("states-{name}.vquery")).collect();
    sealed().run(&format!("localize --map place.vmap {options} {}", files.join(" ")))
}

#[test]
fn every_state_has_a_word_and_an_exit_code() {
    for (name, state, code) in [("whole", "trusted", 0), ("half", "doubtful", 4), ("none", "not-found", 1)] {
        let run = localize(name, "--json");
        assert_eq!(run.code, Some(code), "{name}: {run}");
        let document = run.json();
        let query = &document["queries"][0];
        assert_eq!(query["state"], state, "{run}");
        assert_eq!(document[state.replace('-', "_")], 1, "{run}");
        assert_eq!(query.get("cam_from_world").is_some(), state != "not-found", "{run}");
        assert_eq!(query["doubts"][0]["kind"].is_string(), state == "doubtful", "{run}");
        assert_eq!(query["error"]["kind"].is_string(), state == "not-found", "{run}");
        let text = localize(name, "");
        assert_eq!(text.code, Some(code));
        assert!(text.stdout.contains(&format!("  {state} ")), "{text}");
        if let Some(sd) = query["position_sd"].as_f64() {
            assert!(text.stdout.contains(&format!("± {}", veiloc_report::significant(sd))), "{sd}: {text}");
            assert!(query["noise_px"].as_f64().is_some_and(|noise| noise > 0.0), "{run}");
            assert!(query["focal_scale"].as_f64().is_some_and(|scale| scale > 0.0), "{run}");
        }
    }
}

#[test]
fn exit_code_of_several_is_that_of_the_worst_pose() {
    for (names, options, code) in [
        ("whole whole", "", 0),
        ("whole none", "", 0),
        ("whole half", "", 4),
        ("half none", "", 4),
        ("none none", "", 1),
        ("whole half missing", "", 1),
        ("whole half missing", "--skip-bad", 4),
        ("whole missing", "--skip-bad", 0),
        ("whole half", "--trusted-only", 0),
        ("half none", "--trusted-only", 1),
        ("half", "--trusted-only", 1),
        ("whole", "--trusted-only", 0),
    ] {
        let run = localize(names, options);
        assert_eq!(run.code, Some(code), "{names} {options}: {run}");
    }
    let run = localize("whole half none", "");
    assert!(run.stderr.contains("2 of 3 localized, 1 doubtful, 1 not localized"), "{run}");
}

#[test]
fn withheld_pose_is_absent_from_output() {
    let shown = localize("half", "--json").json()["queries"][0].clone();
    let run = localize("half", "--json --trusted-only");
    let withheld = run.json()["queries"][0].clone();
    assert_eq!((&withheld["state"], &withheld["doubts"]), (&"doubtful".into(), &shown["doubts"]));
    for field in ["cam_from_world", "center", "covariance", "position_sd"] {
        assert!(shown.get(field).is_some() && withheld.get(field).is_none(), "{field}: {run}");
    }
    let text = localize("half", "--trusted-only");
    assert!(text.stdout.contains("doubtful") && text.stdout.contains("withheld"), "{text}");
    assert!(!text.stdout.contains("at ("), "{text}");
}

/// A wrong position hint gives no pose; a correct one does not change the result.
#[test]
fn position_hint_is_checked_and_used() {
    let center = localize("whole", "--json").json()["queries"][0]["center"].clone();
    let at = |i: usize| center[i].as_f64().expect("a number");
    let near = format!("--near={:.2},{:.2},{:.2},1", at(0), at(1), at(2));
    let run = localize("whole", &near);
    assert_eq!(run.code, Some(0), "{run}");
    for bad in ["1,2,3", "1,2,3,0", "1,2,3,-1", "NaN,0,0,1", "here"] {
        let run = localize("whole", &format!("--near {bad}"));
        assert!(run.code == Some(2) && run.stderr.contains("X,Y,Z,SD"), "{bad}: {run}");
    }
}
