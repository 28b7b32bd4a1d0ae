//! Localization of one query and comparison with its true pose.

use crate::results::metrics::finite;
use crate::results::{QueryResult, QueryUncertainty, SentDocument};
use veiloc_geometry::CameraFromWorld;
use veiloc_localization::LocalizeOptions;
use veiloc_map::MapFile;
use veiloc_pose::ScoreKind;
use veiloc_protocol::Scheme;

use super::posed_query::{EvaluatedQuery, PosedQuery};
use super::progressive::{QueryTransmission, send_and_localize};
use super::served_map::ServedMap;
use super::server::{LocalizeResult, decode_and_localize};

/// Localizes the sent bytes and compares with the true pose; a missing pose is a result.
pub fn localize_one(
    map: &MapFile,
    bytes: &[u8],
    query: &PosedQuery,
    scheme: Scheme,
    score: ScoreKind,
    options: &LocalizeOptions,
) -> QueryResult {
    let mut options = options.clone();
    options.pose.score = Some(score);
    compare_with_truth(
        &decode_and_localize(map, bytes, &options),
        &query.name,
        Some(&query.cam_from_world),
        scheme,
        score,
    )
}

/// The same for a query that is sent whole or progressively, with the amount of sent data; for several messages, the
/// time of those before the last is a separate stage. Also returns whether the answer to any message was trusted.
pub(crate) fn localize_sent(
    served: &ServedMap<'_>,
    bytes: &[u8],
    query: &EvaluatedQuery,
    scheme: Scheme,
    transmission: QueryTransmission,
    options: &LocalizeOptions,
) -> (QueryResult, bool) {
    let score = options.pose.score.unwrap_or_default();
    let response = send_and_localize(served, bytes, served.whole().profile(), transmission, options);
    let mut result = compare_with_truth(&response.answer, &query.name, query.truth.as_ref(), scheme, score);
    let exposed = response.answer.found.as_ref().map_or(0, |found| found.inliers);
    result.sent = Some(SentDocument { sent_rows: response.rows, sent_bytes: response.bytes, exposed });
    if let QueryTransmission::Progressive(_) = transmission {
        result.ms.insert("steps".to_owned(), response.before_ms);
    }
    (result, response.was_trusted)
}

fn compare_with_truth(
    answer: &LocalizeResult,
    name: &str,
    truth: Option<&CameraFromWorld>,
    scheme: Scheme,
    score: ScoreKind,
) -> QueryResult {
    let mut result = QueryResult::unsolved(name, scheme, score);
    result.has_ground_truth = truth.is_some();
    result.state = Some(answer.state());
    result.ms.insert("decode".to_owned(), answer.decode_ms);
    match &answer.found {
        Ok(found) => {
            result = match truth {
                Some(truth) => result.found(&found.cam_from_world, truth),
                None => result.answered(&found.cam_from_world),
            };
            result.uncertainty =
                truth.map(|truth| QueryUncertainty::of(&found.cam_from_world, &found.covariance, truth));
            result.inliers = found.inlier_pairs;
            result.correspondences = found.pairs;
            result.hypotheses = found.hypotheses;
            result = result.judged(found.state, &found.confidence);
            result.ms.insert("retrieve".to_owned(), found.times.retrieve_ms);
            result.ms.insert("match".to_owned(), found.times.match_ms);
            result.ms.insert("pose".to_owned(), found.times.pose_ms);
        }
        Err(error) => result = result.because(error),
    }
    result.log_evidence = answer.log_evidence().and_then(finite);
    result
}
