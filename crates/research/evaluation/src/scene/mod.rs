//! `veiloc eval scene`: the whole pipeline on a scene with known poses.
//!
//! The map is built, written and opened again as on a server; every query is sealed, encoded and decoded as if it had
//! crossed a network. No stage is skipped because the truth is known.

mod drawing;
mod loss;
mod negatives;
mod one_query;
mod options;
mod work;

use std::path::Path;

use rayon::prelude::*;
use veiloc_features::Progress;
use veiloc_mapping::build_cache::FolderCache;

pub use drawing::{DrawnQuery, DrawnScheme, drawn_queries};
pub use options::{NegativeQueryImages, SceneEvaluation};

use crate::error::EvalError;
use crate::pipeline::{EvaluatedQuery, SceneMap, ServedMap, SimulatedGravity};
use crate::pose::common_hypotheses;
use crate::results::{EvaluationDocument, MapSummary, NegativeSummary, QueryResult, summarize};
use negatives::localize_negatives;
use one_query::localize_query;
use work::Work;

/// Builds the map and localizes every query under every scheme, by every estimator.
///
/// # Errors
/// [`EvalError`] when data is missing or the map cannot be built. A query that is not localized is a result.
pub fn evaluate_scene(
    evaluation: &SceneEvaluation,
    progress: &dyn Progress,
) -> Result<EvaluationDocument, EvalError> {
    let queries = evaluation.queries()?;
    let strange_queries = match &evaluation.negatives {
        Some(negatives) => Some(negatives.queries(evaluation)?),
        None => None,
    };

    let queries: Vec<EvaluatedQuery> =
        queries.into_iter().map(EvaluatedQuery::from).chain(evaluation.unposed()).collect();
    let gravity_source = evaluation.gravity;
    let gravity_source = gravity_source
        .map(|noise| SimulatedGravity::of(&evaluation.posed, &evaluation.map_list, noise))
        .transpose()?;
    let work = evaluation.work.as_deref().map(Work::in_folder).transpose()?;
    let keep = evaluation.keep_map.as_deref();
    let SceneMap { file: whole, summary, .. } = &match evaluation.compress {
        None => scene_map(evaluation, keep, gravity_source.as_ref(), work.as_ref(), progress)?,
        Some(times) => scene_map(evaluation, None, gravity_source.as_ref(), work.as_ref(), progress)?
            .compressed(times, keep, progress)?,
    };
    let served = &ServedMap::new(whole, evaluation.regions.as_ref(), progress)?;
    let (mut schemes, queries) =
        localize_all(served, &queries, gravity_source.as_ref(), evaluation, work.as_ref(), progress)?;
    let mut negatives = Vec::new();
    if let Some(posed) = &strange_queries {
        let by_row = localize_negatives(served, posed, evaluation, progress)?;
        for (summary, of_row) in schemes.iter_mut().zip(&by_row) {
            summary.negatives = Some(NegativeSummary::of(of_row));
        }
        negatives.extend(by_row.into_iter().flatten());
    }
    Ok(EvaluationDocument {
        version: 1,
        command: "eval scene",
        data: vec![folder_name(&evaluation.images)],
        seed: evaluation.seed,
        prior: evaluation.estimators.iter().any(|estimator| estimator.localize.use_prior),
        fixed_hypotheses: common_hypotheses(&evaluation.estimators),
        schemes,
        queries,
        negatives,
        map: Some(MapSummary { regions: served.summary(), ..summary.clone() }),
    })
}

/// The name of the scene: that of the folder, or of its parent if the folder is called `images`.
pub fn folder_name(images: &Path) -> String {
    let name = |p: &Path| p.file_name().map(|n| n.to_string_lossy().into_owned());
    match name(images) {
        Some(own) if own != "images" => own,
        own => images.parent().and_then(name).or(own).unwrap_or_default(),
    }
}

/// The map of the scene: from the work folder if it has one for the same inputs, otherwise built.
fn scene_map(
    evaluation: &SceneEvaluation,
    keep: Option<&Path>,
    gravity_source: Option<&SimulatedGravity>,
    work: Option<&Work>,
    progress: &dyn Progress,
) -> Result<SceneMap, EvalError> {
    let stored = work.map(|work| work.map_of(evaluation, gravity_source)).transpose()?;
    if let Some(there) = stored.as_ref().and_then(|stored| stored.open()) {
        return there?.copied_to(keep);
    }
    let mut input = evaluation.map_input(&evaluation.map_list);
    let cache = work.map(|work| work.cache(&evaluation.build)).transpose()?;
    if let Some(cache) = &cache {
        input = input.with_cache(cache);
    }
    let path = stored.as_ref().map(|stored| stored.path()).or(keep);
    let map = SceneMap::build(
        &input,
        &evaluation.build,
        true,
        path,
        gravity_source.map(|gravity_source| gravity_source.down()),
        progress,
    )?;
    match &stored {
        Some(stored) => {
            cache.as_ref().map_or(Ok(()), FolderCache::finish)?;
            stored.store(&map.summary)?;
            map.copied_to(keep)
        }
        None => Ok(map),
    }
}

type Results = (Vec<crate::results::SchemeSummary>, Vec<QueryResult>);

/// Localizes every query under every configuration, `jobs` queries in parallel. Results in the work folder are
/// reused.
fn localize_all(
    served: &ServedMap<'_>,
    queries: &[EvaluatedQuery],
    gravity_source: Option<&SimulatedGravity>,
    evaluation: &SceneEvaluation,
    work: Option<&Work>,
    progress: &dyn Progress,
) -> Result<Results, EvalError> {
    let finished = work.map(|work| work.finished(served.whole(), evaluation)).transpose()?;
    progress.start("Localizing queries", queries.len());
    let one = |query: &EvaluatedQuery| -> Result<Vec<QueryResult>, EvalError> {
        let compute = || localize_query(served, query, gravity_source, evaluation);
        let rows = match &finished {
            Some(finished) => finished.get_or(query, evaluation, compute)?,
            None => compute()?,
        };
        progress.advance(1);
        Ok(rows)
    };
    let rows: Vec<Vec<QueryResult>> = if evaluation.jobs == 1 {
        queries.iter().map(one).collect::<Result<_, _>>()?
    } else {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(evaluation.jobs).build();
        let pool = pool.map_err(|e| EvalError::Options(format!("{} jobs: {e}", evaluation.jobs)))?;
        pool.install(|| queries.par_iter().map(one).collect::<Result<_, _>>())?
    };
    progress.finish();
    // Transposes rows by query to queries by row.
    let count = rows.first().map_or(0, Vec::len);
    let mut by_recipe: Vec<Vec<QueryResult>> = vec![Vec::with_capacity(queries.len()); count];
    for of_query in rows {
        by_recipe.iter_mut().zip(of_query).for_each(|(recipe, result)| recipe.push(result));
    }
    let summaries = by_recipe
        .iter()
        .map(|results| summarize(&results.iter().collect::<Vec<_>>(), &evaluation.thresholds))
        .collect();
    Ok((summaries, by_recipe.into_iter().flatten().collect()))
}
