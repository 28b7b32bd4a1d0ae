//! One query of a scene under every condition of single images: sealed once per condition and scheme, localized by
//! every estimator.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::Path;
use std::time::Instant;

use veiloc_features::{Features, Image, load_gray, load_mask};
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{Extracted, KnownCamera, SealError, Sealer};
use veiloc_pose::State;
use veiloc_protocol::{Profile, Scheme, SizeClass};

use super::case::{Case, Maps};
use super::degrade::Degradation;
use super::from_truth::from_truth;
use super::options::SceneEvaluation;
use crate::error::EvalError;
use crate::pipeline::{EvaluatedQuery, ServedMap, localize_sent, seal_query};
use crate::results::{LossStage, QueryResult};

/// Whether a pose is within no threshold, or is missing.
fn is_lost(result: &QueryResult, evaluation: &SceneEvaluation) -> bool {
    let error = result.pose_error();
    !evaluation.thresholds.is_empty()
        && !evaluation.thresholds.iter().any(|threshold| error.within(threshold))
}

/// What a device extracts from an image.
pub(super) struct ExtractedQuery {
    pub(super) features: Features,
    /// The camera of the image.
    pub(super) camera: Intrinsics,
    /// Milliseconds, without those of the degradation.
    ms: f64,
}

/// Extracts the features of a query.
pub(super) fn extracted(
    query: &EvaluatedQuery,
    degradation: Option<Degradation>,
    mask: Option<&Path>,
    profile: &Profile,
    evaluation: &SceneEvaluation,
) -> Result<ExtractedQuery, EvalError> {
    let started = Instant::now();
    let gray = load_gray(&query.path)?;
    let loading = started.elapsed();
    let gray = match degradation {
        Some(degradation) => degradation.applied(&gray, &query.name, evaluation.seed),
        None => gray,
    };
    let started = Instant::now();
    let image = match mask {
        Some(mask) => Image::from(gray).without(&load_mask(mask)?)?,
        None => Image::from(gray),
    };
    let sealer = evaluation.sealer(profile, Scheme::default())?;
    let extracted = sealer.extract(image.named(&query.path), query.camera)?;
    let (features, camera) = (extracted.features().clone(), extracted.camera().intrinsics);
    Ok(ExtractedQuery { features, camera, ms: (loading + started.elapsed()).as_secs_f64() * 1e3 })
}

/// The device's sealer under a condition.
pub(super) fn sealer_of(
    served: &ServedMap<'_>,
    case: &Case,
    scheme: Scheme,
    evaluation: &SceneEvaluation,
) -> Result<Sealer, SealError> {
    let options = evaluation.seal_options(scheme);
    let few = case.condition.few_keypoints;
    let options = if few { options.with_max_keypoints(SizeClass::SMALLEST.rows()) } else { options };
    let options = match case.condition.pack {
        Some(usage) => options.with_place(served.place()?, usage),
        None => options,
    };
    Sealer::new(served.whole().profile(), options)
}

/// The results of a query, in the order of the table's rows of each condition.
pub(super) fn localize_query(
    maps: &Maps<'_>,
    query: &EvaluatedQuery,
    cases: &[&Case],
    evaluation: &SceneEvaluation,
) -> Result<Vec<Vec<QueryResult>>, EvalError> {
    // Conditions that do not change the image share its features: all maps have the same profile.
    let mut known: BTreeMap<Option<Degradation>, ExtractedQuery> = BTreeMap::new();
    let mut results = Vec::new();
    for case in cases {
        let mask = evaluation.mask_of(&query.name).filter(|_| !case.condition.negatives);
        let degradation = case.condition.image;
        let extracted = match known.entry(degradation) {
            Entry::Occupied(there) => there.into_mut(),
            Entry::Vacant(free) => {
                let profile = maps.whole.whole().profile();
                free.insert(extracted(query, degradation, mask.as_deref(), profile, evaluation)?)
            }
        };
        results.push(localize_under(maps, query, case, extracted, evaluation)?);
    }
    Ok(results)
}

fn localize_under(
    maps: &Maps<'_>,
    query: &EvaluatedQuery,
    case: &Case,
    extracted: &ExtractedQuery,
    evaluation: &SceneEvaluation,
) -> Result<Vec<QueryResult>, EvalError> {
    let served = maps.under(&case.condition);
    let intrinsics = case.assumed_camera(&extracted.camera, &query.name, evaluation.seed)?;
    let camera = KnownCamera { intrinsics, focal: query.focal };
    let mut results = Vec::new();
    for scheme in &evaluation.schemes {
        let started = Instant::now();
        let features = Extracted::new(extracted.features.clone(), camera)
            .with_gravity(case.gravity_of(query, evaluation.seed));
        let sealed = sealer_of(served, case, *scheme, evaluation)
            .and_then(|sealer| seal_query(&sealer, features, &query.name, evaluation.seed));
        let seal_ms = started.elapsed().as_secs_f64() * 1e3;
        let mut of_scheme = Vec::new();
        for estimator in &evaluation.estimators {
            let localize = &*evaluation.with_retrieved(&estimator.localize, &query.name, served.whole());
            let mut result = match &sealed {
                Ok(sent) => {
                    let transmission = evaluation.transmission;
                    let (mut result, was_trusted) =
                        localize_sent(served, &sent.bytes, query, *scheme, transmission, localize);
                    // A trusted pose of any step is a false positive, whatever the last one is.
                    if case.condition.negatives && was_trusted {
                        result.state = Some(State::Trusted);
                    }
                    if let Some(truth) = query.truth.as_ref().filter(|_| is_lost(&result, evaluation)) {
                        result.lost_in =
                            LossStage::of(sent, truth, served.whole(), localize, &evaluation.thresholds);
                    }
                    result
                }
                Err(error) => {
                    let mut unsealed =
                        QueryResult::unsolved(&query.name, *scheme, estimator.score()).because(error);
                    unsealed.has_ground_truth = query.truth.is_some();
                    unsealed.state = Some(State::NotFound);
                    unsealed
                }
            };
            result.variant = estimator.variant();
            result.ms.insert("extract".to_owned(), extracted.ms);
            result.ms.insert("seal".to_owned(), seal_ms);
            result.sealed_bytes = Some(sealed.as_ref().map_or(0, |sent| sent.bytes.len()));
            of_scheme.push(result);
        }
        if let (Some(radius_px), Some(truth)) = (evaluation.from_truth, &query.truth) {
            let sealed = sealed.as_ref().map_err(|error| error as &dyn std::error::Error);
            let name = &query.name;
            of_scheme.extend(from_truth(sealed, name, truth, served.whole(), *scheme, evaluation, radius_px));
        }
        results.extend(of_scheme.into_iter().map(|result| QueryResult {
            condition: case.condition.name(),
            seed: evaluation.seed,
            focal: case.condition.negatives.then(|| query.focal.to_string()),
            ..result
        }));
    }
    Ok(results)
}
