//! `veiloc eval scene`: the whole pipeline on a scene with known poses.
//!
//! The map is built, written and opened again as on a server; every query is sealed, encoded and decoded as if it had
//! crossed a network. No stage is skipped because the truth is known. Queries are localized under any number of
//! [`Condition`]s; random choices depend on the seed, the query and the condition only, so equal seeds give equal
//! results for any number of threads.

mod camera_error;
mod case;
mod condition;
mod degrade;
mod drawing;
mod frames;
mod from_truth;
mod loss;
mod one_query;
mod options;
mod retrieved;
mod sequence;
mod sparse;
mod work;

use std::path::Path;

use rayon::prelude::*;
use veiloc_features::Progress;
use veiloc_map::GravityDirection;
use veiloc_mapping::build_cache::FolderCache;

pub use camera_error::CameraError;
pub use condition::{Condition, ConditionError};
pub use degrade::Degradation;
pub use drawing::{DrawnQuery, DrawnScheme, drawn_queries};
pub use from_truth::FROM_TRUTH;
pub use options::{NegativeImage, Odometry, SceneEvaluation};
pub use retrieved::RetrievedImages;
pub use sequence::sequence_of;

use crate::error::EvalError;
use crate::pipeline::{EvaluatedQuery, SceneMap, ServedMap};
use crate::pose::common_hypotheses;
use crate::results::{EvaluationDocument, MapSummary, QueryResult, SchemeSummary, SparseMap, summarize};
use case::{Case, Maps};
use frames::Sequences;
use one_query::localize_query;
use work::Work;

