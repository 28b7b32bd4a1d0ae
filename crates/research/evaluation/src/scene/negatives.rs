//! Queries of another scene: every pose they get is wrong, and a trusted pose is a false positive.

use veiloc_features::Progress;
use veiloc_obfuscation::audit::options_for;
use veiloc_obfuscation::extract;
use veiloc_protocol::Scheme;

use super::options::{NegativeQueryImages, SceneEvaluation};
use crate::error::EvalError;
use crate::pipeline::{PosedQuery, ServedMap, posed_queries, seal_query, send_and_localize, with_extractors};
use crate::results::NegativeResult;

impl NegativeQueryImages {
    /// The queries; refused when they belong to the evaluated scene.
    pub(crate) fn queries(&self, evaluation: &SceneEvaluation) -> Result<Vec<PosedQuery>, EvalError> {
        let same = match (self.images.canonicalize(), evaluation.images.canonicalize()) {
            (Ok(theirs), Ok(own)) => theirs == own,
            _ => self.images == evaluation.images,
        };
        if same {
            return Err(EvalError::DataSet(format!(
                "{}: the negatives' images belong to the evaluated scene; give images of another scene",
                self.images.display()
            )));
        }
        posed_queries(&self.posed, &self.images, &self.list)
    }
}

/// Seals and localizes every negative query; rows as in the table, `[rows][negatives]`.
pub(crate) fn localize_negatives(
    served: &ServedMap<'_>,
    negatives: &[PosedQuery],
    evaluation: &SceneEvaluation,
    progress: &dyn Progress,
) -> Result<Vec<Vec<NegativeResult>>, EvalError> {
    let profile = served.whole().profile();
    let extraction = with_extractors(
        options_for(Scheme::default()),
        &evaluation.build.extractors,
        evaluation.build.global.as_ref(),
    );
    let mut rows =
        vec![Vec::with_capacity(negatives.len()); evaluation.schemes.len() * evaluation.estimators.len()];
    progress.start("Localizing negatives", negatives.len());
    for negative in negatives {
        let (features, camera) = extract(&negative.path, &negative.camera, profile, &extraction)?;
        for (s, scheme) in evaluation.schemes.iter().enumerate() {
            let options = with_extractors(
                options_for(*scheme),
                &evaluation.build.extractors,
                evaluation.build.global.as_ref(),
            );
            let sent = seal_query(&features, &camera, profile, &options, &negative.name, evaluation.seed);
            for (k, estimator) in evaluation.estimators.iter().enumerate() {
                let mut result = NegativeResult {
                    name: negative.name.clone(),
                    scheme: scheme.to_string(),
                    score: estimator.score().to_string(),
                    localized: false,
                    trusted: false,
                    inliers: 0,
                    correspondences: 0,
                };
                let response = sent.as_ref().ok();
                let response = response.map(|sent| {
                    send_and_localize(
                        served,
                        &sent.bytes,
                        profile,
                        evaluation.transmission,
                        &estimator.localize,
                    )
                });
                // A trusted pose of any step is a false positive, whatever the last one is.
                result.trusted = response.as_ref().is_some_and(|response| response.was_trusted);
                if let Some(Ok(found)) = response.map(|response| response.answer.found) {
                    result.localized = true;
                    result.inliers = found.inlier_pairs;
                    result.correspondences = found.pairs;
                }
                rows[s * evaluation.estimators.len() + k].push(result);
            }
        }
        progress.advance(1);
    }
    progress.finish();
    Ok(rows)
}
