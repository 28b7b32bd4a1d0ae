//! Recall, median errors and milliseconds of each recipe on the problems of a `problems.jsonl.gz`.
//!
//! ```text
//! cargo run --release -p veiloc-pose --example problems -- $VEILOC_DATA/problems/redkitchen_nn.jsonl.gz \
//!     --threshold 0.05/5 --hypotheses 1000 --seeds 3
//! ```
//!
//! Options: `--threshold UNITS/DEGREES`, `--hypotheses N` (exactly N; adaptive without), `--seeds N` runs per query,
//! `--recipes a,b,…` of `points`, `lines`, `dcl`, each optionally with `:msac` or `:likelihood`, a solver (`:p6lp`,
//! `:radial-vote`) and `+prior`, or `:floor` (refinement from the true pose on the right matches), `--prior
//! OFFSET,RATIO,LOG_VOTES,LOG_TRACK_LENGTH` for other coefficients than the built-in ones (`study features match-prior`
//! prints them), `--noise PX`, `--max-error PX`.
#![expect(clippy::print_stdout, reason = "the table is the product")]

#[path = "../tests/it/support/problems.rs"]
mod support;

use std::time::Instant;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use support::{Failure, Query, obfuscate, read};
use veiloc_descriptor::DescriptorKind;
use veiloc_descriptor::{PriorModel, match_probability, probability};
use veiloc_geometry::frames::World;
use veiloc_geometry::statistics::upper_median;
use veiloc_geometry::{Pixel, PlanePoint, Point3};
use veiloc_pose::{AnchoredSolver, PoseOptions, PoseProblem, ScoreKind, estimate_pose, refine_pose};

struct Recipe {
    name: String,
    scheme: String,
    score: Option<ScoreKind>,
    solver: Option<AnchoredSolver>,
    prior: bool,
    floor: bool,
}

fn main() -> Result<(), Failure> {
    let mut files = Vec::new();
    let mut prior = None;
    let mut options = PoseOptions::default();
    let (mut units, mut degrees, mut seeds) = (0.05, 5.0, 1_u64);
    let mut recipes = "points:msac,points:likelihood,points:likelihood+prior,lines:msac,lines:likelihood,\
                       lines:likelihood+prior,dcl:msac:p6lp,dcl:likelihood:p6lp,dcl:likelihood:p6lp+prior,\
                       dcl:likelihood:radial-vote,dcl:likelihood:radial-vote+prior"
        .to_owned();
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{argument} needs a value"));
        match argument.as_str() {
            "--threshold" => {
                let text = value()?;
                let (u, d) = text.split_once('/').ok_or("--threshold needs UNITS/DEGREES")?;
                (units, degrees) = (u.parse()?, d.parse()?);
            }
            "--hypotheses" => options.fixed_hypotheses = Some(value()?.parse()?),
            "--seeds" => seeds = value()?.parse()?,
            "--recipes" => recipes = value()?,
            "--noise" => options.noise_px = value()?.parse()?,
            "--prior" => {
                let c = value()?.split(',').map(str::parse).collect::<Result<Vec<f64>, _>>()?;
                let [offset, ratio, log_votes, log_track_length] = c[..] else {
                    return Err("--prior needs four numbers".into());
                };
                prior = Some(PriorModel { offset, ratio, log_votes, log_track_length });
            }
            "--max-error" => options.max_error_px = value()?.parse()?,
            _ => files.push(argument),
        }
    }
    for file in &files {
        let queries = read(file)?;
        println!("{file}: {} queries, {seeds} seeds, recall at {units} units / {degrees} deg", queries.len());
        println!(
            "{:36} {:>8} {:>10} {:>10} {:>10} {:>8} {:>10} {:>8}",
            "recipe", "recall", "med units", "geo units", "med deg", "inliers", "samples", "med ms"
        );
        for text in recipes.split(',') {
            evaluate(&recipe(text)?, &queries, &options, prior.as_ref(), seeds, (units, degrees));
        }
    }
    Ok(())
}

