//! Recipes: named configurations of the pose estimator, compared on the same matches.

use std::fmt;
use std::str::FromStr;

use veiloc_pose::{AnchoredSolver, PoseOptions, ScoreKind};

/// A configuration of the pose estimator.
///
/// | name | score | dcl's minimal solver | prior of the matches |
/// |---|---|---|---|
/// | `paper` | MSAC | `p6lp` | no |
/// | `likelihood` | likelihood | `p6lp` | no |
/// | `likelihood+prior` | likelihood | `p6lp` | yes |
/// | `vote` | likelihood | radial vote | yes |
/// | `default` | the default | the default | yes |
/// | `optimum` | the default engine, started from the true pose: the result of a perfect search | | yes |
/// | `floor` | least squares from the true pose on the true matches: a lower limit | | |
///
/// Points are always sampled with `p3p`, lines of any direction with `p6lp`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Recipe {
    /// The paper's.
    Paper,
    /// The likelihood in place of MSAC.
    Likelihood,
    /// The likelihood, with a prior from ratio, votes and track length of each match.
    LikelihoodPrior,
    /// The same, with the radial vote for dcl.
    Vote,
    /// The shipped engine.
    Default,
    /// The shipped engine's optimum from the true pose, over all matches.
    Optimum,
    /// Refinement from the true pose on the true matches.
    Floor,
}

/// What starts from the true pose instead of a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TruthStart {
    /// Optimization of the engine's own objective, over all matches.
    Optimum,
    /// Least squares on the true matches.
    Floor,
}

/// A text names no recipe.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} is not a recipe; use one of paper, likelihood, likelihood+prior, vote, default, optimum and floor"
)]
pub struct RecipeError(String);

impl Recipe {
    /// Every recipe once, in the order of a table.
    pub const ALL: [Self; 7] = [
        Self::Paper,
        Self::Likelihood,
        Self::LikelihoodPrior,
        Self::Vote,
        Self::Default,
        Self::Optimum,
        Self::Floor,
    ];

    /// The name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Likelihood => "likelihood",
            Self::LikelihoodPrior => "likelihood+prior",
            Self::Vote => "vote",
            Self::Default => "default",
            Self::Optimum => "optimum",
            Self::Floor => "floor",
        }
    }

    /// Whether matches are weighted by their prior.
    pub(crate) const fn uses_prior(self) -> bool {
        matches!(self, Self::LikelihoodPrior | Self::Vote | Self::Default | Self::Optimum)
    }

    /// What it starts from the true pose, if anything.
    pub(crate) const fn start_at_truth(self) -> Option<TruthStart> {
        match self {
            Self::Optimum => Some(TruthStart::Optimum),
            Self::Floor => Some(TruthStart::Floor),
            Self::Paper | Self::Likelihood | Self::LikelihoodPrior | Self::Vote | Self::Default => None,
        }
    }

    /// The estimator's options under this recipe; thresholds and noise are unchanged.
    pub(crate) fn apply(self, options: &PoseOptions) -> PoseOptions {
        let mut options = options.clone();
        (options.score, options.anchored_solver) = match self {
            Self::Paper => (Some(ScoreKind::Msac), Some(AnchoredSolver::P6lp)),
            Self::Likelihood | Self::LikelihoodPrior => {
                (Some(ScoreKind::Likelihood), Some(AnchoredSolver::P6lp))
            }
            Self::Vote => (Some(ScoreKind::Likelihood), Some(AnchoredSolver::RadialVote)),
            Self::Default | Self::Optimum | Self::Floor => (None, None),
        };
        options
    }
}

impl FromStr for Recipe {
    type Err = RecipeError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let known = Self::ALL.into_iter().find(|recipe| recipe.name() == text.trim());
        known.ok_or_else(|| RecipeError(text.to_owned()))
    }
}

impl fmt::Display for Recipe {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recipe_names_round_trip() {
        for recipe in Recipe::ALL {
            assert_eq!(recipe.to_string().parse(), Ok(recipe));
        }
        assert!("msac".parse::<Recipe>().is_err());
    }

    #[test]
    fn recipes_set_documented_options() {
        let mut given = PoseOptions::default();
        given.noise_px = 1.25;
        given.score = Some(ScoreKind::Msac);
        let of = |recipe: Recipe| recipe.apply(&given);
        let score_and_solver = |recipe| (of(recipe).score, of(recipe).anchored_solver);
        assert_eq!(score_and_solver(Recipe::Paper), (Some(ScoreKind::Msac), Some(AnchoredSolver::P6lp)));
        assert_eq!(
            score_and_solver(Recipe::Likelihood),
            (Some(ScoreKind::Likelihood), Some(AnchoredSolver::P6lp))
        );
        assert_eq!(
            score_and_solver(Recipe::Vote),
            (Some(ScoreKind::Likelihood), Some(AnchoredSolver::RadialVote))
        );
        assert_eq!(score_and_solver(Recipe::Default), (None, None));
        assert!(Recipe::ALL.iter().all(|r| of(*r).noise_px == 1.25), "only what the recipe names is changed");
    }
}
