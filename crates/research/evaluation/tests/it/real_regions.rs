//! Regions of a real map: queries are localized in them as in the whole map. Needs `VEILOC_DATA`.
#![expect(clippy::print_stdout, reason = "its figures are those of docs/results/scale.md")]

use std::path::Path;

use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::SeedableRng as _;
use veiloc_evaluation::results::EvaluationDocument;
use veiloc_evaluation::{SceneEvaluation, evaluate_scene};
use veiloc_features::Image;
use veiloc_localization::{Localization, LocalizeOptions, localize};
use veiloc_map::colmap::read_posed;
use veiloc_map::regions::{FolderWriter, RegionFolder, SplitOptions, cut};
use veiloc_map::{MapFile, MapMemory};
use veiloc_obfuscation::{SealOptions, Sealer};
use veiloc_protocol::Scheme;
use veiloc_testdata::real_data_test;

fn names(list: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(list).expect("a list of the data");
    text.lines().map(|line| line.trim().to_owned()).filter(|line| !line.is_empty()).collect()
}

/// The whole map, in the work folder.
const MAP: &str = "place.vmap";

fn kitchen(data: &Path, regions: Option<SplitOptions>, work: &Path) -> EvaluationDocument {
    let folder = data.join("redkitchen");
    let evaluation = SceneEvaluation {
        keep_map: regions.is_none().then(|| work.join(MAP)),
        regions,
        schemes: ["points", "dcl"].map(|scheme| scheme.parse().expect("a scheme")).to_vec(),
        thresholds: ["0.02/2", "0.05/5"].map(|t| t.parse().expect("a threshold")).to_vec(),
        work: Some(work.to_owned()),
        jobs: 2,
        ..SceneEvaluation::of_scene(
            read_posed(&folder.join("posed")).expect("poses of the data"),
            folder.join("images"),
            names(&folder.join("map.txt")),
            names(&folder.join("query.txt")),
        )
    };
    evaluate_scene(&evaluation, &()).expect("evaluated")
}

/// Regions are cut from one map and give its answers.
#[real_data_test]
fn regions_answer_as_the_whole_map(data: &Path) {
    let work = tempfile::tempdir().expect("a folder");
    let whole = kitchen(data, None, work.path());
    print_figures("whole", &whole);
    queries_are_localized_in_regions(data, &whole, work.path());
    region_with_all_retrieved_images_gives_equal_pose(data, work.path());
}

/// Every query in the regions that a gateway would choose: all are localized, as many are trusted as in the whole
/// map, none wrongly, and with nearly the same errors (a region of 20 holds fewer of the ten most relevant images;
/// docs/results/scale.md).
fn queries_are_localized_in_regions(data: &Path, whole: &EvaluationDocument, work: &Path) {
    let map = whole.map.as_ref().expect("a map");
    let images = 20;
    let cut = kitchen(data, Some(SplitOptions::default().with_images(images)), work);
    print_figures(&format!("regions of {images}"), &cut);
    let regions = cut.map.as_ref().and_then(|map| map.regions.clone()).expect("regions");
    assert!(regions.count >= 83 / images && regions.largest_bytes < map.bytes, "{regions:?}");
    for (whole, cut) in whole.schemes.iter().zip(&cut.schemes) {
        assert_eq!((cut.queries, cut.recall["0.05/5"]), (whole.queries, 1.0), "{}", cut.scheme);
        assert_eq!(cut.trusted_wrong, Some(0), "{}", cut.scheme);
        let [own, of_whole] = [cut, whole].map(|s| s.trusted.expect("all are judged"));
        assert!(own >= of_whole, "{}: {own} of {of_whole}", cut.scheme);
        let [a, b] = [cut, whole].map(|s| s.median_translation.expect("most are found"));
        assert!(a < 1.4 * b, "{}: {a} m in regions, {b} m in the whole map", cut.scheme);
    }
}

