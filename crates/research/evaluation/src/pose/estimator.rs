//! Estimators: configurations of retrieval, matching and pose estimation, compared on the same queries.

use std::path::Path;
use std::str::FromStr;

use serde::{Deserialize, Deserializer};
use veiloc_localization::LocalizeOptions;
use veiloc_map::text::read_text;
use veiloc_pose::{AnchoredSolver, ScoreKind};

use crate::EvalError;
use crate::results::EstimatorVariant;

/// A configuration, by name or from a file.
///
/// | name | score | dcl's minimal solver | prior of the matches |
/// |---|---|---|---|
/// | `default` | the default | the default | yes |
/// | `paper` | MSAC | `p6lp` | no |
/// | `likelihood` | likelihood | `p6lp` | no |
/// | `likelihood+prior` | likelihood | `p6lp` | yes |
/// | `vote` | likelihood | radial vote | yes |
/// | `optimum` | the default estimator, started from the true pose: the result of a perfect search | | yes |
/// | `floor` | least squares from the true pose on the true matches: a lower limit | | |
///
/// Points are always sampled with `p3p`, lines of any direction with `p6lp`. `optimum` and `floor` are rows of
/// [`crate::pose::evaluate_poses`] only.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Estimator {
    /// Its name in tables and documents.
    pub name: String,
    /// Retrieval, matching and pose estimation.
    pub localize: LocalizeOptions,
    /// Whether it is the paper's without an inlier threshold of its own: published data sets each have one.
    pub as_published: bool,
    /// Whether its file names a number of retrieved images: otherwise a published data set has its own.
    pub names_retrieve: bool,
    /// What starts from the true pose instead of a search.
    pub(crate) from_truth: Option<TruthStart>,
}

/// What starts from the true pose instead of a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TruthStart {
    /// Optimization of the estimator's own objective, over all matches.
    Optimum,
    /// Least squares on the true matches.
    Floor,
}

/// Name, score and solver, prior, start.
type Named = (&'static str, Option<(ScoreKind, AnchoredSolver)>, bool, Option<TruthStart>);

const NAMED: [Named; 7] = [
    ("default", None, true, None),
    (PAPER, Some((ScoreKind::Msac, AnchoredSolver::P6lp)), false, None),
    ("likelihood", Some((ScoreKind::Likelihood, AnchoredSolver::P6lp)), false, None),
    ("likelihood+prior", Some((ScoreKind::Likelihood, AnchoredSolver::P6lp)), true, None),
    ("vote", Some((ScoreKind::Likelihood, AnchoredSolver::RadialVote)), true, None),
    ("optimum", None, true, Some(TruthStart::Optimum)),
    ("floor", None, false, Some(TruthStart::Floor)),
];

const PAPER: &str = "paper";

/// More hypotheses would take hours per query.
const MAX_HYPOTHESES: usize = 10_000_000;

/// A file: changes to a named estimator.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct EstimatorFile {
    /// Default: the file's name without ending.
    name: Option<String>,
    /// Name of the estimator that it changes. Default: `default`.
    base: Option<String>,
    #[serde(default, deserialize_with = "parsed")]
    score: Option<ScoreKind>,
    #[serde(default, deserialize_with = "parsed")]
    solver: Option<AnchoredSolver>,
    max_error_px: Option<f64>,
    noise_px: Option<f64>,
    estimate_noise: Option<bool>,
    /// Exactly this many; without it the search stops when a better one is unlikely.
    hypotheses: Option<usize>,
    prior: Option<bool>,
    retrieve: Option<usize>,
    ratio: Option<f32>,
}

fn parsed<'de, D: Deserializer<'de>, T: FromStr<Err: std::fmt::Display>>(
    value: D,
) -> Result<Option<T>, D::Error> {
    String::deserialize(value)?.parse().map(Some).map_err(serde::de::Error::custom)
}

