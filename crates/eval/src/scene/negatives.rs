//! Queries of another place: every pose they get is wrong, and one that is trusted is a false positive.

use veiloc_features::Progress;
use veiloc_localize::localize;
use veiloc_map::MapFile;
use veiloc_obfuscation::audit::options_for;
use veiloc_obfuscation::extract;
use veiloc_query::{Scheme, SealedQuery};

use super::options::{Negatives, SceneEvaluation};
use super::queries::{PosedQuery, posed_queries, send};
use crate::error::EvalError;
use crate::results::NegativeResult;
use crate::scores::scores_or_default;

impl Negatives {
    /// The queries; refused when they are of the very place that is evaluated.
    pub(crate) fn queries(&self, evaluation: &SceneEvaluation) -> Result<Vec<PosedQuery>, EvalError> {
        let same = match (self.images.canonicalize(), evaluation.images.canonicalize()) {
            (Ok(theirs), Ok(own)) => theirs == own,
            _ => self.images == evaluation.images,
        };
        if same {
            return Err(EvalError::DataSet(format!(
                "{}: the negatives' images are those of the place itself; give images of another place",
                self.images.display()
            )));
        }
        posed_queries(&self.posed, &self.images, &self.list)
    }
}

/// Seals every negative for this map and asks for its pose; rows as in the table, `[rows][negatives]`.
pub(crate) fn localize_negatives(
    map: &MapFile,
    negatives: &[PosedQuery],
    evaluation: &SceneEvaluation,
    progress: &dyn Progress,
) -> Result<Vec<Vec<NegativeResult>>, EvalError> {
    let profile = map.profile();
    let extraction = options_for(Scheme::default());
    let scores = scores_or_default(&evaluation.scores);
    let mut rows = vec![Vec::with_capacity(negatives.len()); evaluation.schemes.len() * scores.len()];
    progress.start("Localizing negatives", negatives.len());
    for negative in negatives {
        let (features, camera) = extract(&negative.path, &negative.camera, profile, &extraction)?;
        for (s, scheme) in evaluation.schemes.iter().enumerate() {
            let sent = send(&features, &camera, profile, *scheme, &negative.name, evaluation.seed);
            let received = sent.ok().and_then(|bytes| SealedQuery::decode(&bytes).ok());
            for (k, score) in scores.iter().enumerate() {
                let mut result = NegativeResult {
                    name: negative.name.clone(),
                    scheme: scheme.to_string(),
                    score: score.to_string(),
                    localized: false,
                    trusted: false,
                    inliers: 0,
                    correspondences: 0,
                };
                let mut options = evaluation.localize.clone();
                options.pose.score = Some(*score);
                if let Some(found) = received.as_ref().and_then(|query| localize(query, map, &options).ok()) {
                    result.localized = true;
                    result.trusted = found.confidence.is_trusted();
                    result.inliers = found.inlier_pairs;
                    result.correspondences = found.pairs;
                }
                rows[s * scores.len() + k].push(result);
            }
        }
        progress.advance(1);
    }
    progress.finish();
    Ok(rows)
}
