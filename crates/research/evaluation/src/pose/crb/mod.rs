//! `veiloc eval crb`: errors on random synthetic problems relative to the Cramér–Rao bound, and coverage of the
//! estimated covariance.
//!
//! The bound is the inverse Fisher information of the true correspondences at the true pose. Noise is Gaussian on the
//! keypoints, before obfuscation; obfuscation adds dither (uniform, variance 1/12 px² along any direction) and the
//! rounding of the sent values (see [`noise`]). The bound assumes Gaussian noise of the same total variance, which least
//! squares on the true correspondences would reach. Predicted medians are medians of errors sampled from the normal
//! distribution of the bound, over all problems of a cell.

mod bound;
mod noise;

mod scene;
mod table;
mod trial;

use std::collections::BTreeMap;

use crate::EvalError;
use crate::results::coverage::{NormalizedError, shares};
use crate::results::metrics::finite;
use crate::results::metrics::{PoseErrors, mean, median};
use rayon::prelude::*;
use serde::Serialize;
use trial::Trial;
use veiloc_features::Progress;
use veiloc_pose::PoseOptions;
use veiloc_protocol::{AngleBits, Scheme};

pub use scene::{SceneError, SyntheticScene};
pub use table::table;

/// Inputs and options: every scene with every noise, share of outliers and scheme.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct SyntheticEvaluation {
    /// Scenes.
    pub scenes: Vec<SyntheticScene>,
    /// Schemes.
    pub schemes: Vec<Scheme>,
    /// Standard deviations of a keypoint along each axis, pixels.
    pub noises_px: Vec<f64>,
    /// Shares of wrong matches, 0 to 1.
    pub outlier_shares: Vec<f64>,
    /// Random problems per cell. The median of 500 is accurate to about 4 %.
    pub problems: usize,
    /// Matches per problem.
    pub matches: usize,
    /// Robust estimation.
    pub pose: PoseOptions,
    /// Bits of a line's angle.
    pub angle_bits: AngleBits,
    /// Seed of every random choice.
    pub seed: u64,
}

impl Default for SyntheticEvaluation {
    fn default() -> Self {
        Self {
            scenes: SyntheticScene::ALL.to_vec(),
            schemes: vec![Scheme::Points, Scheme::RandomLines, Scheme::default()],
            noises_px: vec![0.5, 1.0, 2.0],
            outlier_shares: vec![0.3, 0.5, 0.8],
            problems: 500,
            matches: 400,
            pose: PoseOptions::default(),
            angle_bits: AngleBits::default(),
            seed: 0,
        }
    }
}

/// Properties that the problems of a cell share, independent of the scheme.
#[derive(Debug, Clone, Copy)]
struct Condition {
    scene: SyntheticScene,
    noise_px: f64,
    outlier_ratio: f64,
}

/// Errors on synthetic problems, beside those that the Cramér–Rao bound predicts.
///
/// Medians and ratios are over the problems that were *found*: at least half of the true correspondences agree with
/// the pose. Fields with `_all` are over all problems, and a problem without a pose has an infinite error. A ratio is
/// the median error divided by the median that the bound predicts for the same problems.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BoundEvaluation {
    /// Version of this document.
    pub version: u32,
    /// The command, `eval crb`.
    pub command: &'static str,
    /// Seed of every random choice.
    pub seed: u64,
    /// Random problems per cell.
    pub problems: usize,
    /// Matches per problem.
    pub matches: usize,
    /// One entry per scene, scheme, noise and share of outliers.
    pub cells: Vec<BoundCell>,
    /// One entry per scene, scheme and noise, over all shares of outliers.
    pub coverage: Vec<BoundCoverage>,
}

