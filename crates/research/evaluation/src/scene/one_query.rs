//! One query of a scene: sealed once per scheme, and again with gravity if requested; localized with every score.

use std::time::Instant;

use crate::results::{QueryResult, Variant};
use veiloc_obfuscation::audit::options_for;
use veiloc_pose::State;
use veiloc_protocol::Scheme;

use super::options::SceneEvaluation;
use crate::error::EvalError;
use crate::pose::scores_or_default;
use crate::road::{AskedQuery, Served, Upright, equipped, extracted, localize_sent, send};

/// The results of a query, in the order of the table's rows.
pub(super) fn localize_query(
    served: &Served<'_>,
    query: &AskedQuery,
    upright: Option<&Upright>,
    evaluation: &SceneEvaluation,
) -> Result<Vec<QueryResult>, EvalError> {
    let profile = served.whole().profile();
    let equipped = |scheme| {
        equipped(options_for(scheme), &evaluation.build.extractors, evaluation.build.global.as_ref())
    };
    let extraction = equipped(Scheme::default());
    let started = Instant::now();
    let mask = evaluation.mask_of(&query.name);
    let (features, camera) = extracted(&query.path, mask.as_deref(), &query.camera, profile, &extraction)?;
    let extract_ms = started.elapsed().as_secs_f64() * 1e3;
    let told: Vec<_> =
        Upright::in_turn(upright, &query.name, query.truth.as_ref(), evaluation.seed).collect();
    let mut results = Vec::new();
    for (scheme, gravity) in evaluation.schemes.iter().flat_map(|s| told.iter().map(move |g| (s, *g))) {
        let started = Instant::now();
        let options = equipped(*scheme).with_gravity(gravity);
        let sealed = send(&features, &camera, profile, &options, &query.name, evaluation.seed);
        let seal_ms = started.elapsed().as_secs_f64() * 1e3;
        for score in scores_or_default(&evaluation.scores) {
            let mut result = match &sealed {
                Ok(sent) => {
                    let mut localize = evaluation.localize.clone();
                    localize.pose.score = Some(score);
                    localize_sent(served, &sent.bytes, query, *scheme, evaluation.sending, &localize)
                }
                Err(error) => {
                    let mut unsealed = QueryResult::unsolved(&query.name, *scheme, score).because(error);
                    unsealed.is_judged = query.truth.is_some();
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
            results.push(result);
        }
    }
    Ok(results)
}
