//! The pipeline from a sealed query to a pose, with the duration of each stage.

use std::collections::BTreeSet;
use std::time::Instant;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_descriptor::{MatchEvidence, MatchOptions, MatchPrior, RETRIEVED_IMAGES, match_probability};
use veiloc_geometry::CameraFromWorld;
use veiloc_map::{CameraErrors, MapFile, MapView, PackPoints, PointId};
use veiloc_pose::likelihood::{CameraEvidence, MapCameras};
use veiloc_pose::{
    Confidence, FocalPrior, Gravity, PoseOptions, PoseProblem, PositionPrior, Precision, Rival, State,
    estimate_pose,
};
use veiloc_protocol::{CoarseGravity, GravityUse, PackId, QueryContent, QueryError, RowMatches, SealedQuery};

use crate::calibrated::{CalibratedEstimate, RawEstimate};
use crate::correspondences::observe_matches;
use crate::error::LocalizeError;
use crate::matching::{PairEvidence, PointMatch, match_points_until, matches_of_device};
use crate::retrieval::{RetrievedImage, given_images, retrieve_with_other_places};

/// Options of localization.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct LocalizeOptions {
    /// Number of retrieved images, without up to three of other places that look like them
    /// ([`crate::retrieval::retrieve_with_other_places`]). Default: [`RETRIEVED_IMAGES`], as devices with a pack.
    pub retrieve: usize,
    /// Map images to match with, best first, as another program retrieved them: in place of retrieval by global
    /// descriptors. Images that the map does not have are left out. Default: `None`.
    pub retrieved: Option<Vec<usize>>,
    /// Descriptor matching: mutual check on, no ratio test, as in the paper.
    pub matching: MatchOptions,
    /// Whether matches have a prior from their descriptor ratio, the votes of retrieved images and the track length
    /// of the point, for sampling and in the likelihood. If off, all matches are equal, as in the paper.
    pub use_prior: bool,
    /// Robust estimation.
    pub pose: PoseOptions,
    /// Prior of the camera position, if known.
    pub position: Option<PositionPrior>,
    /// The precision that the caller needs. Default: any.
    pub need: Precision,
    /// Seed of the sampler: equal queries and seeds give equal poses.
    pub seed: u64,
}

impl Default for LocalizeOptions {
    fn default() -> Self {
        Self {
            retrieve: RETRIEVED_IMAGES,
            retrieved: None,
            matching: MatchOptions::default(),
            use_prior: true,
            pose: PoseOptions::default(),
            position: None,
            need: Precision::ANY,
            seed: 0,
        }
    }
}

/// Duration of each stage, milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StageTimes {
    /// Retrieval by global descriptors.
    pub retrieve_ms: f64,
    /// Matching with the retrieved images.
    pub match_ms: f64,
    /// Robust estimation with refinement.
    pub pose_ms: f64,
}

/// Result of localization.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Localization {
    /// The pose.
    pub cam_from_world: CameraFromWorld,
    /// Covariance of the pose in the chart of [`CameraFromWorld::perturbed`]: radians, then map units. Calibrated by
    /// the self-test of the map, or by [`veiloc_map::CovarianceCalibration::unmeasured`] without one.
    pub covariance: [[f64; 6]; 6],
    /// The covariance of the estimator in the same chart: from the noise of keypoints and map points, and from the
    /// camera model.
    pub own_covariance: [[f64; 6]; 6],
    /// The part of it that comes from the camera model.
    pub camera_covariance: [[f64; 6]; 6],
    /// What the matches say about the camera, if [`PoseOptions::camera_evidence`] asks for it.
    pub camera_evidence: Option<CameraEvidence>,
    /// Whether to trust the pose, with the doubts. Its standard deviations are those of [`Self::covariance`].
    pub confidence: Confidence,
    /// Another pose that the other matches support, if there is one.
    pub rival: Option<Rival>,
    /// Use of the gravity direction.
    pub gravity: GravityUse,
    /// Trusted or doubtful; never [`State::NotFound`], which is [`LocalizeError::NoPose`].
    pub state: State,
    /// Standard deviation of inlier residuals, pixels: across the line; for points along each axis.
    pub noise_px: f64,
    /// Estimated over given focal length; 1 if it was not estimated.
    pub focal_scale: f64,
    /// Estimated principal point relative to the given one, pixels; 0 if it was not estimated.
    pub principal_shift_px: [f64; 2],
    /// Inlier rows of the query: those with an inlier pair.
    pub inliers: usize,
    /// Matched rows of the query, to one or more map points.
    pub matches: usize,
    /// Inlier pairs of a row and a map point.
    pub inlier_pairs: usize,
    /// Pairs of a row and a map point, from which the pose was estimated.
    pub pairs: usize,
    /// The pairs, `[pairs]`, sorted by row.
    pub matched: Vec<MatchedPair>,
    /// Number of hypotheses.
    pub hypotheses: usize,
    /// The retrieved images, best first.
    pub retrieved: Vec<RetrievedImage>,
    /// Duration of each stage.
    pub times: StageTimes,
}