/// Problems of one scene, scheme, noise and share of outliers.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BoundCell {
    /// Synthetic scene.
    pub scene: String,
    /// Obfuscation scheme.
    pub scheme: String,
    /// Standard deviation of a keypoint along each axis, pixels.
    pub noise_px: f64,
    /// Share of wrong matches, 0 to 1.
    pub outlier_ratio: f64,
    /// Number of problems.
    pub problems: usize,
    /// Share of problems that got a pose, right or wrong.
    pub localized: f64,
    /// Share of problems that were found.
    pub found: f64,
    /// Mean share of the true correspondences that agree with the pose, over all problems.
    pub inlier_recall: f64,
    /// Median translation error, map units; null when no problem was found.
    pub median_translation: Option<f64>,
    /// Median that the bound predicts, map units; null likewise.
    pub bound_translation: Option<f64>,
    /// Ratio of the two; null likewise.
    pub translation_ratio: Option<f64>,
    /// Median rotation error, degrees; null when no problem was found.
    pub median_rotation_deg: Option<f64>,
    /// Median that the bound predicts, degrees; null likewise.
    pub bound_rotation_deg: Option<f64>,
    /// Ratio of the two; null likewise.
    pub rotation_ratio: Option<f64>,
    /// `translation_ratio` over all problems; null when more than half have no pose.
    pub translation_ratio_all: Option<f64>,
    /// `rotation_ratio` over all problems; null when more than half have no pose.
    pub rotation_ratio_all: Option<f64>,
}

/// Share of poses whose truth lies in the 50, 90 and 99 % regions of the estimated covariance, over the problems that
/// were found.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BoundCoverage {
    /// Scene; `all` for all scenes and noises of a scheme together.
    pub scene: String,
    /// Obfuscation scheme.
    pub scheme: String,
    /// Standard deviation of a keypoint along each axis, pixels; null for all.
    pub noise_px: Option<f64>,
    /// Number of poses.
    pub poses: usize,
    /// For the whole pose, six degrees of freedom: percentage of the confidence region to share of true poses in it, 0
    /// to 1.
    pub pose: BTreeMap<String, f64>,
    /// The same for the camera centre, three degrees of freedom.
    pub center: BTreeMap<String, f64>,
}

/// Runs every problem of every cell; results do not depend on the number of threads.
///
/// # Errors
/// [`EvalError::Options`] when the options are impossible or empty.
pub fn evaluate_bound(
    evaluation: &SyntheticEvaluation,
    progress: &dyn Progress,
) -> Result<BoundEvaluation, EvalError> {
    check(evaluation)?;
    let cells = evaluation.scenes.len()
        * evaluation.schemes.len()
        * evaluation.noises_px.len()
        * evaluation.outlier_shares.len();
    progress.start("Estimating poses", cells * evaluation.problems);
    let mut document = BoundEvaluation {
        version: 1,
        command: "eval crb",
        seed: evaluation.seed,
        problems: evaluation.problems,
        matches: evaluation.matches,
        cells: Vec::with_capacity(cells),
        coverage: Vec::new(),
    };
    let mut of_schemes: Vec<Vec<Trial>> = vec![Vec::new(); evaluation.schemes.len()];
    for &scene in &evaluation.scenes {
        for (&scheme, of_scheme) in evaluation.schemes.iter().zip(&mut of_schemes) {
            for &noise_px in &evaluation.noises_px {
                let mut of_noise = Vec::new();
                for &outlier_ratio in &evaluation.outlier_shares {
                    let condition = Condition { scene, noise_px, outlier_ratio };
                    let one = |index| {
                        let trial = trial::run(evaluation, &condition, scheme, index);
                        progress.advance(1);
                        trial
                    };
                    let trials: Vec<Trial> = (0..evaluation.problems).into_par_iter().map(one).collect();
                    document.cells.push(cell(&condition, scheme, &trials));
                    of_noise.extend(trials);
                }
                document.coverage.push(coverage(&scene.to_string(), scheme, Some(noise_px), &of_noise));
                of_scheme.extend(of_noise);
            }
        }
    }
    for (scheme, trials) in evaluation.schemes.iter().zip(&of_schemes) {
        document.coverage.push(coverage("all", *scheme, None, trials));
    }
    progress.finish();
    Ok(document)
}

