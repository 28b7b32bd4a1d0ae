//! The estimators of `eval`, and numbers as options.

use veiloc_evaluation::pose::Estimator;

use crate::output::exit::Failure;

/// Estimators, and the seed.
#[derive(clap::Args)]
pub(crate) struct EstimatorArgs {
    /// How queries are localized: default, paper, likelihood, likelihood+prior, vote, or a TOML file.
    #[arg(long, value_delimiter = ',', value_name = "NAME|FILE.toml,…", default_value = "default", long_help = ESTIMATORS)]
    estimator: Vec<Estimator>,
    /// Seed of every random choice; equal seeds give equal results.
    #[arg(long, default_value_t = 0, value_name = "N")]
    pub seed: u64,
}

const ESTIMATORS: &str = "\
How queries are localized. Points are always sampled with p3p, lines of any direction with p6lp, or
with the gravity solvers.

  default           as in the service
  paper             MSAC; for dcl p6lp; equal match weights
  likelihood        the likelihood instead of MSAC
  likelihood+prior  the same, with match weights from ratio, votes and track length
  vote              the same, for dcl with the radial vote
  FILE.toml         changes to one of them; every key may be left out:

    name = \"mine\"           in the table; otherwise the file's name
    base = \"paper\"          otherwise default
    score = \"msac\"          or likelihood, which models the anchors of dcl
    solver = \"p6lp\"         for dcl: p6lp (six lines), dual-radial (five lines of one
                            anchor and one of the other) or radial-vote (five lines)
    max-error-px = 4.0      inlier threshold for points; divided by √2 for lines
    noise-px = 2.0          standard deviation of a keypoint across its line
    estimate-noise = false  use it as given in the final refinement too
    hypotheses = 1000       otherwise the search stops by itself
    prior = false           equal match weights
    retrieve = 10           map images that a query is matched with; otherwise 10, for Aachen 50
    ratio = 0.8             of nearest to second-nearest descriptor distance, at most";

impl EstimatorArgs {
    /// Returns all estimators, also those that start from the true pose.
    ///
    /// # Errors
    /// Two have one name.
    pub(crate) fn all(&self) -> Result<Vec<Estimator>, Failure> {
        let names: Vec<&str> = self.estimator.iter().map(|estimator| estimator.name.as_str()).collect();
        if let Some(name) = (1..names.len()).find(|&i| names[..i].contains(&names[i])) {
            let text = format!("two estimators are called {:?}", names[name]);
            return Err(Failure::with_help(text, "leave one out, or give its file a `name`"));
        }
        let with_seed = |estimator: &Estimator| {
            let mut estimator = estimator.clone();
            estimator.localize.seed = self.seed;
            estimator
        };
        Ok(self.estimator.iter().map(with_seed).collect())
    }

    /// Returns the estimators of a table.
    ///
    /// # Errors
    /// One starts from the true pose, or two have one name.
    pub(crate) fn estimators(&self) -> Result<Vec<Estimator>, Failure> {
        match self.estimator.iter().find(|estimator| !estimator.searches()) {
            None => self.all(),
            Some(oracle) => Err(Failure::with_help(
                format!("the estimator {} starts from the true pose", oracle.name),
                "give it to `eval pose` only",
            )),
        }
    }

    /// Returns the only estimator.
    ///
    /// # Errors
    /// It starts from the true pose, or there are several.
    pub(crate) fn estimator(&self) -> Result<Estimator, Failure> {
        let mut estimators = self.estimators()?;
        if estimators.len() > 1 {
            let text = format!("this command has one estimator, not {}", estimators.len());
            return Err(Failure::with_help(text, "give one --estimator"));
        }
        Ok(estimators.swap_remove(0))
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
