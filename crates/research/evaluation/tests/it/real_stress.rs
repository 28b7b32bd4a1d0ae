//! Stress and negatives on real images. Needs `VEILOC_DATA`.

use std::path::Path;

use veiloc_evaluation::SceneEvaluation;
use veiloc_evaluation::negatives::{CameraSource, NegativeImage, NegativesEvaluation, evaluate_negatives};
use veiloc_evaluation::stress::{StressCondition, StressEvaluation, evaluate_stress};
use veiloc_features::Extractors;
use veiloc_localization::LocalizeOptions;
use veiloc_map::MapFile;
use veiloc_map::colmap::read_posed;
use veiloc_mapping::{BuildOptions, Input, build};
use veiloc_pose::State;
use veiloc_protocol::Scheme;
use veiloc_testdata::real_data_test;

fn names(list: &Path, every: usize) -> Vec<String> {
    let text = std::fs::read_to_string(list).expect("a list of the data");
    let names = text.lines().map(|l| l.trim().to_owned()).filter(|l| !l.is_empty());
    names.step_by(every).collect()
}

/// Difficult conditions reduce accuracy, not the recall of the scene; the search finds the optimum of its objective.
#[real_data_test]
fn stress_conditions_of_redkitchen(data: &Path) {
    let kitchen = data.join("redkitchen");
    let posed = read_posed(&kitchen.join("posed")).expect("poses of the data");
    let (map, queries) = (names(&kitchen.join("map.txt"), 2), names(&kitchen.join("query.txt"), 5));
    let mut evaluation = StressEvaluation::new(SceneEvaluation {
        schemes: vec![Scheme::Points, Scheme::RandomLines, Scheme::default()],
        thresholds: vec!["0.25/2".parse().expect("well written")],
        ..SceneEvaluation::of_scene(posed, kitchen.join("images"), map, queries)
    });
    evaluation.stresses =
        vec![StressCondition::Dark, StressCondition::LowResolution, StressCondition::FewKeypoints];
    evaluation.from_truth = true;
    let result = evaluate_stress(&evaluation, &()).expect("evaluated");
    assert_eq!((result.rows.len(), result.queries.len()), (4 * 3, 4 * 3 * 6));
    for row in &result.rows {
        let name = format!("{} {}", row.stress, row.scheme);
        assert!(row.recall["0.25/2"] >= 0.8, "{name}: {}", row.recall["0.25/2"]);
        assert_eq!(row.trusted_wrong, 0, "{name}");
        let optimum = row.optimum.as_ref().expect("it was requested");
        assert!(optimum.recall["0.25/2"] >= 0.8, "{name}: {}", optimum.recall["0.25/2"]);
        assert!(row.search_failures <= Some(1), "{name}: {:?} lost", row.search_failures);
    }
}

/// A focal length that is called calibrated and is wrong by 30 %: the first search may end at a camera with another
/// principal point instead, which explains many matches and is half a metre away.
#[real_data_test]
fn wrong_focal_length_leads_to_no_wrong_trusted_pose(data: &Path) {
    let kitchen = data.join("redkitchen");
    let posed = read_posed(&kitchen.join("posed")).expect("poses of the data");
    let (map, queries) = (names(&kitchen.join("map.txt"), 2), names(&kitchen.join("query.txt"), 1));
    let mut evaluation = StressEvaluation::new(SceneEvaluation {
        thresholds: vec!["0.25/2".parse().expect("well written")],
        ..SceneEvaluation::of_scene(posed, kitchen.join("images"), map, queries)
    });
    evaluation.stresses = vec![StressCondition::Focal(30)];
    let result = evaluate_stress(&evaluation, &()).expect("evaluated");
    let queries = || result.queries.iter().filter(|query| query.stress == "focal-30");
    for query in queries().filter(|query| query.state == State::Trusted) {
        let over_sd = query.uncertainty.as_ref().and_then(|uncertainty| uncertainty.center_error_over_sd);
        assert!(
            over_sd.is_some_and(|over_sd| over_sd < 5.0),
            "{}: {over_sd:?}, before 13 and more",
            query.name
        );
    }
    let row = result.rows.iter().find(|row| row.stress == "focal-30").expect("its row");
    assert!(queries().count() == 29 && row.recall["0.25/2"] >= 0.9, "{}", row.recall["0.25/2"]);
}

/// Out-of-map images are not localized in a kitchen, and an image without texture cannot be sealed.
#[real_data_test]
fn out_of_map_images_are_not_trusted(data: &Path) {
    let kitchen = data.join("redkitchen");
    let posed = read_posed(&kitchen.join("posed")).expect("poses of the data");
    let (folder, map) = (kitchen.join("images"), names(&kitchen.join("map.txt"), 4));
    let input = Input::new(&posed, &folder).with_names(&map);
    let (model, _) = build(&input, &BuildOptions::default(), &()).expect("a map");
    let temporary = tempfile::tempdir().expect("temporary folder");
    let path = temporary.path().join("kitchen.vmap");
    veiloc_map::write(&model, &path).expect("written");
    let map = MapFile::open(&path).expect("a map");

    let streets = data.join("training-photos/streets");
    let mut files: Vec<_> = std::fs::read_dir(&streets)
        .expect("a folder of the data")
        .map(|entry| entry.expect("readable").path())
        .collect();
    files.sort();
    let images: Vec<NegativeImage> = files
        .iter()
        .step_by(10)
        .map(|path| NegativeImage { name: path.display().to_string(), path: path.clone(), camera: None })
        .collect();
    let evaluation = NegativesEvaluation {
        images: images.clone(),
        schemes: vec![Scheme::Points, Scheme::default()],
        localize: LocalizeOptions::default(),
        seed: 0,
        random_gravity_sd_deg: None,
        extractors: Extractors::for_sealing(),
        global: None,
    };
    let result = evaluate_negatives(&map, &evaluation, &()).expect("evaluated");
    assert!(images.len() >= 8 && result.unread.is_empty(), "{} images", images.len());
    for row in &result.rows {
        assert_eq!((row.negatives, row.trusted), (images.len(), 0), "{}", row.scheme);
        assert_eq!(row.cameras[CameraSource::Assumed.name()], images.len());
    }
    assert!(result.queries.iter().all(|q| q.state != State::Trusted));
}
