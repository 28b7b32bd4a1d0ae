//! Localization options that `localize` and `eval` share, each with its meaning and the reason for its default.

use veiloc_evaluation::results::Hypotheses;
use veiloc_localization::LocalizeOptions;
use veiloc_pose::{AnchoredSolver, PoseOptions, ScoreKind};

/// How one pose is estimated.
#[derive(clap::Args, Debug)]
pub(crate) struct EngineArgs {
    /// Score of hypotheses: `msac` (pixel distance to the line, as in the paper) or `likelihood` (models the anchors of
    /// dcl, which bias msac). Default: likelihood.
    #[arg(long, value_name = "SCORE")]
    pub score: Option<ScoreKind>,
    /// Minimal solver for dcl: `p6lp` (six lines, as in the paper), `dual-radial` (five lines of one anchor and one of
    /// the other) or `radial-vote` (five lines of one anchor, then a vote over the lines of the other). Default:
    /// radial-vote with likelihood, p6lp with msac.
    #[arg(long, value_name = "SOLVER")]
    pub solver: Option<AnchoredSolver>,
    /// Inlier threshold for points in pixels; for lines it is divided by √2, as in the paper.
    #[arg(long, value_name = "PX", default_value_t = PoseOptions::default().max_error_px, value_parser = positive)]
    pub max_error: f64,
    /// Standard deviation of a keypoint across its line in pixels; the only scale of the likelihood. The search uses it
    /// as given; the final refinement starts from it and estimates it from the inliers.
    #[arg(long, value_name = "PX", default_value_t = PoseOptions::default().noise_px, value_parser = positive)]
    pub noise: f64,
    /// Keep --noise fixed in the final refinement too.
    #[arg(long)]
    pub fixed_noise: bool,
}

impl EngineArgs {
    /// Returns the library's options; the number of hypotheses is adaptive.
    pub(crate) fn options(&self) -> PoseOptions {
        let mut options = PoseOptions::default();
        options.score = self.score;
        options.anchored_solver = self.solver;
        options.max_error_px = self.max_error;
        options.noise_px = self.noise;
        options.estimate_noise = !self.fixed_noise;
        options
    }
}

/// Match weights, and the seed.
#[derive(clap::Args, Debug)]
pub(crate) struct RunArgs {
    /// Give all matches the same weight, instead of weights from descriptor ratio, votes of the retrieved images and
    /// track length.
    #[arg(long)]
    pub no_prior: bool,
    /// Seed of every random choice; equal seeds give equal results.
    #[arg(long, default_value_t = 0, value_name = "N")]
    pub seed: u64,
}

impl RunArgs {
    /// Returns whether matches are weighted.
    pub(crate) const fn use_prior(&self) -> bool {
        !self.no_prior
    }
}

/// How poses are estimated.
#[derive(clap::Args, Debug)]
pub(crate) struct PoseArgs {
    /// How one pose is estimated.
    #[command(flatten)]
    pub engine: EngineArgs,
    /// Number of hypotheses; `adaptive` stops when a better one is unlikely.
    #[arg(long, value_name = "N", default_value = "adaptive")]
    pub hypotheses: Hypotheses,
    /// Match weights, and the seed.
    #[command(flatten)]
    pub run: RunArgs,
}

impl PoseArgs {
    /// The library's options.
    pub(crate) fn options(&self) -> PoseOptions {
        let mut options = self.engine.options();
        options.fixed_hypotheses = self.hypotheses.fixed();
        options
    }
}

/// How queries are matched to the map.
#[derive(clap::Args, Debug)]
pub(crate) struct MatchArgs {
    /// Number of map images that a query is matched with, the most similar first.
    #[arg(long, default_value_t = 10, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub retrieve: u32,
    /// Keep only matches whose ratio of nearest to second-nearest descriptor distance is below this value, 0 to 1.
    /// Default: mutual nearest neighbours without ratio test, as in the paper.
    #[arg(long, value_name = "RATIO", value_parser = share)]
    pub ratio: Option<f32>,
}

impl MatchArgs {
    /// Returns the library's options, with default pose estimation.
    pub(crate) fn localize_options(&self) -> LocalizeOptions {
        let mut options = LocalizeOptions::default();
        options.retrieve = self.retrieve as usize;
        options.matching.max_ratio = self.ratio;
        options
    }

    /// Returns the library's options.
    pub(crate) fn options(&self, pose: &PoseArgs) -> LocalizeOptions {
        let mut options = self.localize_options();
        options.use_prior = pose.run.use_prior();
        options.pose = pose.options();
        options.seed = pose.run.seed;
        options
    }
}

/// Parses a number above zero.
///
/// # Errors
/// The reason why the text is not such a number, for clap.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("{text:?} is not a number"))?;
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err("a number above 0 is expected".to_owned()) }
}

/// Parses a number that is not negative.
///
/// # Errors
/// The reason why the text is not such a number, for clap.
pub(crate) fn not_negative(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("{text:?} is not a number"))?;
    if value.is_finite() && value >= 0.0 {
        Ok(value)
    } else {
        Err("a number of at least 0 is expected".to_owned())
    }
}

/// Parses a number above zero and at most one.
fn share(text: &str) -> Result<f32, String> {
    let value: f32 = text.parse().map_err(|_| format!("{text:?} is not a number"))?;
    if value > 0.0 && value <= 1.0 {
        Ok(value)
    } else {
        Err("a number above 0, at most 1, is expected".to_owned())
    }
}
