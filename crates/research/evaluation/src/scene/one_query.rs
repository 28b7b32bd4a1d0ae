//! One query of a scene: sealed once per scheme, and again with gravity if requested; localized by every estimator.

use std::time::Instant;

use crate::results::{EstimatorVariant, LossStage, QueryResult};
use veiloc_obfuscation::audit::options_for;
use veiloc_pose::State;
use veiloc_protocol::Scheme;

use super::options::SceneEvaluation;
use crate::error::EvalError;
use crate::pipeline::{
    EvaluatedQuery, ServedMap, SimulatedGravity, extract_features, localize_sent, seal_query, with_extractors,
};

/// Whether a pose is within no threshold, or is missing.
fn is_lost(result: &QueryResult, evaluation: &SceneEvaluation) -> bool {
    let error = result.pose_error();
    !evaluation.thresholds.is_empty()
        && !evaluation.thresholds.iter().any(|threshold| error.within(threshold))
}

/// The results of a query, in the order of the table's rows.
pub(super) fn localize_query(
    served: &ServedMap<'_>,
    query: &EvaluatedQuery,
    gravity_source: Option<&SimulatedGravity>,
    evaluation: &SceneEvaluation,
) -> Result<Vec<QueryResult>, EvalError> {
    let profile = served.whole().profile();
    let seal_options = |scheme| {
        with_extractors(options_for(scheme), &evaluation.build.extractors, evaluation.build.global.as_ref())
    };
    let extraction = seal_options(Scheme::default());
    let started = Instant::now();
    let mask = evaluation.mask_of(&query.name);
    let (features, camera) =
        extract_features(&query.path, mask.as_deref(), &query.camera, profile, &extraction)?;
    let extract_ms = started.elapsed().as_secs_f64() * 1e3;
    let variants: Vec<_> =
        SimulatedGravity::variants(gravity_source, &query.name, query.truth.as_ref(), evaluation.seed)
            .collect();
    let mut results = Vec::new();
    for (scheme, gravity) in evaluation.schemes.iter().flat_map(|s| variants.iter().map(move |g| (s, *g))) {
        let started = Instant::now();
        let options = seal_options(*scheme).with_gravity(gravity);
        let sealed = seal_query(&features, &camera, profile, &options, &query.name, evaluation.seed);
        let seal_ms = started.elapsed().as_secs_f64() * 1e3;
        for estimator in &evaluation.estimators {
            let mut result = match &sealed {
                Ok(sent) => {
                    let mut result = localize_sent(
                        served,
                        &sent.bytes,
                        query,
                        *scheme,
                        evaluation.transmission,
                        &estimator.localize,
                    );
                    if let Some(truth) = query.truth.as_ref().filter(|_| is_lost(&result, evaluation)) {
                        result.lost_in = LossStage::of(
                            sent,
                            truth,
                            served.whole(),
                            &estimator.localize,
                            &evaluation.thresholds,
                        );
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
            result.variant = EstimatorVariant {
                gravity: gravity_source.map(|gravity_source| match gravity {
                    None => "none".to_owned(),
                    Some(_) => gravity_source.noise().to_string(),
                }),
                ..estimator.variant()
            };
            result.seed = evaluation.seed;
            result.ms.insert("extract".to_owned(), extract_ms);
            result.ms.insert("seal".to_owned(), seal_ms);
            result.sealed_bytes = Some(sealed.as_ref().map_or(0, |sent| sent.bytes.len()));
            results.push(result);
        }
    }
    Ok(results)
}
