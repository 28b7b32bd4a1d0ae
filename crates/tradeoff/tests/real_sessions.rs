//! Sessions of real images, sealed, localized and attacked. Needs `VEILOC_DATA`.

use std::path::Path;

use veiloc_eval::SceneEvaluation;
use veiloc_localize::LocalizeOptions;
use veiloc_map::colmap::read_posed;
use veiloc_mapping::BuildOptions;
use veiloc_obfuscation::{SessionAnchors, SessionOptions};
use veiloc_query::Scheme;
use veiloc_testdata::real_data_test;
use veiloc_tradeoff::sessions::{Motion, SessionsEvaluation, evaluate_sessions};

fn names(list: &Path, every: usize) -> Vec<String> {
    let text = std::fs::read_to_string(list).expect("a list of the data");
    text.lines().map(|l| l.trim().to_owned()).filter(|l| !l.is_empty()).step_by(every).collect()
}

fn kitchen(data: &Path) -> SessionsEvaluation {
    let folder = data.join("redkitchen");
    let place = SceneEvaluation {
        posed: read_posed(&folder.join("posed")).expect("poses of the data"),
        images: folder.join("images"),
        map_list: names(&folder.join("map.txt"), 2),
        query_list: names(&folder.join("query.txt"), 1).into_iter().take(6).collect(),
        query_cameras: std::collections::BTreeMap::new(),
        keep_map: None,
        build: BuildOptions::default(),
        schemes: vec![Scheme::default()],
        scores: Vec::new(),
        thresholds: vec!["0.05/5".parse().expect("a threshold")],
        localize: LocalizeOptions::default(),
        gravity_sd_deg: None,
        negatives: None,
        seed: 0,
    };
    SessionsEvaluation {
        place,
        anchors: vec![SessionAnchors::Image, SessionAnchors::World],
        motions: vec![Motion::Turning, Motion::Walking, Motion::Resting],
        frames: vec![2, 4],
        gyro_deg: vec![0.0],
        drift_deg: vec![0.0],
        attacked: Some(2),
        private: 0.1,
        reach: 0.5,
        sensor_noise: 2.0,
        session: SessionOptions::default(),
    }
}

/// L10: what several frames give away with anchors tied to the image they do not with anchors tied to the world, at no
/// cost in poses.
#[real_data_test]
fn anchors_in_the_world_hold_over_a_session(data: &Path) {
    let document = evaluate_sessions(&kitchen(data), &()).expect("evaluated");
    let bits = |anchors: &str, motion: Motion, frames: usize| {
        let of =
            document.rows.iter().filter(|r| r.anchors == anchors && r.motion == motion && r.frames == frames);
        let all: Vec<f64> = of.filter_map(|r| r.bits_over_prior).collect();
        assert!(all.len() >= 2, "{anchors} {motion} {frames}: {all:?}");
        all.into_iter().fold(f64::NEG_INFINITY, f64::max)
    };
    for motion in [Motion::Turning, Motion::Walking, Motion::Resting] {
        let [image, world] = ["image", "world"].map(|anchors| bits(anchors, motion, 4));
        assert!(image > 0.5, "{motion}: the attack works: {image}");
        assert!(world < 0.25 && world < image - 0.4, "{motion}: {image} {world}");
        assert!(bits("image", motion, 2) < image, "{motion}: more frames tell more");
    }
    for frames in &document.frames {
        assert_eq!(frames.summary.recall["0.05/5"], 1.0, "{}", frames.anchors);
        assert_eq!(frames.starts, if frames.anchors == "image" { 6 } else { 1 });
    }
    let [image, world] = [0, 1].map(|i| document.frames[i].summary.median_translation.expect("localized"));
    assert!(world < 1.5 * image, "{image} {world}");
}

#[real_data_test]
fn what_makes_no_sense_is_refused(data: &Path) {
    let refused = |change: &dyn Fn(&mut SessionsEvaluation)| {
        let mut evaluation = kitchen(data);
        change(&mut evaluation);
        evaluate_sessions(&evaluation, &()).expect_err("refused").to_string()
    };
    assert!(refused(&|e| e.frames = vec![1]).contains("two at least"));
    assert!(refused(&|e| e.frames = vec![2, 20]).contains("6 images"));
    assert!(refused(&|e| e.private = 1.0).contains("private region"));
    assert!(refused(&|e| e.gyro_deg = vec![f64::NAN]).contains("NaN"));
    assert!(refused(&|e| e.place.schemes = vec![Scheme::Points]).contains("points"));
    assert!(refused(&|e| e.anchors.clear()).contains("nothing"));
}