/// A proposed pair of a row of the query and a map point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MatchedPair {
    /// Row of the query.
    pub row: usize,
    /// The map point.
    pub point: PointId,
    /// Whether it is an inlier.
    pub agrees: bool,
}

/// A matched query: the input of pose estimation.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct MatchedQuery {
    /// Input of the robust estimator, `[N]` correspondences; its keypoints are rows of the query.
    pub problem: PoseProblem,
    /// Match of each correspondence, `[N]`, ascending.
    pub match_of: Vec<usize>,
    /// Row of the query of each match.
    pub rows: Vec<usize>,
    /// The retrieved images, best first.
    pub retrieved: Vec<RetrievedImage>,
    /// Duration of the retrieval, milliseconds.
    pub retrieve_ms: f64,
    /// Duration of the matching, milliseconds.
    pub match_ms: f64,
}

/// Result of retrieval and matching.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct MatchResult {
    /// The retrieved images, best first.
    pub retrieved: Vec<RetrievedImage>,
    /// Proposed pairs of rows and points, sorted by both.
    pub matches: Vec<PointMatch>,
    /// Duration of the retrieval, milliseconds.
    pub retrieve_ms: f64,
    /// Duration of the matching, milliseconds.
    pub match_ms: f64,
}

/// Retrieves and matches in a map, from which an image may be left out.
///
/// # Errors
/// [`LocalizeError`]: the query was sealed for another map or pack, or the map is empty.
pub fn match_in(
    query: &SealedQuery,
    map: MapView<'_>,
    options: &LocalizeOptions,
) -> Result<MatchResult, LocalizeError> {
    map.file().profile().check(query).map_err(|source| LocalizeError::WrongProfile { source })?;
    if map.is_empty() {
        return Err(LocalizeError::EmptyMap);
    }
    let started = Instant::now();
    let stop = &options.pose.stop;
    let (matches, retrieved, retrieved_at) = match query.content() {
        QueryContent::Described { descriptors, global } => {
            let retrieved = match &options.retrieved {
                None => retrieve_with_other_places(global, map, options.retrieve),
                Some(images) => given_images(images, map),
            };
            let retrieved_at = Instant::now();
            let matches = match_points_until(descriptors.view(), map, &retrieved, &options.matching, stop);
            (matches, retrieved, retrieved_at)
        }
        QueryContent::Matched { pack, matches, .. } => {
            let points = check_pack(map.file(), *pack, matches)?;
            let (matches, retrieved) = matches_of_device(matches, points, map, options.retrieve);
            (matches, retrieved, started)
        }
    };
    if stop.is_set() {
        return Err(LocalizeError::Stopped);
    }
    let (retrieve_ms, match_ms) = (ms(started, retrieved_at), ms(retrieved_at, Instant::now()));
    Ok(MatchResult { retrieved, matches, retrieve_ms, match_ms })
}

