//! The whole road from sealed query to pose, with the time each stage took.

use std::collections::BTreeSet;
use std::time::Instant;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_descriptor::MatchOptions;
use veiloc_geometry::CameraFromWorld;
use veiloc_map::{MapFile, MapView, PointId};
use veiloc_pose::prior::{Evidence, MatchPrior, match_probability};
use veiloc_pose::{
    Confidence, FocalKnowledge, Gravity, PoseOptions, PoseProblem, PositionPrior, State, estimate_pose,
};
use veiloc_protocol::{CoarseGravity, SealedQuery};

use crate::correspondences::observe_matches;
use crate::error::LocalizeError;
use crate::matching::{PointMatch, match_points_until};
use crate::retrieval::{Retrieved, retrieve};
use crate::verdict::{Own, Verdict};

/// How to localize.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct LocalizeOptions {
    /// Map images to match with. 10 is hloc's habit for scenes of this size; more costs time, fewer recall.
    pub retrieve: usize,
    /// Descriptor matching: mutual check on, no ratio test, as in the paper.
    pub matching: MatchOptions,
    /// Whether a match is weighed by its descriptor ratio, the votes of the retrieved images and the track length of its
    /// point, in drawing samples and in the likelihood. Off, all matches count alike, as in the paper.
    pub use_prior: bool,
    /// Robust estimation.
    pub pose: PoseOptions,
    /// Where the camera is, roughly, if somebody knows.
    pub position: Option<PositionPrior>,
    /// Seed of the sampler: equal queries and seeds give equal poses.
    pub seed: u64,
}

impl Default for LocalizeOptions {
    fn default() -> Self {
        Self {
            retrieve: 10,
            matching: MatchOptions::default(),
            use_prior: true,
            pose: PoseOptions::default(),
            position: None,
            seed: 0,
        }
    }
}

/// Milliseconds each stage took.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StageTimes {
    /// Global descriptor against all images of the map.
    pub retrieve_ms: f64,
    /// Descriptors against those of the retrieved images.
    pub match_ms: f64,
    /// Robust estimation with refinement.
    pub pose_ms: f64,
}

/// What became of the direction of gravity that a query may tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum GravityUse {
    /// The query tells none.
    NotTold,
    /// It took part.
    Used,
    /// The query tells it, and the map does not know which way is down: it took no part.
    MapDoesNotKnow,
}

/// Where the query was taken.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Localization {
    /// The pose in the map.
    pub cam_from_world: CameraFromWorld,
    /// Covariance of the pose in the chart of [`CameraFromWorld::perturbed`]: radians, then map units. Calibrated by the
    /// map's self-test, or by [`veiloc_map::Calibration::unmeasured`] where it had none.
    pub covariance: [[f64; 6]; 6],
    /// The estimator's own covariance, in the same chart: what the noise of keypoints and map points alone comes to.
    pub own_covariance: [[f64; 6]; 6],
    /// Whether to trust the pose, and why not. Its standard deviations are those of [`Self::covariance`].
    pub confidence: Confidence,
    /// What became of the direction of gravity that the query may tell.
    pub gravity: GravityUse,
    /// Whether the pose is trusted or doubted; never [`State::NotFound`], which is [`LocalizeError::NoPose`].
    pub state: State,
    /// Standard deviation that the agreeing rows show, pixels: across the line, for points along each axis.
    pub noise_px: f64,
    /// Estimated focal length over the one that the query names; 1 when it was not estimated.
    pub focal_scale: f64,
    /// Rows of the query that agree with the pose: those with a pair that does.
    pub inliers: usize,
    /// Rows of the query that were matched, to one map point or several.
    pub matches: usize,
    /// Pairs of a row and a map point that agree with the pose.
    pub inlier_pairs: usize,
    /// Pairs of a row and a map point: what the pose was estimated from.
    pub pairs: usize,
    /// The pairs themselves, `[pairs]`, sorted by row.
    pub matched: Vec<MatchedPair>,
    /// Hypotheses drawn.
    pub hypotheses: usize,
    /// The images that were matched, best first.
    pub retrieved: Vec<Retrieved>,
    /// Time of each stage.
    pub times: StageTimes,
}