fn check(evaluation: &SyntheticEvaluation) -> Result<(), EvalError> {
    let refuse = |reason: String| Err(EvalError::Options(reason));
    if evaluation.scenes.is_empty()
        || evaluation.schemes.is_empty()
        || evaluation.noises_px.is_empty()
        || evaluation.outlier_shares.is_empty()
        || evaluation.problems == 0
    {
        return refuse("no scene, scheme, noise, share of outliers or problem to evaluate".to_owned());
    }
    if let Some(noise) = evaluation.noises_px.iter().find(|n| !(n.is_finite() && **n >= 0.0)) {
        return refuse(format!("a noise of {noise} pixels is not possible"));
    }
    if let Some(share) = evaluation.outlier_shares.iter().find(|s| !(0.0..1.0).contains(*s)) {
        return refuse(format!("a share of outliers of {share} is not possible"));
    }
    // With fewer true matches the bound would be infinite.
    let right = |share: f64| ((1.0 - share) * evaluation.matches as f64).round() as usize;
    if let Some(share) = evaluation.outlier_shares.iter().find(|s| right(**s) < MIN_INLIERS) {
        return refuse(format!(
            "{} matches with {:.0} % outliers leave {} right ones, but at least {MIN_INLIERS} are needed; use more matches",
            evaluation.matches,
            100.0 * share,
            right(*share)
        ));
    }
    Ok(())
}

/// Minimum number of true matches of a problem: about the smallest consensus that the estimator accepts.
const MIN_INLIERS: usize = 12;

fn cell(condition: &Condition, scheme: Scheme, trials: &[Trial]) -> BoundCell {
    let all: Vec<&Trial> = trials.iter().collect();
    let found: Vec<&Trial> = trials.iter().filter(|t| t.found()).collect();
    let share = |count: usize| count as f64 / trials.len().max(1) as f64;
    let translation = Medians::of(&found, |e| e.translation);
    let rotation = Medians::of(&found, |e| e.rotation_deg);
    BoundCell {
        scene: condition.scene.to_string(),
        scheme: scheme.to_string(),
        noise_px: condition.noise_px,
        outlier_ratio: condition.outlier_ratio,
        problems: trials.len(),
        localized: share(trials.iter().filter(|t| t.localized).count()),
        found: share(found.len()),
        inlier_recall: mean(&trials.iter().map(|t| t.inlier_recall).collect::<Vec<_>>()),
        median_translation: translation.measured,
        bound_translation: translation.predicted,
        translation_ratio: translation.ratio(),
        median_rotation_deg: rotation.measured,
        bound_rotation_deg: rotation.predicted,
        rotation_ratio: rotation.ratio(),
        translation_ratio_all: Medians::of(&all, |e| e.translation).ratio(),
        rotation_ratio_all: Medians::of(&all, |e| e.rotation_deg).ratio(),
    }
}

/// Median errors, measured and predicted; `None` if infinite or empty.
struct Medians {
    measured: Option<f64>,
    predicted: Option<f64>,
}

impl Medians {
    fn of(trials: &[&Trial], error: impl Fn(&PoseErrors) -> f64) -> Self {
        let measured: Vec<f64> = trials.iter().map(|t| error(&t.error)).collect();
        let predicted: Vec<f64> = trials.iter().flat_map(|t| t.predicted.iter().map(&error)).collect();
        Self { measured: finite(median(&measured)), predicted: finite(median(&predicted)) }
    }

    fn ratio(&self) -> Option<f64> {
        self.measured.zip(self.predicted).and_then(|(measured, predicted)| finite(measured / predicted))
    }
}

fn coverage(scene: &str, scheme: Scheme, noise_px: Option<f64>, trials: &[Trial]) -> BoundCoverage {
    let found: Vec<&Trial> = trials.iter().filter(|t| t.found()).collect();
    let of = |region: fn(&NormalizedError) -> f64| {
        shares(&found.iter().map(|t| region(&t.normalized)).collect::<Vec<_>>())
    };
    BoundCoverage {
        scene: scene.to_owned(),
        scheme: scheme.to_string(),
        noise_px,
        poses: found.len(),
        pose: of(NormalizedError::pose_region),
        center: of(NormalizedError::center_region),
    }
}
