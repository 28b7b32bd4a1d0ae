//! `veiloc eval scene`: the whole road on a place with known poses.
//!
//! The map is built, written and opened again as a server would; every query is sealed, encoded and decoded as if it
//! had crossed a network. No stage is short-cut because truth is at hand.

mod negatives;
mod options;
mod queries;

use std::path::Path;
use std::time::Instant;

use veiloc_features::Progress;
use veiloc_localize::{LocalizeOptions, localize};
use veiloc_map::MapFile;
use veiloc_mapping::{Input, build};
use veiloc_obfuscation::audit::options_for;
use veiloc_obfuscation::extract;
use veiloc_query::{Scheme, SealedQuery};
use veiloc_robust::ScoreKind;

pub use options::{Negatives, SceneEvaluation};
pub(crate) use queries::{PosedQuery, posed_queries};

use crate::error::EvalError;
use crate::results::{Evaluation, MapSummary, NegativeSummary, QueryResult, Variant, summarize};
use crate::scores::scores_or_default;
use negatives::localize_negatives;
use queries::send;

/// Builds the map and localizes every query under every scheme and score.
///
/// # Errors
/// [`EvalError`] when data is missing or the map cannot be built. A query that is not localized is a result.
pub fn evaluate_scene(
    evaluation: &SceneEvaluation,
    progress: &dyn Progress,
) -> Result<Evaluation, EvalError> {
    let mut queries = posed_queries(&evaluation.posed, &evaluation.images, &evaluation.query_list)?;
    for query in &mut queries {
        query.camera = evaluation.query_cameras.get(&query.name).copied().unwrap_or(query.camera);
    }
    if let Some(name) = evaluation.query_list.iter().find(|q| evaluation.map_list.contains(q)) {
        return Err(EvalError::DataSet(format!(
            "{name} is in the map list and in the query list; a query that is in the map proves nothing; take it from one of the lists"
        )));
    }
    let strange_queries = match &evaluation.negatives {
        Some(negatives) => Some(negatives.queries(evaluation)?),
        None => None,
    };

    let started = Instant::now();
    let input = Input::new(&evaluation.posed, &evaluation.images).with_names(&evaluation.map_list);
    let (model, _) = build(&input, &evaluation.build, progress)?;
    let build_seconds = started.elapsed().as_secs_f64();
    let temporary =
        tempfile::tempdir().map_err(|source| EvalError::Io { path: std::env::temp_dir(), source })?;
    let path = evaluation.keep_map.clone().unwrap_or_else(|| temporary.path().join("scene.vmap"));
    veiloc_map::write(&model, &path)?;
    drop(model);
    let map = MapFile::open(&path)?;
    let bytes =
        std::fs::metadata(&path).map_err(|source| EvalError::Io { path: path.clone(), source })?.len();

    let (mut schemes, queries) = localize_all(&map, &queries, evaluation, progress)?;
    let mut negatives = Vec::new();
    if let Some(posed) = &strange_queries {
        let by_row = localize_negatives(&map, posed, evaluation, progress)?;
        for (summary, of_row) in schemes.iter_mut().zip(&by_row) {
            summary.negatives = Some(NegativeSummary::of(of_row));
        }
        negatives.extend(by_row.into_iter().flatten());
    }
    Ok(Evaluation {
        version: 1,
        command: "eval scene",
        data: vec![folder_name(&evaluation.images)],
        seed: evaluation.seed,
        prior: evaluation.localize.use_prior,
        fixed_hypotheses: evaluation.localize.pose.fixed_hypotheses,
        schemes,
        queries,
        negatives,
        map: Some(MapSummary { images: map.image_count(), points: map.point_count(), bytes, build_seconds }),
    })
}

/// The name of the place: of the folder, or of the one above when that is only called `images`.
fn folder_name(images: &Path) -> String {
    let name = |p: &Path| p.file_name().map(|n| n.to_string_lossy().into_owned());
    match name(images) {
        Some(own) if own != "images" => own,
        own => images.parent().and_then(name).or(own).unwrap_or_default(),
    }
}

type Results = (Vec<crate::results::SchemeSummary>, Vec<QueryResult>);

/// Seals each query once a scheme, and localizes it with every score.
fn localize_all(
    map: &MapFile,
    queries: &[PosedQuery],
    evaluation: &SceneEvaluation,
    progress: &dyn Progress,
) -> Result<Results, EvalError> {
    let profile = map.profile();
    let extraction = options_for(Scheme::default());
    let mut by_recipe: Vec<Vec<QueryResult>> = Vec::new();
    progress.start("Localizing queries", queries.len());
    for query in queries {
        let started = Instant::now();
        let (features, camera) = extract(&query.path, &query.camera, profile, &extraction)?;
        let extract_ms = started.elapsed().as_secs_f64() * 1e3;
        let mut recipe = 0;
        for scheme in &evaluation.schemes {
            let started = Instant::now();
            let sealed = send(&features, &camera, profile, *scheme, &query.name, evaluation.seed);
            let seal_ms = started.elapsed().as_secs_f64() * 1e3;
            for score in scores_or_default(&evaluation.scores) {
                let mut result = match &sealed {
                    Ok(bytes) => localize_one(map, bytes, query, *scheme, score, &evaluation.localize),
                    Err(error) => QueryResult::unsolved(&query.name, *scheme, score).because(error),
                };
                result.variant = Variant {
                    prior: evaluation.localize.use_prior,
                    fixed_hypotheses: evaluation.localize.pose.fixed_hypotheses,
                    ..Variant::default()
                };
                result.seed = evaluation.seed;
                result.ms.insert("extract".to_owned(), extract_ms);
                result.ms.insert("seal".to_owned(), seal_ms);
                result.sealed_bytes = Some(sealed.as_ref().map_or(0, Vec::len));
                if by_recipe.len() == recipe {
                    by_recipe.push(Vec::new());
                }
                by_recipe[recipe].push(result);
                recipe += 1;
            }
        }
        progress.advance(1);
    }
    progress.finish();
    let summaries = by_recipe
        .iter()
        .map(|results| summarize(&results.iter().collect::<Vec<_>>(), &evaluation.thresholds))
        .collect();
    Ok((summaries, by_recipe.into_iter().flatten().collect()))
}

fn localize_one(
    map: &MapFile,
    bytes: &[u8],
    query: &PosedQuery,
    scheme: Scheme,
    score: ScoreKind,
    options: &LocalizeOptions,
) -> QueryResult {
    let started = Instant::now();
    let decoded = match SealedQuery::decode(bytes) {
        Ok(decoded) => decoded,
        Err(error) => return QueryResult::unsolved(&query.name, scheme, score).because(&error),
    };
    let decode_ms = started.elapsed().as_secs_f64() * 1e3;
    let mut options = options.clone();
    options.pose.score = Some(score);
    let mut result = QueryResult::unsolved(&query.name, scheme, score);
    result.ms.insert("decode".to_owned(), decode_ms);
    match localize(&decoded, map, &options) {
        Ok(found) => {
            result = result.found(&found.cam_from_world, &query.cam_from_world);
            result.inliers = found.inlier_pairs;
            result.correspondences = found.pairs;
            result.hypotheses = found.hypotheses;
            result.trusted = Some(found.confidence.is_trusted());
            result.ms.insert("retrieve".to_owned(), found.times.retrieve_ms);
            result.ms.insert("match".to_owned(), found.times.match_ms);
            result.ms.insert("pose".to_owned(), found.times.pose_ms);
        }
        Err(error) => result = result.because(&error),
    }
    result
}