/// A row of the query and a map point proposed for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MatchedPair {
    /// Row of the query.
    pub row: usize,
    /// The map point.
    pub point: PointId,
    /// Whether it agrees with the pose.
    pub agrees: bool,
}

/// A query matched with a map: what its pose is estimated from.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct MatchedQuery {
    /// What the robust estimator is given, `[N]` correspondences; a keypoint of it is a row of the query.
    pub problem: PoseProblem,
    /// The match each correspondence came from, `[N]`, rising.
    pub match_of: Vec<usize>,
    /// Row of the query of each match, a pair of a row and a map point.
    pub rows: Vec<usize>,
    /// The images that were matched, best first.
    pub retrieved: Vec<Retrieved>,
    /// Milliseconds of the retrieval.
    pub retrieve_ms: f64,
    /// Milliseconds of the matching.
    pub match_ms: f64,
}

/// What a query was matched with: the first half of localizing.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Matched {
    /// The images that were matched, best first.
    pub retrieved: Vec<Retrieved>,
    /// Rows of the query and the points proposed for them, sorted by both.
    pub matches: Vec<PointMatch>,
    /// Milliseconds of the retrieval.
    pub retrieve_ms: f64,
    /// Milliseconds of the matching.
    pub match_ms: f64,
}

/// Retrieves and matches in a map of which an image may be left out.
///
/// # Errors
/// [`LocalizeError`]: the query was sealed for another map, or the map is empty.
pub fn match_in(
    query: &SealedQuery,
    map: MapView<'_>,
    options: &LocalizeOptions,
) -> Result<Matched, LocalizeError> {
    map.file().profile().check(query).map_err(|source| LocalizeError::WrongProfile { source })?;
    if map.is_empty() {
        return Err(LocalizeError::EmptyMap);
    }
    let started = Instant::now();
    let retrieved = retrieve(query.global(), map, options.retrieve);
    let retrieved_at = Instant::now();
    let stop = &options.pose.stop;
    let matches = match_points_until(query.descriptors(), map, &retrieved, &options.matching, stop);
    if stop.is_set() {
        return Err(LocalizeError::Stopped);
    }
    let (retrieve_ms, match_ms) = (ms(started, retrieved_at), ms(retrieved_at, Instant::now()));
    Ok(Matched { retrieved, matches, retrieve_ms, match_ms })
}

/// Retrieves and matches, as [`localize`] does before it estimates the pose.
///
/// # Errors
/// [`LocalizeError`]: the query was sealed for another map, or the map is empty.
pub fn match_query(
    query: &SealedQuery,
    map: &MapFile,
    options: &LocalizeOptions,
) -> Result<MatchedQuery, LocalizeError> {
    Ok(problem_of(query, map.into(), match_in(query, map.into(), options)?, options))
}

/// What the pose of a query with these matches is estimated from.
fn problem_of(
    query: &SealedQuery,
    map: MapView<'_>,
    matched: Matched,
    options: &LocalizeOptions,
) -> MatchedQuery {
    let Matched { retrieved, matches, retrieve_ms, match_ms } = matched;
    let rows: Vec<usize> = matches.iter().map(|m| m.query).collect();
    let observed = observe_matches(&query.observations(), &rows);
    let of_match = |m: &usize| &matches[*m];
    let prior = query.descriptors().kind().match_prior();
    let points = observed.match_of.iter().map(|m| map.point(of_match(m).point)).collect();
    let mut problem = PoseProblem::new(query.camera(), observed.correspondences, observed.keypoints, points);
    problem.prior = options
        .use_prior
        .then(|| observed.match_of.iter().map(|m| prior_of(of_match(m), map, &prior)).collect());
    problem.seen_from = Some(observed.match_of.iter().map(|m| of_match(m).seen_from(map.file())).collect());
    problem.position = options.position;
    problem.gravity = gravity_of(query, map);
    problem.focal = match query.focal_known() {
        veiloc_protocol::FocalKnowledge::Calibrated => FocalKnowledge::Calibrated,
        veiloc_protocol::FocalKnowledge::Exif => FocalKnowledge::Exif,
        veiloc_protocol::FocalKnowledge::Unknown => FocalKnowledge::Unknown,
    };
    problem.point_covariances =
        Some(observed.match_of.iter().map(|m| map.point_covariance(of_match(m).point)).collect());
    MatchedQuery { problem, match_of: observed.match_of, rows, retrieved, retrieve_ms, match_ms }
}

