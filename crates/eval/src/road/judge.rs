//! One query asked and judged: what an evaluation keeps of it.

use veiloc_localize::LocalizeOptions;
use veiloc_map::MapFile;
use veiloc_query::Scheme;
use veiloc_results::{QueryResult, QueryUncertainty};
use veiloc_robust::{ScoreKind, State};

use super::ask::ask;
use super::posed_query::PosedQuery;

/// Localizes what crossed the network, and compares with the truth; that there is no pose is a result.
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
    let answer = ask(map, bytes, &options);
    let mut result = QueryResult::unsolved(&query.name, scheme, score);
    result.state = Some(answer.state());
    result.ms.insert("decode".to_owned(), answer.decode_ms);
    match &answer.found {
        Ok(found) => {
            let truth = &query.cam_from_world;
            result = result.found(&found.cam_from_world, truth);
            result.uncertainty = Some(QueryUncertainty::of(&found.cam_from_world, &found.covariance, truth));
            result.inliers = found.inlier_pairs;
            result.correspondences = found.pairs;
            result.hypotheses = found.hypotheses;
            result.trusted = Some(found.state == State::Trusted);
            result.ms.insert("retrieve".to_owned(), found.times.retrieve_ms);
            result.ms.insert("match".to_owned(), found.times.match_ms);
            result.ms.insert("pose".to_owned(), found.times.pose_ms);
        }
        Err(error) => result = result.because(error),
    }
    result
}
