//! `veiloc eval stress`: one scene, with its queries under each [`StressCondition`].
//!
//! Degradation happens in memory with seeds of its own, so equal seeds give equal tables for any number of threads.
//! All conditions except `sparse-map` share one map.

mod condition;
mod degrade;
mod document;
mod from_truth;
mod options;
pub(crate) mod sparse;
mod table;

use rayon::prelude::*;
use veiloc_features::{Features, GrayImage, Image, Progress, load_gray};
use veiloc_geometry::Intrinsics;
use veiloc_map::MapFile;
use veiloc_mapping::BuildOptions;
use veiloc_obfuscation::audit::options_for;
use veiloc_obfuscation::{SealOptions, extract_loaded};
use veiloc_protocol::{Scheme, SizeClass};

use crate::error::EvalError;
use crate::pipeline::{
    PosedQuery, SceneMap, SimulatedGravity, decode_and_localize, seal_query, with_extractors,
};
use crate::scene::folder_name;
use degrade::{degraded, wrong_camera};

pub use condition::{StressCondition, StressError};
pub use document::{SparseMap, StressDocument, StressQuery, StressRow, TruthSummary};
pub use from_truth::{ErrorDocument, TruthStartErrors};
pub use options::StressEvaluation;
pub use table::table;

/// The maps of the scene: one or two.
struct Maps {
    all: SceneMap,
    sparse: Option<SceneMap>,
}

impl Maps {
    fn under(&self, stress: StressCondition) -> &MapFile {
        match (&self.sparse, stress) {
            (Some(sparse), StressCondition::SparseMap) => &sparse.file,
            _ => &self.all.file,
        }
    }
}

/// Builds the maps, and localizes every query under every stress and scheme.
///
/// # Errors
/// [`EvalError`] when data is missing, a map cannot be built, or the options select nothing. A query without a pose
/// is a result.
pub fn evaluate_stress(
    evaluation: &StressEvaluation,
    progress: &dyn Progress,
) -> Result<StressDocument, EvalError> {
    let scene = &evaluation.scene;
    if scene.schemes.is_empty() || scene.query_list.is_empty() {
        return Err(EvalError::Options("no scheme or query to evaluate".to_owned()));
    }
    let queries = scene.queries()?;
    let stresses = evaluation.ordered();
    let gravity_source =
        scene.gravity.map(|noise| SimulatedGravity::of(&scene.posed, &scene.map_list, noise)).transpose()?;
    let down = gravity_source.map(|gravity_source| gravity_source.down());
    let build =
        |names: &[String]| SceneMap::build(&scene.map_input(names), &scene.build, true, None, down, progress);
    let sparse_names =
        stresses.contains(&StressCondition::SparseMap).then(|| sparse::subsampled(&scene.map_list));
    // First, because a small place may have too few images for it.
    let sparse = sparse_names.map(|names| {
        let hint = |error| EvalError::DataSet(format!("sparse-map: {error}; leave it out with --stress"));
        build(&names).map_err(hint)
    });
    let maps = Maps { sparse: sparse.transpose()?, all: build(&scene.map_list)? };

    progress.start("Localizing queries", queries.len());
    let one = |query: &PosedQuery| {
        let results = under_each(&maps, query, &stresses, gravity_source.as_ref(), evaluation);
        progress.advance(1);
        results
    };
    let each: Result<Vec<Vec<StressQuery>>, EvalError> = queries.par_iter().map(one).collect();
    progress.finish();
    let each = each?;
    let mut document = StressDocument::new(evaluation, folder_name(&scene.images));
    document.map = maps.all.summary;
    document.sparse_map =
        maps.sparse.map(|map| SparseMap { stride: sparse::step_for(scene.map_list.len()), map: map.summary });
    let mut of_queries: Vec<_> = each.into_iter().map(Vec::into_iter).collect();
    let variants_per_query = if gravity_source.is_some() { 2 } else { 1 };
    for _ in 0..stresses.len() * scene.schemes.len() * variants_per_query {
        let of_row: Vec<StressQuery> = of_queries.iter_mut().filter_map(Iterator::next).collect();
        document.rows.extend(StressRow::of(&of_row, evaluation));
        document.queries.extend(of_row);
    }
    Ok(document)
}