/// Which way is down in the camera and in the map, where the query says the one and the map knows the other.
fn gravity_of(query: &SealedQuery, map: MapView<'_>) -> Option<Gravity> {
    let (told, down) = (query.gravity()?, map.file().down()?);
    // What the sensor errs by, and what the rounding adds to it.
    let sd_deg = told.sd_deg().hypot(CoarseGravity::ROUNDING_SD_DEG);
    Some(Gravity { in_camera: told.in_camera().into(), in_world: down.in_world().into(), sd_deg })
}

/// Estimates where a sealed query was taken.
///
/// Whoever gives up on it sets `options.pose.stop`: then it ends soon, and without a pose.
///
/// # Errors
/// [`LocalizeError`]: the query was sealed for another map, the map is empty, no pose is supported by the matches, or it was
/// stopped.
pub fn localize(
    query: &SealedQuery,
    map: &MapFile,
    options: &LocalizeOptions,
) -> Result<Localization, LocalizeError> {
    localize_matched(query, map.into(), match_in(query, map.into(), options)?, options)
}

/// Estimates the pose of a query that was matched with this map.
///
/// # Errors
/// [`LocalizeError::NoPose`]: no pose is supported by the matches.
///
/// # Panics
/// When a match is of a row that the query does not have.
pub fn localize_matched(
    query: &SealedQuery,
    map: MapView<'_>,
    matched: Matched,
    options: &LocalizeOptions,
) -> Result<Localization, LocalizeError> {
    let matched_at = Instant::now();
    let points: Vec<PointId> = matched.matches.iter().map(|m| m.point).collect();
    let MatchedQuery { problem, match_of, rows, retrieved, retrieve_ms, match_ms } =
        problem_of(query, map, matched, options);
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let estimate = estimate_pose(&problem, &options.pose, &mut rng)
        .map_err(|source| LocalizeError::of_pose(source, problem.points.len()))?;
    let own = Own {
        covariance: &estimate.covariance,
        by_matches: &estimate.covariance_by_matches,
        confidence: estimate.confidence,
    };
    let Verdict { covariance, confidence, state } =
        own.in_map(map.file(), query.scheme(), problem.points.len())?;
    let agreeing = match_of.iter().zip(&estimate.inliers).filter_map(|(m, agrees)| agrees.then_some(*m));
    let agreeing: BTreeSet<usize> = agreeing.collect();
    let pairs = rows.iter().zip(points).enumerate();
    let matched =
        pairs.map(|(m, (row, point))| MatchedPair { row: *row, point, agrees: agreeing.contains(&m) });
    Ok(Localization {
        cam_from_world: estimate.cam_from_world,
        covariance,
        own_covariance: estimate.covariance,
        confidence,
        gravity: match query.gravity() {
            None => GravityUse::NotTold,
            Some(_) if problem.gravity.is_some() => GravityUse::Used,
            Some(_) => GravityUse::MapDoesNotKnow,
        },
        state,
        noise_px: estimate.noise_px,
        focal_scale: estimate.focal_scale,
        inliers: estimate.inlier_keypoints,
        pairs: rows.len(),
        matched: matched.collect(),
        matches: distinct(rows.iter().copied()),
        inlier_pairs: agreeing.len(),
        hypotheses: estimate.hypotheses,
        retrieved,
        times: StageTimes { retrieve_ms, match_ms, pose_ms: ms(matched_at, Instant::now()) },
    })
}

fn ms(from: Instant, to: Instant) -> f64 {
    to.duration_since(from).as_secs_f64() * 1e3
}

/// How many different numbers there are.
pub(crate) fn distinct(numbers: impl Iterator<Item = usize>) -> usize {
    numbers.collect::<BTreeSet<_>>().len()
}

/// Probability that a match is right, before geometry is asked.
fn prior_of(m: &PointMatch, map: MapView<'_>, prior: &MatchPrior) -> f64 {
    let track_length = u32::try_from(map.seen_by(m.point)).ok();
    match_probability(prior, &Evidence { ratio: f64::from(m.ratio), votes: Some(m.votes), track_length })
}
