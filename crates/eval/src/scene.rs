//! `veiloc eval scene`: the whole road on a place with known poses.
//!
//! The map is built, written and opened again as a server would; every query is sealed, encoded and decoded as if it
//! had crossed a network. No stage is short-cut because truth is at hand.

use std::path::{Path, PathBuf};
use std::time::Instant;

use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use veiloc_features::Features;
use veiloc_features::Progress;
use veiloc_geometry::{CameraFromWorld, Intrinsics};
use veiloc_localize::{LocalizeOptions, localize};
use veiloc_map::MapFile;
use veiloc_map::colmap::{ColmapModel, read_model};
use veiloc_mapping::{BuildOptions, build};
use veiloc_obfuscation::{SealError, extract, seal};
use veiloc_query::{Profile, Scheme, SealedQuery};
use veiloc_robust::ScoreKind;

use crate::error::EvalError;
use crate::metrics::Threshold;
use crate::negatives::{Negatives, localize_negatives};
use crate::results::{Evaluation, MapSummary, NegativeSummary, QueryResult, Variant, summarize};
use veiloc_datasets::seed_for;

/// What to evaluate.
#[derive(Debug, Clone)]
pub struct SceneEvaluation {
    /// Folder of the COLMAP model with cameras and poses.
    pub posed: PathBuf,
    /// Folder of the images.
    pub images: PathBuf,
    /// Names of the images the map is built from.
    pub map_list: Vec<String>,
    /// Names of the images to localize.
    pub query_list: Vec<String>,
    /// Where to keep the map; a temporary file when none.
    pub keep_map: Option<PathBuf>,
    /// How the map is built.
    pub build: BuildOptions,
    /// Schemes, in the order of the table.
    pub schemes: Vec<Scheme>,
    /// Scores, in the order of the table; empty for the default.
    pub scores: Vec<ScoreKind>,
    /// Thresholds of the recall columns.
    pub thresholds: Vec<Threshold>,
    /// Localization; its score is replaced by each of [`Self::scores`].
    pub localize: LocalizeOptions,
    /// Queries of another place, none of which should be localized.
    pub negatives: Option<Negatives>,
    /// Seed of sealing and sampling.
    pub seed: u64,
}

/// An image whose pose is known.
#[derive(Debug, Clone)]
pub(crate) struct PosedQuery {
    /// Its name.
    pub(crate) name: String,
    /// Its file.
    pub(crate) path: PathBuf,
    /// Its camera.
    pub(crate) camera: Intrinsics,
    /// Where it truly was taken.
    pub(crate) cam_from_world: CameraFromWorld,
}

/// Builds the map and localizes every query under every scheme and score.
///
/// # Errors
/// [`EvalError`] when data is missing or the map cannot be built. A query that is not localized is a result.
pub fn evaluate_scene(
    evaluation: &SceneEvaluation,
    progress: &dyn Progress,
) -> Result<Evaluation, EvalError> {
    let posed = read_model(&evaluation.posed)?;
    let queries = posed_queries(&posed, &evaluation.images, &evaluation.query_list)?;
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
    let model = build(&posed, &evaluation.images, &evaluation.map_list, &evaluation.build, progress)?;
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

pub(crate) fn posed_queries(
    posed: &ColmapModel,
    images: &Path,
    names: &[String],
) -> Result<Vec<PosedQuery>, EvalError> {
    names
        .iter()
        .map(|name| {
            let image = posed.image_by_name(name).ok_or_else(|| {
                EvalError::DataSet(format!("{name}: in the query list, but the model has no pose for it; take it from the list or add its pose"))
            })?;
            let camera = posed.camera_of(image);
            Ok(PosedQuery {
                name: name.clone(),
                path: images.join(name),
                camera: *camera,
                cam_from_world: image.cam_from_world,
            })
        })
        .collect()
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
    let mut by_recipe: Vec<Vec<QueryResult>> = Vec::new();
    progress.start("Localizing queries", queries.len());
    for query in queries {
        let started = Instant::now();
        let (features, camera) = extract(&query.path, &query.camera, profile)?;
        let extract_ms = started.elapsed().as_secs_f64() * 1e3;
        let mut recipe = 0;
        for scheme in &evaluation.schemes {
            let started = Instant::now();
            let sealed =
                send(&features, &camera, &profile.with_scheme(*scheme), &query.name, evaluation.seed);
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

/// What crosses the network for a query.
///
/// A device draws from the operating system; here the draw must be repeatable.
pub(crate) fn send(
    features: &Features,
    camera: &Intrinsics,
    profile: &Profile,
    name: &str,
    seed: u64,
) -> Result<Vec<u8>, SealError> {
    let seed = seed_for(seed, &[name, &profile.scheme().to_string()]);
    let sealed = seal(features.clone(), camera, profile, &mut ChaCha20Rng::seed_from_u64(seed))?;
    Ok(sealed.encode())
}

/// The score an estimator compares by that is told none.
pub(crate) const DEFAULT_SCORE: ScoreKind = ScoreKind::Likelihood;

/// The scores a scheme is run with: those asked for, or the default.
pub(crate) fn scores_or_default(asked: &[ScoreKind]) -> Vec<ScoreKind> {
    if asked.is_empty() { vec![DEFAULT_SCORE] } else { asked.to_vec() }
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
            result.inliers = found.inliers;
            result.correspondences = found.matches;
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
