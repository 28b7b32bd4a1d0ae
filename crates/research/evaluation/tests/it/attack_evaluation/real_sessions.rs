//! Sessions of real images, sealed, localized and attacked. Needs `VEILOC_DATA`.

use std::path::Path;

use veiloc_evaluation::SceneEvaluation;
use veiloc_evaluation::attack_evaluation::sessions::{
    AttackedKeypoints, Motion, SessionRow, SessionsEvaluation, evaluate_sessions,
};
use veiloc_map::colmap::read_posed;
use veiloc_obfuscation::{SessionAnchors, SessionOptions};
use veiloc_protocol::Scheme;
use veiloc_testdata::real_data_test;

const ANCHORS: [SessionAnchors; 2] = [SessionAnchors::Image, SessionAnchors::World];

fn names(list: &Path, every: usize) -> Vec<String> {
    let text = std::fs::read_to_string(list).expect("a list of the data");
    text.lines().map(|l| l.trim().to_owned()).filter(|l| !l.is_empty()).step_by(every).collect()
}

fn kitchen(data: &Path) -> SessionsEvaluation {
    let folder = data.join("redkitchen");
    let scene = SceneEvaluation {
        schemes: vec!["dcl:paper".parse().expect("a layout")],
        thresholds: vec!["0.05/5".parse().expect("a threshold")],
        ..SceneEvaluation::of_scene(
            read_posed(&folder.join("posed")).expect("poses of the data"),
            folder.join("images"),
            names(&folder.join("map.txt"), 2),
            names(&folder.join("query.txt"), 1).into_iter().take(6).collect(),
        )
    };
    SessionsEvaluation {
        scene,
        anchors: ANCHORS.to_vec(),
        motions: vec![Motion::Turning, Motion::Static],
        frames: vec![4],
        gyro_deg: vec![0.0],
        drift_deg: vec![0.0],
        // With fewer images the figures depend on where their private regions lie.
        attacked: Some(4),
        private: 0.1,
        max_distance: 0.5,
        sensor_noise: 2.0,
        session: SessionOptions::default(),
        pack: None,
    }
}

/// L10: anchors fixed in the world prevent the leakage of several frames that anchors fixed in the image have, at no
/// cost in pose accuracy.
#[real_data_test]
fn world_anchors_protect_a_session(data: &Path) {
    let document = evaluate_sessions(&kitchen(data), &()).expect("evaluated");
    println!("{}", veiloc_evaluation::attack_evaluation::sessions::table(&document));
    // The better of the methods, which an attacker can find on its own images.
    let bits = |anchors: SessionAnchors, motion: Motion, target: AttackedKeypoints| {
        let of = |r: &&SessionRow| {
            (r.condition.anchors, r.motion, r.target, r.frames) == (anchors, motion, target, 4)
        };
        let all: Vec<f64> = document.rows.iter().filter(of).filter_map(|r| r.bits_over_prior).collect();
        assert!(!all.is_empty(), "{anchors} {motion} {target:?}");
        all.into_iter().fold(f64::NEG_INFINITY, f64::max)
    };
    for motion in [Motion::Turning, Motion::Static] {
        let [image, world] = ANCHORS.map(|anchors| bits(anchors, motion, AttackedKeypoints::Matched));
        assert!(image > 0.5, "{motion}: the attack works: {image}");
        // A translating camera reveals the distance of a keypoint from the anchor's axis; a stationary one reveals
        // nothing.
        let most = if motion == Motion::Static { 0.15 } else { 0.4 };
        assert!(world < most && world < 0.5 * image, "{motion}: {image} {world}");
        // Beside map points with known depth the distance carries more information: half of that without a session.
        let [image, world] = ANCHORS.map(|anchors| bits(anchors, motion, AttackedKeypoints::Private));
        let most = if motion == Motion::Static { 0.15 } else { 0.6 * image };
        assert!(world < most, "{motion}: {image} {world}");
    }
    for frames in &document.frames {
        assert_eq!(frames.summary.recall["0.05/5"], 1.0, "{}", frames.condition.anchors);
        assert_eq!(frames.starts, if frames.condition.anchors == SessionAnchors::Image { 6 } else { 1 });
    }
    let [image, world] = [0, 1].map(|i| document.frames[i].summary.median_translation.expect("localized"));
    assert!(world < 1.5 * image, "{image} {world}");
}

#[real_data_test]
fn invalid_options_are_refused(data: &Path) {
    let refused = |change: &dyn Fn(&mut SessionsEvaluation)| {
        let mut evaluation = kitchen(data);
        change(&mut evaluation);
        evaluate_sessions(&evaluation, &()).expect_err("refused").to_string()
    };
    assert!(refused(&|e| e.frames = vec![1]).contains("at least two"));
    assert!(refused(&|e| e.frames = vec![2, 20]).contains("6 images"));
    assert!(refused(&|e| e.private = 1.0).contains("private region"));
    assert!(refused(&|e| e.gyro_deg = vec![f64::NAN]).contains("NaN"));
    assert!(refused(&|e| e.scene.schemes = vec![Scheme::Points]).contains("points"));
    assert!(refused(&|e| e.anchors.clear()).contains("nothing"));
}