/// A region that holds all images that the whole map retrieves for a query gives exactly the whole map's pose and
/// state. Its covariance differs slightly, since regions store covariances of points in single precision.
fn region_with_all_retrieved_images_gives_equal_pose(data: &Path, work: &Path) {
    let place = data.join("redkitchen");
    let posed = read_posed(&place.join("posed")).expect("poses of the data");
    let queries = names(&place.join("query.txt"));
    let whole = MapFile::open(&work.join(MAP)).expect("a map");
    let cuts = cut(&whole, &SplitOptions::default().with_images(40)).expect("cut");
    let folder = work.join("regions");
    let writer = FolderWriter::begin(&whole, "place", &folder).expect("a folder");
    let entries = cuts.iter().map(|region| writer.region(region).expect("written")).collect();
    writer.finish(&cuts, entries).expect("written");
    let open = RegionFolder::open(&folder).expect("regions");
    let regions: Vec<MapFile> =
        (0..cuts.len()).map(|n| open.open_region(n, MapMemory::Mapped).expect("a region")).collect();

    let names_in = |map: &MapFile, found: &Localization| -> Vec<String> {
        found.retrieved.iter().map(|r| map.image(r.image).name().to_owned()).collect()
    };
    // Hardly any region of forty images holds all of the default's ten.
    let mut options = LocalizeOptions::default();
    options.retrieve = 4;
    let (mut same, mut total) = (0, 0);
    for scheme in [Scheme::Points, Scheme::default()] {
        // Every third query, to save time.
        for name in queries.iter().step_by(3) {
            let camera = posed.get(name).expect("posed").camera;
            let sealing = match scheme {
                Scheme::Points => SealOptions::unprotected_points(),
                _ => SealOptions::default(),
            };
            let sealer = Sealer::new(whole.profile(), sealing).expect("its profile");
            let image = Image::open(&place.join("images").join(name)).expect("an image");
            let extracted = sealer.extract(image, camera).expect("features");
            let query = sealer.seal(extracted, &mut ChaCha20Rng::seed_from_u64(7)).expect("sealed");
            let Ok(of_whole) = localize(&query, &whole, &options) else { continue };
            let retrieved = names_in(&whole, &of_whole);
            for region in &regions {
                total += 1;
                let held: Vec<&str> = region.images().map(|image| image.name()).collect();
                if !retrieved.iter().all(|name| held.contains(&name.as_str())) {
                    continue;
                }
                let own = localize(&query, region, &options).expect("localized");
                assert_eq!(names_in(region, &own), retrieved, "{name}");
                assert_eq!(fields_of(&own), fields_of(&of_whole), "{name}");
                for k in 0..6 {
                    let (a, b) = (own.covariance[k][k], of_whole.covariance[k][k]);
                    assert!((a - b).abs() <= 1e-3 * b, "{name}: {a:e} {b:e}");
                }
                let (a, b) = (own.confidence.log_evidence, of_whole.confidence.log_evidence);
                assert!((a - b).abs() <= 1e-6 * b.abs(), "{name}: {a} {b}");
                same += 1;
            }
        }
    }
    println!("{same} of {total} answers of regions are of all that the whole map retrieves, and equal");
    assert!(same >= 7, "{same} of {total}");
}

/// A pose, bit by bit, and the other fields of an answer.
fn fields_of(found: &Localization) -> (Vec<u64>, String, usize, usize, usize) {
    let pose = &found.cam_from_world;
    let numbers = pose.rotation().matrix().iter().chain(pose.translation().iter()).copied();
    let numbers = numbers.chain([found.noise_px, found.focal_scale]);
    let state = format!("{:?}, {} doubts", found.state, found.confidence.doubts().len());
    (numbers.map(f64::to_bits).collect(), state, found.inliers, found.pairs, found.hypotheses)
}

/// Prints the figures, with `--nocapture`.
fn print_figures(what: &str, result: &EvaluationDocument) {
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
