//! Regions of a real place: queries are localized in them as in the whole map. Needs `VEILOC_DATA`.
#![expect(clippy::print_stdout, reason = "its figures are those of docs/scale.md")]

use std::path::Path;

use veiloc_eval::{SceneEvaluation, evaluate_scene};
use veiloc_map::colmap::read_posed;
use veiloc_regions::SplitOptions;
use veiloc_results::Evaluation;
use veiloc_testdata::real_data_test;

fn names(list: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(list).expect("a list of the data");
    text.lines().map(|line| line.trim().to_owned()).filter(|line| !line.is_empty()).collect()
}

fn kitchen(data: &Path, regions: Option<SplitOptions>, work: &Path) -> Evaluation {
    let folder = data.join("redkitchen");
    let evaluation = SceneEvaluation {
        regions,
        schemes: ["points", "dcl"].map(|scheme| scheme.parse().expect("a scheme")).to_vec(),
        thresholds: ["0.02/2", "0.05/5"].map(|t| t.parse().expect("a threshold")).to_vec(),
        work: Some(work.to_owned()),
        jobs: 2,
        ..SceneEvaluation::of_place(
            read_posed(&folder.join("posed")).expect("poses of the data"),
            folder.join("images"),
            names(&folder.join("map.txt")),
            names(&folder.join("query.txt")),
        )
    };
    evaluate_scene(&evaluation, &()).expect("evaluated")
}

/// Every query in the regions that a gateway would ask: all are found and as many trusted as in the whole map, none wrongly, and
/// nearly as exactly (a region of 20 holds fewer of the ten images that see most; docs/scale.md).
#[real_data_test]
fn queries_are_localized_in_their_region_as_in_the_whole_map(data: &Path) {
    let work = tempfile::tempdir().expect("a folder");
    let whole = kitchen(data, None, work.path());
    told("whole", &whole);
    let map = whole.map.as_ref().expect("a map");
    for (images, error) in [(40, 1.25), (20, 1.4)] {
        let cut = kitchen(data, Some(SplitOptions::default().with_images(images)), work.path());
        told(&format!("regions of {images}"), &cut);
        let regions = cut.map.as_ref().and_then(|map| map.regions.clone()).expect("regions");
        assert!(regions.count >= 83 / images && regions.largest_bytes < map.bytes, "{regions:?}");
        for (whole, cut) in whole.schemes.iter().zip(&cut.schemes) {
            assert_eq!((cut.queries, cut.recall["0.05/5"]), (whole.queries, 1.0), "{}", cut.scheme);
            assert_eq!(cut.trusted_wrong, Some(0), "{}", cut.scheme);
            let [own, of_whole] = [cut, whole].map(|s| s.trusted.expect("all are judged"));
            assert!(own >= of_whole, "{}: {own} of {of_whole}", cut.scheme);
            let [a, b] = [cut, whole].map(|s| s.median_translation.expect("most are found"));
            assert!(a < error * b, "{}: {a} m in regions, {b} m in the whole map", cut.scheme);
        }
    }
}

/// The figures, with `--nocapture`.
fn told(what: &str, result: &Evaluation) {
    let map = result.map.as_ref().expect("a map");
    println!("{what}: {} images, {} bytes, {:?}", map.images, map.bytes, map.regions);
    for s in &result.schemes {
        let [cm, degrees] = [s.median_translation.map(|t| 100.0 * t), s.median_rotation_deg];
        println!(
            "  {}: {cm:?} cm / {degrees:?}°, {:?}, {:?} of {} trusted, {:?} wrongly",
            s.scheme, s.recall, s.trusted, s.queries, s.trusted_wrong
        );
    }
}