impl Estimator {
    /// The estimator of this name.
    ///
    /// # Errors
    /// [`EvalError::Options`] with all names.
    pub fn named(text: &str) -> Result<Self, EvalError> {
        NAMED.into_iter().find(|(name, ..)| *name == text).map(Self::of).ok_or_else(|| {
            let names = NAMED.map(|(name, ..)| name).join(", ");
            EvalError::Options(format!(
                "{text:?} is not an estimator; use {names}, or a TOML file whose name ends in .toml"
            ))
        })
    }

    fn of((name, sampling, prior, from_truth): Named) -> Self {
        let mut localize = LocalizeOptions::default();
        localize.pose.score = sampling.map(|(score, _)| score);
        localize.pose.anchored_solver = sampling.map(|(_, solver)| solver);
        localize.use_prior = prior;
        Self {
            name: name.to_owned(),
            localize,
            as_published: name == PAPER,
            names_retrieve: false,
            from_truth,
        }
    }

    fn of_file(path: &Path) -> Result<Self, EvalError> {
        let refused = |reason: String| EvalError::Options(format!("{}: {reason}", path.display()));
        let text = read_text(path).map_err(|error| refused(format!("{error}; check the path")))?;
        let file: EstimatorFile =
            toml::from_str(&text).map_err(|error| refused(error.to_string().trim().to_owned()))?;
        let above_0 = |px: Option<f64>| px.is_none_or(|px| px.is_finite() && px > 0.0);
        for (key, is_right, expected) in [
            ("max-error-px", above_0(file.max_error_px), "a number above 0"),
            ("noise-px", above_0(file.noise_px), "a number above 0"),
            (
                "hypotheses",
                file.hypotheses.is_none_or(|n| (1..=MAX_HYPOTHESES).contains(&n)),
                "1 to 10000000, or no such key for a search that stops by itself",
            ),
            ("retrieve", file.retrieve != Some(0), "a number above 0"),
            ("ratio", file.ratio.is_none_or(|ratio| ratio > 0.0 && ratio <= 1.0), "above 0, at most 1"),
        ] {
            if !is_right {
                return Err(refused(format!("{key} is out of range; write {expected}")));
            }
        }
        let base = file.base.as_deref().unwrap_or("default");
        let mut estimator = Self::named(base).map_err(|error| refused(format!("base: {error}")))?;
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        estimator.name = file.name.unwrap_or(stem);
        estimator.as_published &= file.max_error_px.is_none();
        estimator.names_retrieve |= file.retrieve.is_some();
        let LocalizeOptions { retrieve, matching, use_prior, pose, .. } = &mut estimator.localize;
        *retrieve = file.retrieve.unwrap_or(*retrieve);
        matching.max_ratio = file.ratio;
        *use_prior = file.prior.unwrap_or(*use_prior);
        pose.score = file.score.or(pose.score);
        pose.anchored_solver = file.solver.or(pose.anchored_solver);
        pose.max_error_px = file.max_error_px.unwrap_or(pose.max_error_px);
        pose.noise_px = file.noise_px.unwrap_or(pose.noise_px);
        pose.estimate_noise = file.estimate_noise.unwrap_or(pose.estimate_noise);
        pose.fixed_hypotheses = file.hypotheses;
        Ok(estimator)
    }

    /// Whether it finds poses without the true one.
    pub const fn searches(&self) -> bool {
        self.from_truth.is_none()
    }

    /// How it compares hypotheses.
    pub fn score(&self) -> ScoreKind {
        self.localize.pose.score.unwrap_or_default()
    }

    /// Its part of a row, without gravity.
    pub(crate) fn variant(&self) -> EstimatorVariant {
        EstimatorVariant {
            recipe: Some(self.name.clone()),
            prior: self.localize.use_prior,
            fixed_hypotheses: self.localize.pose.fixed_hypotheses.filter(|_| self.searches()),
            gravity: None,
        }
    }
}