/// The points of the map's pack, if a query was matched with this pack.
fn check_pack<'a>(
    map: &'a MapFile,
    pack: PackId,
    matches: &RowMatches,
) -> Result<&'a PackPoints, LocalizeError> {
    let wrong = |source| LocalizeError::WrongProfile { source };
    let points = map.pack_points().map_err(wrong)?;
    if points.id() != pack {
        return Err(wrong(QueryError::WrongPack { query: pack, map: points.id() }));
    }
    if points.len() != matches.points() as usize {
        let (expected, actual) = (points.len().to_string(), matches.points().to_string());
        return Err(wrong(QueryError::Mismatch { what: "points of the pack", expected, actual }));
    }
    Ok(points)
}

/// Retrieves and matches, as [`localize`] does before pose estimation.
///
/// # Errors
/// [`LocalizeError`]: the query was sealed for another map or pack, or the map is empty.
pub fn match_query(
    query: &SealedQuery,
    map: &MapFile,
    options: &LocalizeOptions,
) -> Result<MatchedQuery, LocalizeError> {
    Ok(problem_of(query, map.into(), match_in(query, map.into(), options)?, options))
}

/// The input of pose estimation for these matches.
fn problem_of(
    query: &SealedQuery,
    map: MapView<'_>,
    matched: MatchResult,
    options: &LocalizeOptions,
) -> MatchedQuery {
    let MatchResult { retrieved, matches, retrieve_ms, match_ms } = matched;
    let rows: Vec<usize> = matches.iter().map(|m| m.query).collect();
    let observed = observe_matches(&query.observations(), &rows);
    let of_match = |m: &usize| &matches[*m];
    let prior = query.descriptor_kind().match_prior();
    let points = observed.match_of.iter().map(|m| map.point(of_match(m).point)).collect();
    let mut problem = PoseProblem::new(query.camera(), observed.correspondences, observed.keypoints, points);
    problem.prior = options
        .use_prior
        .then(|| observed.match_of.iter().map(|m| prior_of(of_match(m), map, &prior)).collect());
    problem.seen_from = Some(observed.match_of.iter().map(|m| of_match(m).viewpoint(map.file())).collect());
    problem.position = options.position;
    problem.gravity = gravity_of(query, map);
    problem.focal = match query.focal_known() {
        veiloc_protocol::FocalKnowledge::Calibrated => FocalPrior::Calibrated,
        veiloc_protocol::FocalKnowledge::Exif => FocalPrior::Exif,
        veiloc_protocol::FocalKnowledge::Unknown => FocalPrior::Unknown,
    };
    problem.map_cameras = map.file().self_test().and_then(|test| test.of_scheme(query.scheme())).map_or(
        MapCameras::UNMEASURED,
        |test| {
            let CameraErrors { sd, min_log_odds, min_focal_gain } = test.cameras;
            MapCameras { sd, min_log_odds, min_focal_gain }
        },
    );
    problem.point_covariances =
        Some(observed.match_of.iter().map(|m| map.point_covariance(of_match(m).point)).collect());
    MatchedQuery { problem, match_of: observed.match_of, rows, retrieved, retrieve_ms, match_ms }
}

/// The gravity direction in the camera and in the map, if the query has the first and the map the second.
fn gravity_of(query: &SealedQuery, map: MapView<'_>) -> Option<Gravity> {
    let (measured, down) = (query.gravity()?, map.file().down()?);
    // Error of the sensor, plus that of the rounding.
    let sd_deg = measured.sd_deg().hypot(CoarseGravity::ROUNDING_SD_DEG);
    Some(Gravity { in_camera: measured.in_camera().into(), in_world: down.in_world().into(), sd_deg })
}

/// Use of the gravity of the queries of an image or of a rig.
pub(crate) fn gravity_use<'a>(
    queries: impl IntoIterator<Item = &'a SealedQuery>,
    map: &MapFile,
) -> GravityUse {
    let is_provided = queries.into_iter().any(|query| query.gravity().is_some());
    match (is_provided, map.down()) {
        (false, _) => GravityUse::NotProvided,
        (true, Some(_)) => GravityUse::Used,
        (true, None) => GravityUse::UnknownInMap,
    }
}

