//! `veiloc eval scene`: the whole road on a place with known poses.
//!
//! The map is built, written and opened again as a server would; every query is sealed, encoded and decoded as if it
//! had crossed a network. No stage is short-cut because truth is at hand.

mod negatives;
mod options;

use std::path::Path;
use std::time::Instant;

use veiloc_features::{Progress, load_mask, mask_in};
use veiloc_map::MapFile;
use veiloc_mapping::Input;
use veiloc_obfuscation::audit::options_for;
use veiloc_obfuscation::{ExtractError, extract, extract_masked};
use veiloc_query::Scheme;
use veiloc_robust::State;

pub use options::{Negatives, SceneEvaluation};

use crate::error::EvalError;
use crate::road::{PlaceMap, PosedQuery, Upright, equipped, localize_sent, queries_of_place, send};
use crate::scores::scores_or_default;
use negatives::localize_negatives;
use veiloc_results::{Evaluation, NegativeSummary, QueryResult, Variant, summarize};

/// Builds the map and localizes every query under every scheme and score.
///
/// # Errors
/// [`EvalError`] when data is missing or the map cannot be built. A query that is not localized is a result.
pub fn evaluate_scene(
    evaluation: &SceneEvaluation,
    progress: &dyn Progress,
) -> Result<Evaluation, EvalError> {
    let queries = queries_of_place(
        &evaluation.posed,
        &evaluation.images,
        &evaluation.map_list,
        &evaluation.query_list,
        &evaluation.query_cameras,
    )?;
    let strange_queries = match &evaluation.negatives {
        Some(negatives) => Some(negatives.queries(evaluation)?),
        None => None,
    };

    let upright = evaluation.gravity_sd_deg;
    let upright = upright.map(|sd| Upright::of(&evaluation.posed, &evaluation.map_list, sd)).transpose()?;
    let input = Input::new(&evaluation.posed, &evaluation.images).with_names(&evaluation.map_list);
    let PlaceMap { file: map, summary, .. } = &PlaceMap::build(
        &input,
        &evaluation.build,
        true,
        evaluation.keep_map.as_deref(),
        upright.map(|upright| upright.down()),
        progress,
    )?;
    let (mut schemes, queries) = localize_all(map, &queries, upright.as_ref(), evaluation, progress)?;
    let mut negatives = Vec::new();
    if let Some(posed) = &strange_queries {
        let by_row = localize_negatives(map, posed, evaluation, progress)?;
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
        map: Some(summary.clone()),
    })
}

/// The name of the place: of the folder, or of the one above when that is only called `images`.
pub fn folder_name(images: &Path) -> String {
    let name = |p: &Path| p.file_name().map(|n| n.to_string_lossy().into_owned());
    match name(images) {
        Some(own) if own != "images" => own,
        own => images.parent().and_then(name).or(own).unwrap_or_default(),
    }
}

type Results = (Vec<veiloc_results::SchemeSummary>, Vec<QueryResult>);

/// Seals each query once a scheme, and again with gravity where that is asked for; localizes it with every score.
fn localize_all(
    map: &MapFile,
    queries: &[PosedQuery],
    upright: Option<&Upright>,
    evaluation: &SceneEvaluation,
    progress: &dyn Progress,
) -> Result<Results, EvalError> {
    let profile = map.profile();
    let extraction = equipped(options_for(Scheme::default()), &evaluation.build);
    let mut by_recipe: Vec<Vec<QueryResult>> = Vec::new();
    progress.start("Localizing queries", queries.len());
    for query in queries {
        let started = Instant::now();
        let (features, camera) = match &evaluation.masks {
            Some(folder) => {
                let mask = load_mask(&mask_in(folder, Path::new(&query.name))).map_err(ExtractError::from)?;
                extract_masked(&query.path, &mask, &query.camera, profile, &extraction)?
            }
            None => extract(&query.path, &query.camera, profile, &extraction)?,
        };
        let extract_ms = started.elapsed().as_secs_f64() * 1e3;
        let mut recipe = 0;
        let told: Vec<_> = Upright::in_turn(upright, query, evaluation.seed).collect();
        for (scheme, gravity) in evaluation.schemes.iter().flat_map(|s| told.iter().map(move |g| (s, *g))) {
            let started = Instant::now();
            let options = equipped(options_for(*scheme), &evaluation.build).with_gravity(gravity);
            let sealed = send(&features, &camera, profile, &options, &query.name, evaluation.seed);
            let seal_ms = started.elapsed().as_secs_f64() * 1e3;
            for score in scores_or_default(&evaluation.scores) {
                let mut result = match &sealed {
                    Ok(sent) => {
                        let mut localize = evaluation.localize.clone();
                        localize.pose.score = Some(score);
                        localize_sent(map, &sent.bytes, query, *scheme, evaluation.sending, &localize)
                    }
                    Err(error) => {
                        let mut unsealed = QueryResult::unsolved(&query.name, *scheme, score).because(error);
                        unsealed.state = Some(State::NotFound);
                        unsealed
                    }
                };
                result.variant = Variant {
                    prior: evaluation.localize.use_prior,
                    fixed_hypotheses: evaluation.localize.pose.fixed_hypotheses,
                    gravity: upright.map(|upright| match gravity {
                        None => "none".to_owned(),
                        Some(_) => upright.sd_deg().to_string(),
                    }),
                    ..Variant::default()
                };
                result.seed = evaluation.seed;
                result.ms.insert("extract".to_owned(), extract_ms);
                result.ms.insert("seal".to_owned(), seal_ms);
                result.sealed_bytes = Some(sealed.as_ref().map_or(0, |sent| sent.bytes.len()));
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