/// One query under every stress and, within each, every scheme, without gravity and with it if requested.
fn under_each(
    maps: &Maps,
    query: &PosedQuery,
    stresses: &[StressCondition],
    gravity_source: Option<&SimulatedGravity>,
    evaluation: &StressEvaluation,
) -> Result<Vec<StressQuery>, EvalError> {
    let scene = &evaluation.scene;
    let image = load_gray(&query.path)?;
    // Conditions that do not change the image share its features: all maps have the same profile.
    let plain = extracted(&image, query, &maps.all.file, &scene.build)?;
    let variants: Vec<_> =
        SimulatedGravity::variants(gravity_source, &query.name, Some(&query.cam_from_world), scene.seed)
            .collect();
    let mut results = Vec::new();
    for stress in stresses {
        let worse = match degraded(&image, *stress, &query.name, scene.seed) {
            Some(worse) => Some(extracted(&worse, query, &maps.all.file, &scene.build)?),
            None => None,
        };
        let (features, camera) = worse.as_ref().unwrap_or(&plain);
        let camera = wrong_camera(camera, *stress, &query.name, scene.seed).unwrap_or(*camera);
        for (scheme, gravity) in scene.schemes.iter().flat_map(|s| variants.iter().map(move |g| (s, *g))) {
            let map = maps.under(*stress);
            let options = sealed_under(*stress, *scheme, &scene.build).with_gravity(gravity);
            let sent = seal_query(features, &camera, map.profile(), &options, &query.name, scene.seed);
            let from_truth = |sent| {
                let (truth, radius) = (&query.cam_from_world, evaluation.oracle_radius_px);
                evaluation
                    .from_truth
                    .then(|| TruthStartErrors::of(sent, truth, map, scene.localize(), radius))
            };
            let result = match &sent {
                Ok(sent) => {
                    let answer = decode_and_localize(map, &sent.bytes, scene.localize());
                    StressQuery::answered(query, *stress, *scheme, &answer, from_truth(sent))
                }
                Err(error) => StressQuery::unsealed(
                    query,
                    *stress,
                    *scheme,
                    error,
                    evaluation.from_truth.then_some(TruthStartErrors::UNSEALED),
                ),
            };
            let gravity_sd_deg =
                gravity_source.filter(|_| gravity.is_some()).map(|source| source.noise().sd_deg);
            results.push(StressQuery { gravity_sd_deg, ..result });
        }
    }
    Ok(results)
}

/// Features of a query of a sequence under a stress, and the camera that the device assumes: one device took all
/// images, so its error is the same for all.
pub(crate) fn shown_under(
    stress: StressCondition,
    query: &PosedQuery,
    map: &MapFile,
    build: &BuildOptions,
    seed: u64,
) -> Result<(Features, Intrinsics), EvalError> {
    let image = load_gray(&query.path)?;
    let worse = degraded(&image, stress, &query.name, seed);
    let (features, camera) = extracted(worse.as_ref().unwrap_or(&image), query, map, build)?;
    let camera = wrong_camera(&camera, stress, "the device", seed).unwrap_or(camera);
    Ok((features, camera))
}

fn extracted(
    image: &GrayImage,
    query: &PosedQuery,
    map: &MapFile,
    build: &BuildOptions,
) -> Result<(Features, Intrinsics), EvalError> {
    let image = Image::from(image.clone());
    let options = with_extractors(options_for(Scheme::default()), &build.extractors, build.global.as_ref());
    Ok(extract_loaded(image, &query.path, &query.camera, map.profile(), &options)?)
}

/// The device's sealing options under a stress.
pub(crate) fn sealed_under(stress: StressCondition, scheme: Scheme, build: &BuildOptions) -> SealOptions {
    let options = with_extractors(options_for(scheme), &build.extractors, build.global.as_ref());
    match stress {
        StressCondition::FewKeypoints => options.with_max_keypoints(SizeClass::SMALLEST.rows()),
        StressCondition::None
        | StressCondition::Dark
        | StressCondition::Motion
        | StressCondition::HalfHidden
        | StressCondition::SideHidden
        | StressCondition::LowResolution
        | StressCondition::SparseMap
        | StressCondition::Focal(_) => options,
    }
}
