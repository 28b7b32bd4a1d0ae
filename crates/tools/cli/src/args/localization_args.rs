//! Options of localization that `localize` and `eval` share, each with its meaning and why the default.

use veiloc_evaluation::results::Hypotheses;
use veiloc_localization::LocalizeOptions;
use veiloc_pose::{AnchoredSolver, PoseOptions, ScoreKind};

/// How one pose is estimated.
#[derive(clap::Args, Debug)]
pub(crate) struct EngineArgs {
    /// How hypotheses are compared: `msac` (pixel distance to the line, the paper's recipe) or `likelihood`
    /// (knows the anchors of dcl, whose collapse misleads msac). Default: likelihood.
    #[arg(long, value_name = "SCORE")]
    pub score: Option<ScoreKind>,
    /// Minimal solver for dcl: `p6lp` (six lines, the paper's recipe), `dual-radial` (five lines of one anchor and one of
    /// the other) or `radial-vote` (five of one, then a vote of the other's). Default: radial-vote with the likelihood,
    /// p6lp with msac.
    #[arg(long, value_name = "SOLVER")]
    pub solver: Option<AnchoredSolver>,
    /// Inlier threshold for points in pixels; lines use it divided by √2, as in the paper.
    #[arg(long, value_name = "PX", default_value_t = PoseOptions::default().max_error_px, value_parser = positive)]
    pub max_error: f64,
    /// Noise of a keypoint across its line in pixels, the likelihood's only scale. The search takes it as it is; the
    /// final refinement starts from it and takes what the inliers show.
    #[arg(long, value_name = "PX", default_value_t = PoseOptions::default().noise_px, value_parser = positive)]
    pub noise: f64,
    /// Take the noise as given in the final refinement as well.
    #[arg(long)]
    pub fixed_noise: bool,
}

impl EngineArgs {
    /// The library's options; hypotheses are drawn until a better one is unlikely.
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

/// How matches are weighed, and the seed.
#[derive(clap::Args, Debug)]
pub(crate) struct RunArgs {
    /// Weigh all matches alike, instead of by descriptor ratio, votes of the retrieved images and track length.
    #[arg(long)]
    pub no_prior: bool,
    /// Seed of every random choice; equal seeds give equal results.
    #[arg(long, default_value_t = 0, value_name = "N")]
    pub seed: u64,
}

impl RunArgs {
    /// Whether matches are weighed by what speaks for them.
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
    /// Draw exactly this many hypotheses; `adaptive` stops when a better one is unlikely.
    #[arg(long, value_name = "N", default_value = "adaptive")]
    pub hypotheses: Hypotheses,
    /// How matches are weighed, and the seed.
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
    /// Map images to match a query with, the most similar first.
    #[arg(long, default_value_t = 10, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub retrieve: u32,
    /// Keep only matches whose nearest descriptor is this much nearer than the second, 0 to 1. Default: mutual
    /// nearest neighbours without ratio test, as in the paper.
    #[arg(long, value_name = "RATIO", value_parser = share)]
    pub ratio: Option<f32>,
}

impl MatchArgs {
    /// The library's options, with default pose estimation.
    pub(crate) fn localize_options(&self) -> LocalizeOptions {
        let mut options = LocalizeOptions::default();
        options.retrieve = self.retrieve as usize;
        options.matching.max_ratio = self.ratio;
        options
    }

    /// The library's options.
    pub(crate) fn options(&self, pose: &PoseArgs) -> LocalizeOptions {
        let mut options = self.localize_options();
        options.use_prior = pose.run.use_prior();
        options.pose = pose.options();
        options.seed = pose.run.seed;
        options
    }
}

/// A number above zero.
///
/// # Errors
/// What it is not, for the command line.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("{text:?} is no number"))?;
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err("a number above 0 is expected".to_owned()) }
}

/// Zero or a number above it.
///
/// # Errors
/// What it is not, for the command line.
pub(crate) fn not_negative(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("{text:?} is no number"))?;
    if value.is_finite() && value >= 0.0 { Ok(value) } else { Err("a number from 0 is expected".to_owned()) }
}

/// A number above zero, at most one.
fn share(text: &str) -> Result<f32, String> {
    let value: f32 = text.parse().map_err(|_| format!("{text:?} is no number"))?;
    if value > 0.0 && value <= 1.0 {
        Ok(value)
    } else {
        Err("a number above 0, at most 1, is expected".to_owned())
    }
}
