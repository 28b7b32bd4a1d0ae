//! `problems.jsonl` from a scene with known poses: the matches of localization, together with the ground truth.
//!
//! The pose stage is compared and calibrated on them. The map is built and opened as on a server, keypoints are sent
//! under the scheme `points`, and matching is that of localization.

use std::path::Path;

use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use veiloc_datasets::problem_files::problems::{CameraLine, PoseLine, ProblemLine};
use veiloc_datasets::problem_files::{KeypointImage, seed_for};
use veiloc_features::Progress;
use veiloc_localization::matching::{PairEvidence, match_points};
use veiloc_localization::observe_matches;
use veiloc_localization::retrieval::retrieve;
use veiloc_map::MapFile;
use veiloc_obfuscation::SealTruth;
use veiloc_pose::Correspondences;
use veiloc_protocol::{Observations, QueryContent, Scheme, SealedQuery};

use crate::SceneEvaluation;
use crate::error::EvalError;
use crate::pipeline::{PosedQuery, SceneMap, image_of, posed_queries};

/// One query as a problem, and all of its sent keypoints.
#[derive(Debug, Clone, PartialEq)]
pub struct GeneratedProblem {
    /// Its line of `problems.jsonl`.
    pub line: String,
    /// All its keypoints with descriptors, strongest first, matched or not, at exactly the positions of the problem.
    /// Decoys, which only a query below the smallest size class has, come last.
    pub keypoints: KeypointImage,
}

/// One problem per query, in the order of the list; with `of_map` also one per image of the map, after them and without
/// masks.
///
/// Pixels belong to the query's canonical camera, quantized to 1/65536 of the image as under the scheme `points`.
///
/// # Errors
/// [`EvalError`] when data is missing, the map cannot be built, or a query has too few keypoints to be sealed.
pub fn make_problems(
    scene: &SceneEvaluation,
    of_map: bool,
    progress: &dyn Progress,
) -> Result<Vec<GeneratedProblem>, EvalError> {
    let added: &[String] = if of_map { &scene.map_list } else { &[] };
    let queries = posed_queries(&scene.posed, &scene.images, &[&scene.query_list, added].concat())?;
    let map = SceneMap::build(&scene.map_input(&scene.map_list), &scene.build, false, None, None, progress)?;
    progress.start("Matching queries", queries.len());
    let made = |(index, query): (usize, &PosedQuery)| {
        let mask = scene.mask_of(&query.name).filter(|_| index < scene.query_list.len());
        let made = make_problem(&map.file, query, mask.as_deref(), scene)?;
        progress.advance(1);
        Ok(made)
    };
    let problems = queries.iter().enumerate().map(made).collect();
    progress.finish();
    problems
}

fn make_problem(
    map: &MapFile,
    query: &PosedQuery,
    mask: Option<&Path>,
    scene: &SceneEvaluation,
) -> Result<GeneratedProblem, EvalError> {
    let sealer = scene.sealer(map.profile(), Scheme::Points)?;
    let extracted = sealer.extract(image_of(&query.path, mask)?, query.camera)?;
    let strengths: Vec<f32> = extracted.features().keypoints.iter().map(|k| k.response).collect();
    let mut rng = ChaCha20Rng::seed_from_u64(seed_for(scene.seed, &[&query.name]));
    let (sealed, truth) = sealer
        .seal_with_truth(extracted, &mut rng)
        .map_err(|e| EvalError::DataSet(format!("{}: {e}", query.name)))?;
    let line = line(map, query, scene, &sealed)?;
    Ok(GeneratedProblem {
        line: serde_json::to_string(&line).map_err(|e| EvalError::DataSet(format!("{}: {e}", query.name)))?,
        keypoints: keypoints(&query.name, &sealed, &truth, &strengths),
    })
}

/// The sent keypoints, strongest first.
fn keypoints(name: &str, sealed: &SealedQuery, truth: &SealTruth, strengths: &[f32]) -> KeypointImage {
    let strength = |row: &usize| truth.source[*row].map_or(f32::NEG_INFINITY, |feature| strengths[feature]);
    let mut order: Vec<usize> = (0..truth.source.len()).collect();
    order.sort_by(|a, b| strength(b).total_cmp(&strength(a)).then(truth.source[*a].cmp(&truth.source[*b])));
    let pixels = match sealed.observations() {
        Observations::Points(pixels) => pixels,
        // This function does not use these schemes: they have no positions.
        Observations::Lines(_) | Observations::EitherLine(_) | Observations::Anchored { .. } => Vec::new(),
    };
    let descriptors = sealed.descriptors().map(|rows| rows.to_owned().select(order.iter().copied()));
    let camera = sealed.camera();
    KeypointImage {
        name: name.to_owned(),
        width: camera.width,
        height: camera.height,
        keypoints: order.iter().filter_map(|row| pixels.get(*row).copied()).collect(),
        descriptors,
    }
}

fn line(
    map: &MapFile,
    query: &PosedQuery,
    scene: &SceneEvaluation,
    sealed: &SealedQuery,
) -> Result<ProblemLine, EvalError> {
    let QueryContent::Described { descriptors, global } = sealed.content() else {
        return Err(EvalError::DataSet(format!("{}: a query without descriptors", query.name)));
    };
    let retrieved = retrieve(global, map.into(), scene.localize().retrieve);
    let matches = match_points(descriptors.view(), map.into(), &retrieved, &scene.localize().matching);
    let evidence = matches.iter().map(|m| match m.evidence {
        PairEvidence::Descriptors { ratio, votes } => (f64::from(ratio), votes),
        // A device with a pack does not say.
        PairEvidence::Device(_) => (1.0, 1),
    });
    let (ratio, votes) = evidence.unzip();
    let rows: Vec<usize> = matches.iter().map(|m| m.query).collect();
    let Correspondences::Points { pixels } = observe_matches(&sealed.observations(), &rows).correspondences
    else {
        return Err(EvalError::DataSet(format!("{}: the scheme points gave no points", query.name)));
    };
    let camera = sealed.camera();
    Ok(ProblemLine {
        name: query.name.clone(),
        camera: CameraLine {
            model: "PINHOLE".to_owned(),
            width: camera.width,
            height: camera.height,
            params: vec![camera.focal[0], camera.focal[1], camera.principal[0], camera.principal[1]],
        },
        points2d: pixels.iter().map(|p| [p.u, p.v]).collect(),
        points3d: matches.iter().map(|m| map.point(m.point).coords.into()).collect(),
        cam_from_world: PoseLine {
            q: query.cam_from_world.quaternion(),
            t: (*query.cam_from_world.translation()).into(),
        },
        features: Some(map.profile().descriptor_kind().name().to_owned()),
        ratio: Some(ratio),
        votes: Some(votes),
        track_length: Some(matches.iter().map(|m| map.seen_by(m.point) as u32).collect()),
        seen_from: Some(
            matches
                .iter()
                .map(|m| {
                    let seen = m.viewpoint(map);
                    [seen.center.coords.x, seen.center.coords.y, seen.center.coords.z, seen.focal_px]
                })
                .collect(),
        ),
        gravity_in_camera: None,
        gravity_in_world: None,
    })
}