fn recipe(text: &str) -> Result<Recipe, Failure> {
    let (rest, prior) = text.strip_suffix("+prior").map_or((text, false), |r| (r, true));
    let mut parts = rest.split(':');
    let scheme = parts.next().unwrap_or_default().to_owned();
    let word = parts.next();
    let floor = word == Some("floor");
    let score = word.filter(|_| !floor).map(str::parse).transpose()?;
    let solver = parts.next().map(str::parse).transpose()?;
    Ok(Recipe { name: text.to_owned(), scheme, score, solver, prior, floor })
}

fn evaluate(
    recipe: &Recipe,
    queries: &[Query],
    options: &PoseOptions,
    prior: Option<&PriorModel>,
    seeds: u64,
    threshold: (f64, f64),
) {
    let mut options = options.clone();
    options.score = recipe.score;
    options.anchored_solver = recipe.solver;
    let (mut hits, mut units, mut degrees, mut ms) = (0, Vec::new(), Vec::new(), Vec::new());
    let (mut inliers, mut samples) = (Vec::new(), Vec::new());
    let fitted = DescriptorKind::ROOT_SIFT.match_prior();
    for (index, query) in queries.iter().enumerate() {
        for seed in 0..seeds {
            let mut rng = ChaCha8Rng::seed_from_u64(1000 * seed + index as u64);
            let observations = obfuscate(query, &recipe.scheme, &mut rng);
            let mut problem =
                PoseProblem::new(query.camera, observations, query.keypoints.clone(), query.points.clone());
            problem.prior = recipe.prior.then(|| {
                query
                    .evidence
                    .iter()
                    .map(|e| prior.map_or_else(|| match_probability(&fitted, e), |p| probability(p, e)))
                    .collect()
            });
            let started = Instant::now();
            let estimate = if recipe.floor {
                refine_pose(&problem, &query.truth, &right(query), &options)
            } else {
                estimate_pose(&problem, &options, &mut rng)
            };
            ms.push(started.elapsed().as_secs_f64() * 1e3);
            let (u, d) = estimate.as_ref().map_or((f64::INFINITY, f64::INFINITY), |e| {
                (
                    e.cam_from_world.translation_error(&query.truth),
                    e.cam_from_world.rotation_error_degrees(&query.truth),
                )
            });
            hits += usize::from(u <= threshold.0 && d <= threshold.1);
            units.push(u);
            degrees.push(d);
            inliers.push(estimate.as_ref().map_or(0.0, |e| e.inlier_count as f64));
            samples.push(estimate.as_ref().map_or(0.0, |e| e.hypotheses as f64));
        }
    }
    println!(
        "{:36} {:>7.1}% {:>10.4} {:>10.4} {:>10.3} {:>8.0} {:>10.0} {:>8.1}",
        recipe.name,
        100.0 * hits as f64 / ms.len() as f64,
        median(&mut units),
        geometric_mean(&units),
        median(&mut degrees),
        median(&mut inliers),
        median(&mut samples),
        median(&mut ms)
    );
}

/// Matches whose keypoint lies within four pixels of the point's projection under the true pose.
fn right(query: &Query) -> Vec<bool> {
    let near = |(pixel, point): (&Pixel, &Point3<World>)| {
        let seen = PlanePoint::from_camera_point(&query.truth.transform(point));
        seen.is_some_and(|p| query.camera.project(p).distance(pixel) < 4.0)
    };
    query.pixels.iter().zip(&query.points).map(near).collect()
}

/// A single query changes it less than the median of two dozen queries.
fn geometric_mean(values: &[f64]) -> f64 {
    (values.iter().map(|v| v.max(1e-9).ln()).sum::<f64>() / values.len() as f64).exp()
}

fn median(values: &mut [f64]) -> f64 {
    upper_median(values).unwrap_or(f64::NAN)
}