/// The number of hypotheses that all have, if it is fixed.
pub(crate) fn common_hypotheses(estimators: &[Estimator]) -> Option<usize> {
    let of = |estimator: &Estimator| estimator.localize.pose.fixed_hypotheses;
    let first = estimators.first().and_then(of);
    first.filter(|_| estimators.iter().all(|estimator| of(estimator) == first))
}

impl Default for Estimator {
    fn default() -> Self {
        Self::of(NAMED[0])
    }
}

impl FromStr for Estimator {
    type Err = EvalError;

    /// A name, or a file that ends in `.toml`.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let path = Path::new(text);
        if path.extension().is_some_and(|ending| ending == "toml") {
            Self::of_file(path)
        } else {
            Self::named(text)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of_file(text: &str) -> Result<Estimator, String> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("mine.toml");
        std::fs::write(&path, text).expect("a file");
        path.to_str().expect("UTF-8").parse().map_err(|error: EvalError| error.to_string())
    }

    #[test]
    fn named_estimators_have_documented_options() {
        let of = |name: &str| Estimator::named(name).expect("a name");
        for (name, score, solver, prior) in [
            ("default", None, None, true),
            ("paper", Some(ScoreKind::Msac), Some(AnchoredSolver::P6lp), false),
            ("likelihood", Some(ScoreKind::Likelihood), Some(AnchoredSolver::P6lp), false),
            ("likelihood+prior", Some(ScoreKind::Likelihood), Some(AnchoredSolver::P6lp), true),
            ("vote", Some(ScoreKind::Likelihood), Some(AnchoredSolver::RadialVote), true),
        ] {
            let LocalizeOptions { pose, use_prior, .. } = of(name).localize;
            assert_eq!((pose.score, pose.anchored_solver, use_prior), (score, solver, prior), "{name}");
        }
        assert!(!of("floor").searches() && of("vote").searches());
        assert_eq!(Estimator::default().name, "default");
        assert!("msac".parse::<Estimator>().is_err());
    }

    #[test]
    fn files_change_what_they_name() {
        let file = "base = \"paper\"\nhypotheses = 1000\nnoise-px = 1.5\nratio = 0.8\n";
        let changed = of_file(file).expect("well written");
        assert_eq!((changed.name.as_str(), changed.as_published), ("mine", true));
        assert_eq!(
            (changed.score(), changed.localize.use_prior, changed.localize.retrieve),
            (ScoreKind::Msac, false, 10)
        );
        let pose = &changed.localize.pose;
        assert_eq!((pose.fixed_hypotheses, pose.noise_px, pose.max_error_px), (Some(1000), 1.5, 4.0));
        assert!(!of_file("base = \"paper\"\nmax-error-px = 8").expect("well written").as_published);
        let integers = of_file("name = \"a\"\nmax-error-px = 8\nprior = false").expect("well written");
        assert_eq!((integers.name.as_str(), integers.localize.use_prior), ("a", false));
    }

    #[test]
    fn errors_name_file_key_and_remedy() {
        for (file, words) in [
            ("scores = 1", &["line 1", "scores", "`score`"][..]),
            ("retrieve = 10\nscore = \"best\"", &["line 2", "best", "msac"]),
            ("solver = 5", &["solver", "string"]),
            ("base = \"mine\"", &["base", "likelihood+prior"]),
            ("max-error-px = nan", &["max-error-px", "above 0"]),
            ("noise-px = -3.0", &["noise-px", "above 0"]),
            ("hypotheses = 0", &["hypotheses", "1 to 10000000"]),
            ("hypotheses = \"some\"", &["line 1", "hypotheses", "some"]),
            ("retrieve = 0", &["retrieve", "above 0"]),
            ("ratio = 1.5", &["ratio", "at most 1"]),
        ] {
            let error = of_file(file).expect_err("an invalid file");
            let is_named = |word: &&str| error.contains(word);
            assert!(words.iter().chain(&["mine.toml"]).all(is_named), "{file}: {error}");
        }
    }
}