/// Builds the map and localizes every query under every condition and scheme, by every estimator.
///
/// # Errors
/// [`EvalError`] when data is missing, the options exclude each other, or the map cannot be built. A query that is not
/// localized is a result.
pub fn evaluate_scene(
    evaluation: &SceneEvaluation,
    progress: &dyn Progress,
) -> Result<EvaluationDocument, EvalError> {
    evaluation.check()?;
    let of = |condition: &Condition| Case::of(*condition, evaluation);
    let cases: Vec<Case> = evaluation.conditions.iter().map(of).collect::<Result<_, _>>()?;
    let queries = evaluation.all_queries()?;
    let negatives = evaluation.negatives.iter().map(|image| image.query()).collect::<Result<Vec<_>, _>>()?;
    if let Some(retrieved) = &evaluation.retrieved {
        retrieved.check(queries.iter().map(|query| query.name.as_str()), &evaluation.map_list)?;
    }
    let sequences = Sequences::of(evaluation)?;
    for (query, case) in queries.iter().flat_map(|query| cases.iter().map(move |case| (query, case))) {
        case.assumed_camera(&query.camera, &query.name, evaluation.seed)?;
    }

    let down = cases.iter().find_map(|case| case.sensors().map(|sensors| sensors.down()));
    let work = evaluation.work.as_deref().map(Work::in_folder).transpose()?;
    let built = |names: &[String], keep| scene_map(evaluation, names, keep, down, work.as_ref(), progress);
    // First, because a small scene may have too few images for it.
    let sparse = evaluation.conditions.iter().any(|condition| condition.sparse_map).then(|| {
        built(&sparse::subsampled(&evaluation.map_list), None)
            .map_err(|error| EvalError::DataSet(format!("sparse-map: {error}; leave out this condition")))
    });
    let sparse = sparse.transpose()?;
    let whole = match &evaluation.map {
        Some(path) => given_map(path, evaluation)?,
        None => built(&evaluation.map_list, evaluation.keep_map.as_deref())?,
    };
    let regions = evaluation.regions.as_ref();
    let sparse_served = sparse.as_ref().map(|map| ServedMap::new(&map.file, regions, progress));
    let maps =
        Maps { whole: ServedMap::new(&whole.file, regions, progress)?, sparse: sparse_served.transpose()? };

    let results =
        localize_all(&maps, &cases, (&queries, &negatives), &sequences, evaluation, work.as_ref(), progress)?;
    let schemes =
        results.iter().map(|row| summarize(&row.iter().collect::<Vec<_>>(), &evaluation.thresholds));
    let wrong = |mut row: SchemeSummary| {
        let condition = cases.iter().find(|case| case.condition.name() == row.condition);
        if condition.is_some_and(|case| case.condition.negatives) {
            row.trusted_wrong = row.trusted;
        }
        row
    };
    let stride = sparse::step_for(evaluation.map_list.len());
    Ok(EvaluationDocument {
        version: 1,
        command: "eval scene",
        data: vec![match &evaluation.map {
            Some(path) => path.display().to_string(),
            None => folder_name(&evaluation.images),
        }],
        seed: evaluation.seed,
        prior: evaluation.estimators.iter().any(|estimator| estimator.localize.use_prior),
        fixed_hypotheses: common_hypotheses(&evaluation.estimators),
        schemes: schemes.map(wrong).collect(),
        queries: results.into_iter().flatten().collect(),
        sparse_map: sparse.as_ref().map(|sparse| SparseMap { stride, map: sparse.summary.clone() }),
        map: Some(MapSummary { regions: maps.whole.summary(), ..whole.summary.clone() }),
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

/// A map that was built before, for out-of-map images.
fn given_map(path: &Path, evaluation: &SceneEvaluation) -> Result<SceneMap, EvalError> {
    let map = SceneMap::given(path, 0.0)?;
    if map.file.image_count() == 0 || map.file.point_count() == 0 {
        return Err(EvalError::DataSet(
            "the map is empty, so no query can be localized; add posed images with `veiloc map add`"
                .to_owned(),
        ));
    }
    if evaluation.conditions.iter().any(|condition| condition.gravity.is_some()) && map.file.down().is_none()
    {
        return Err(EvalError::Options(
            "the map has no direction of gravity, so that of queries would not be used; build it with --down"
                .to_owned(),
        ));
    }
    Ok(map)
}

/// The map of these images: from the work folder if it has one for the same inputs, otherwise built; compressed if
/// requested.
fn scene_map(
    evaluation: &SceneEvaluation,
    names: &[String],
    keep: Option<&Path>,
    down: Option<GravityDirection>,
    work: Option<&Work>,
    progress: &dyn Progress,
) -> Result<SceneMap, EvalError> {
    if let Some(times) = evaluation.compress {
        let whole = SceneEvaluation { compress: None, ..evaluation.clone() };
        return scene_map(&whole, names, None, down, work, progress)?.compressed(times, keep, progress);
    }
    let stored = work.map(|work| work.map_of(evaluation, names, down)).transpose()?;
    if let Some(there) = stored.as_ref().and_then(|stored| stored.open()) {
        return there?.copied_to(keep);
    }
    let mut input = evaluation.map_input(names);
    let cache = work.map(|work| work.cache(&evaluation.build)).transpose()?;
    if let Some(cache) = &cache {
        input = input.with_cache(cache);
    }
    let path = stored.as_ref().map(|stored| stored.path()).or(keep);
    let map = SceneMap::build(&input, &evaluation.build, true, path, down, progress)?;
    match &stored {
        Some(stored) => {
            cache.as_ref().map_or(Ok(()), FolderCache::finish)?;
            stored.store(&map.summary)?;
            map.copied_to(keep)
        }
        None => Ok(map),
    }
}

/// Localizes every query under every case, and returns the rows of the table. Results in the work folder are reused.
fn localize_all(
    maps: &Maps<'_>,
    cases: &[Case],
    (queries, negatives): (&[EvaluatedQuery], &[EvaluatedQuery]),
    sequences: &Sequences,
    evaluation: &SceneEvaluation,
    work: Option<&Work>,
    progress: &dyn Progress,
) -> Result<Vec<Vec<QueryResult>>, EvalError> {
    let finished = work.map(|work| work.finished(maps, evaluation)).transpose()?;
    let mut by_case: Vec<Vec<Vec<QueryResult>>> = vec![Vec::new(); cases.len()];
    for (stage, queries, negatives) in
        [("Localizing queries", queries, false), ("Localizing negatives", negatives, true)]
    {
        let own =
            |query| (0..cases.len()).filter(|at| cases[*at].is_for(query, negatives)).collect::<Vec<_>>();
        let tasks = queries.iter().map(|query| (query, own(query))).filter(|(_, own)| !own.is_empty());
        let tasks: Vec<_> = tasks.collect();
        if tasks.is_empty() {
            continue;
        }
        progress.start(stage, tasks.len());
        let results = each(evaluation.jobs, &tasks, |(query, own)| {
            let own: Vec<&Case> = own.iter().map(|at| &cases[*at]).collect();
            let compute = |own: &[&Case]| localize_query(maps, query, own, evaluation);
            let rows = match &finished {
                Some(finished) => finished.get_or(query, &own, evaluation, compute)?,
                None => compute(&own)?,
            };
            progress.advance(1);
            Ok(rows)
        })?;
        progress.finish();
        for ((_, own), rows) in tasks.iter().zip(results) {
            own.iter().zip(rows).for_each(|(at, rows)| by_case[*at].push(rows));
        }
    }
    let base = |case: &Case| Condition { frames: None, ..case.condition };
    let mut together: Vec<usize> =
        (0..cases.len()).filter(|at| cases[*at].condition.frames.is_some()).collect();
    while let Some(first) = together.first() {
        let first = base(&cases[*first]);
        let (own, others) = together.into_iter().partition::<Vec<_>, _>(|at| base(&cases[*at]) == first);
        let own_cases: Vec<&Case> = own.iter().map(|at| &cases[*at]).collect();
        for rows in sequences.localize(maps, &own_cases, evaluation, progress)? {
            own.iter().zip(rows).for_each(|(at, rows)| by_case[*at].push(rows));
        }
        together = others;
    }
    Ok(by_case.into_iter().flat_map(transposed).collect())
}

/// From `[queries][rows]` to `[rows][queries]`.
fn transposed(by_query: Vec<Vec<QueryResult>>) -> Vec<Vec<QueryResult>> {
    let mut rows = vec![Vec::new(); by_query.iter().map(Vec::len).max().unwrap_or(0)];
    for of_query in by_query {
        rows.iter_mut().zip(of_query).for_each(|(row, result)| row.push(result));
    }
    rows
}

/// The results of all items in their order, `jobs` of them in parallel.
fn each<T: Sync, R: Send>(
    jobs: usize,
    items: &[T],
    one: impl Fn(&T) -> Result<R, EvalError> + Send + Sync,
) -> Result<Vec<R>, EvalError> {
    // With one job, the stages of a query use all threads.
    if jobs == 1 {
        return items.iter().map(one).collect();
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(jobs).build();
    let pool = pool.map_err(|e| EvalError::Options(format!("{jobs} jobs: {e}")))?;
    pool.install(|| items.par_iter().map(one).collect())
}