/// Localizes a sealed query.
///
/// A caller cancels it by `options.pose.stop`: then it ends soon without a pose.
///
/// # Errors
/// [`LocalizeError`]: the query was sealed for another map, the map is empty, the matches support no pose, or it was
/// cancelled.
pub fn localize(
    query: &SealedQuery,
    map: &MapFile,
    options: &LocalizeOptions,
) -> Result<Localization, LocalizeError> {
    localize_matched(query, map.into(), match_in(query, map.into(), options)?, options)
}

/// Estimates the pose of a query from its matches.
///
/// # Errors
/// [`LocalizeError::NoPose`]: the matches support no pose.
///
/// # Panics
/// If a match has a row that is not in the query.
pub fn localize_matched(
    query: &SealedQuery,
    map: MapView<'_>,
    matched: MatchResult,
    options: &LocalizeOptions,
) -> Result<Localization, LocalizeError> {
    let matched_at = Instant::now();
    let points: Vec<PointId> = matched.matches.iter().map(|m| m.point).collect();
    let MatchedQuery { problem, match_of, rows, retrieved, retrieve_ms, match_ms } =
        problem_of(query, map, matched, options);
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let estimate = estimate_pose(&problem, &options.pose, &mut rng)
        .map_err(|source| LocalizeError::of_pose(source, problem.points.len()))?;
    let own = RawEstimate {
        covariance: &estimate.covariance,
        by_matches: &estimate.covariance_by_matches,
        camera: &estimate.camera_covariance,
        confidence: estimate.confidence,
        gravity_test: estimate.gravity_test,
    };
    let CalibratedEstimate { covariance, confidence, state } =
        own.calibrate(map.file(), query.scheme(), problem.points.len(), options.need)?;
    let agreeing = match_of.iter().zip(&estimate.inliers).filter_map(|(m, agrees)| agrees.then_some(*m));
    let agreeing: BTreeSet<usize> = agreeing.collect();
    let pairs = rows.iter().zip(points).enumerate();
    let matched =
        pairs.map(|(m, (row, point))| MatchedPair { row: *row, point, agrees: agreeing.contains(&m) });
    Ok(Localization {
        cam_from_world: estimate.cam_from_world,
        covariance,
        own_covariance: estimate.covariance,
        camera_covariance: estimate.camera_covariance,
        camera_evidence: estimate.camera_evidence,
        confidence,
        rival: estimate.rival,
        gravity: gravity_use([query], map.file()),
        state,
        noise_px: estimate.noise_px,
        focal_scale: estimate.focal_scale,
        principal_shift_px: estimate.principal_shift_px,
        inliers: estimate.inlier_keypoints,
        pairs: rows.len(),
        matched: matched.collect(),
        matches: count_distinct(rows.iter().copied()),
        inlier_pairs: agreeing.len(),
        hypotheses: estimate.hypotheses,
        retrieved,
        times: StageTimes { retrieve_ms, match_ms, pose_ms: ms(matched_at, Instant::now()) },
    })
}

fn ms(from: Instant, to: Instant) -> f64 {
    to.duration_since(from).as_secs_f64() * 1e3
}

/// Number of distinct values.
pub(crate) fn count_distinct(numbers: impl Iterator<Item = usize>) -> usize {
    numbers.collect::<BTreeSet<_>>().len()
}

/// Prior probability that a match is right, before geometry.
fn prior_of(m: &PointMatch, map: MapView<'_>, prior: &MatchPrior) -> f64 {
    match m.evidence {
        PairEvidence::Device(probability) => probability,
        PairEvidence::Descriptors { ratio, votes } => {
            let track_length = u32::try_from(map.seen_by(m.point)).ok();
            match_probability(
                prior,
                &MatchEvidence { ratio: f64::from(ratio), votes: Some(votes), track_length },
            )
        }
    }
}
