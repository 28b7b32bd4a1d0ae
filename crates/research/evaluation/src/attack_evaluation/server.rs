//! The knowledge of a server that has localized the query: its pose, and the keypoints that matched the map.
//!
//! The pose is the server's own estimate from the attacked lines, not the true pose; the matches are those of
//! `problems.jsonl` for the same images. Inliers of a trusted pose become known positions: the projections of their
//! map points under this pose, including wrong inliers.

use std::collections::BTreeMap;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::{ErrorSummary, Observation};
use veiloc_features::load_mask;
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{CameraFromWorld, Pinhole, Pixel, PlanePoint, Point3};
use veiloc_mapping::mask_file;
use veiloc_obfuscation::obfuscate_points;
use veiloc_pose::{PoseOptions, estimate_pose};
use veiloc_protocol::{Observations, Scheme};
use veiloc_synthetic::problems::normal_pair;

use super::document::ServerSummary;
use super::inliers::{depth_limits, likeliest_by_row, projected_inliers};
use super::options::{AttackEvaluation, MeasuredKeypoints, PrivateRegion, ServerKnowledge};
use super::private_region::{masked, person, rotated};
use crate::EvalError;
use crate::pose::pose_problem;
use veiloc_datasets::problem_files::{KeypointImage, Problem, read_problems, seed_for};

/// Problems by image name.
pub(super) struct Server<'a> {
    knowledge: &'a ServerKnowledge,
    problems: BTreeMap<String, Problem>,
    /// What images of the map, or the other attacked images, saw of it.
    views: Vec<MapView>,
}

/// One image of the map.
struct MapView {
    name: String,
    cam_from_world: CameraFromWorld,
    points: Vec<Point3<World>>,
}

/// Images of the map that tell what should be seen.
const NEAR_VIEWS: usize = 6;
/// Cosine of the angle between their viewing directions and that of the query.
const MIN_COSINE: f64 = 0.7;
/// Reprojection error of a point that an image of the map saw, pixels.
const MAX_VIEW_ERROR_PX: f64 = 3.0;

impl<'a> Server<'a> {
    /// Reads the matches.
    pub(super) fn new(knowledge: &'a ServerKnowledge) -> Result<Self, EvalError> {
        let mut problems = BTreeMap::new();
        for file in &knowledge.problems {
            problems.extend(read_problems(file)?.into_iter().map(|p| (p.name.clone(), p)));
        }
        let mut views: Vec<MapView> = Vec::new();
        for file in &knowledge.map_problems {
            views.extend(read_problems(file)?.iter().map(MapView::of));
        }
        if knowledge.map_problems.is_empty() {
            views.extend(problems.values().map(MapView::of));
        }
        Ok(Self { knowledge, problems, views })
    }

    /// Map points that should be seen from this pose, because the nearest images that look into this direction saw
    /// them: projections into the image, without that of this name.
    fn expected(&self, name: &str, camera: &Pinhole, cam_from_world: &CameraFromWorld) -> Vec<Pixel> {
        let axis = |pose: &CameraFromWorld| pose.rotation().inverse() * Vector3::z();
        let looks_along =
            |view: &&MapView| axis(&view.cam_from_world).dot(&axis(cam_from_world)) > MIN_COSINE;
        let center = cam_from_world.center();
        let mut near: Vec<(f64, &MapView)> = self
            .views
            .iter()
            .filter(|view| view.name != name)
            .filter(looks_along)
            .map(|view| (view.cam_from_world.center().distance(&center), view))
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.name.cmp(&b.1.name)));
        let points = near.iter().take(NEAR_VIEWS).flat_map(|(_, view)| &view.points);
        let distinct: BTreeMap<[u64; 3], &Point3<World>> =
            points.map(|p| (<[f64; 3]>::from(p.coords).map(f64::to_bits), p)).collect();
        let project = |point: &&Point3<World>| {
            let plane = PlanePoint::from_camera_point(&cam_from_world.transform(point))?;
            let pixel = camera.project(plane);
            let inside = (0.0..f64::from(camera.width)).contains(&pixel.u)
                && (0.0..f64::from(camera.height)).contains(&pixel.v);
            inside.then_some(pixel)
        };
        distinct.values().filter_map(project).collect()
    }

    /// The server's view of one image. A missing pose is a result, not an error.
    pub(super) fn view(
        &self,
        evaluation: &AttackEvaluation,
        image: &KeypointImage,
        scheme: Scheme,
    ) -> Result<SentImage, EvalError> {
        let problem = self.problem_of(image)?;
        let rows = rows_of(problem, image, evaluation.place.is_some())?;
        let private = self.private_region(image, evaluation.seed)?;
        let mut rng = ChaCha8Rng::seed_from_u64(seed_for(evaluation.seed, &[&image.name, "turned regions"]));
        let size = [image.width, image.height];
        let rotated = rotated(&image.keypoints, size, self.knowledge.rotated, &mut rng);
        let in_map = |m: &usize| {
            let is_in_map =
                |row: &usize| private.as_ref().is_none_or(|inside| !inside[*row]) && !rotated[*row];
            rows[*m].first().is_some_and(is_in_map)
        };
        let selected: Vec<usize> = (0..rows.len()).filter(in_map).collect();
        let matched = restricted_to(problem, &selected, &rows);

        let mut view = SentImage::of(evaluation, image, scheme)?;
        self.localize(&matched, &rows, &mut view, &mut evaluation.rng(&image.name, scheme, "pose"));
        self.measure(private, &rotated, &mut view);
        Ok(view)
    }

    /// The matches of an image.
    fn problem_of(&self, image: &KeypointImage) -> Result<&Problem, EvalError> {
        let name = &image.name;
        let problem = self.problems.get(name).ok_or_else(|| EvalError::NoMatches { image: name.clone() })?;
        let (size, expected) = ([problem.camera.width, problem.camera.height], [image.width, image.height]);
        if size == expected {
            Ok(problem)
        } else {
            Err(EvalError::OtherSize { image: name.clone(), size, expected })
        }
    }

    /// Keypoints of the private region, `[N]`, if there is one.
    fn private_region(&self, image: &KeypointImage, seed: u64) -> Result<Option<Vec<bool>>, EvalError> {
        Ok(match &self.knowledge.private {
            None => None,
            Some(PrivateRegion::Share(share)) => Some(person(&image.keypoints, *share, seed, &image.name)),
            Some(PrivateRegion::Masks(folder)) => {
                let mask = load_mask(&mask_file(folder, &image.name))?;
                Some(masked(&image.keypoints, [image.width, image.height], &mask)?)
            }
        })
    }

    /// Estimates the pose and projects its inliers. A pose that the server does not trust gives it no knowledge.
    ///
    /// `rows`: for each match of the image, before any was left out, its rows.
    fn localize(&self, matched: &Problem, rows: &[Vec<usize>], view: &mut SentImage, rng: &mut ChaCha8Rng) {
        let (input, match_of) = pose_problem(matched, &view.observed, true);
        let found = estimate_pose(&input, &PoseOptions::default(), rng).ok();
        let Some(found) = found.filter(|found| found.confidence.is_trusted()) else { return };
        let inliers = projected_inliers(&input, &found, |i| matched.keypoint_of_match[match_of[i]]);
        let best = likeliest_by_row(&inliers);
        // Rows with equal positions have equal lines, and the server can see that.
        for rows in rows {
            let Some((at, _)) = rows.first().and_then(|row| best.get(row)) else { continue };
            for &row in rows {
                view.observations[row] = Observation::Known(*at);
                view.known[row] = Some(*at);
            }
        }
        view.pose = depth_limits(inliers.iter().map(|inlier| inlier.depth)).map(|depths| PosedView {
            expected: self.expected(&matched.name, &input.camera, &found.cam_from_world),
            camera: input.camera,
            cam_from_world: found.cam_from_world,
            depths,
            known: inliers.iter().map(|inlier| (inlier.pixel, inlier.depth)).collect(),
        });
    }

    /// Selects the keypoints on which errors are measured.
    fn measure(&self, private: Option<Vec<bool>>, rotated: &[bool], view: &mut SentImage) {
        let measured: Vec<bool> = match (private, self.knowledge.measured) {
            (Some(inside), _) => inside,
            (None, MeasuredKeypoints::Hidden) => view.known.iter().map(Option::is_none).collect(),
            (None, MeasuredKeypoints::All) => vec![true; view.known.len()],
            (None, MeasuredKeypoints::Matched) => {
                view.observations.clone_from(&view.lines);
                // A known point would reveal the depth of its own keypoint.
                if let Some(pose) = &mut view.pose {
                    pose.known.clear();
                }
                view.known.iter().map(Option::is_some).collect()
            }
        };
        let of = |rotated_too: bool| measured.iter().zip(rotated).map(move |(m, t)| *m && *t == rotated_too);
        (view.ignored, view.measured) = (of(true).collect(), of(false).collect());
    }
}

impl MapView {
    /// The points that the image saw: matches that agree with its pose.
    fn of(problem: &Problem) -> Self {
        let agrees = |(keypoint, point): (&usize, &Point3<World>)| {
            let seen = problem.cam_from_world.transform(point);
            let at = problem.camera.project(PlanePoint::from_camera_point(&seen)?);
            (at.distance(&problem.keypoints[*keypoint]) < MAX_VIEW_ERROR_PX).then_some(*point)
        };
        Self {
            name: problem.name.clone(),
            cam_from_world: problem.cam_from_world,
            points: problem.keypoint_of_match.iter().zip(&problem.points).filter_map(agrees).collect(),
        }
    }
}

/// One image as it was sent under one scheme, with what a server knows of it that has localized it. `[N]`: one entry per
/// row.
pub(super) struct SentImage {
    /// The sent observations.
    pub(super) observed: Observations,
    /// `[N]`: the same as an attacker reads them, nothing else.
    pub(super) lines: Vec<Observation>,
    /// `[N]`: the same, with the positions of inliers that are given to the attack.
    pub(super) observations: Vec<Observation>,
    /// `[N]`: the positions of the inliers, whether or not they are given to the attack.
    pub(super) known: Vec<Option<Pixel>>,
    /// `[N]`: whether the error of a keypoint is measured.
    pub(super) measured: Vec<bool>,
    /// `[N]`: private keypoints whose descriptors are rotated: they are neither measured nor counted as others.
    pub(super) ignored: Vec<bool>,
    /// The camera with its pose and depths, if a pose was found.
    pub(super) pose: Option<PosedView>,
}

pub(super) struct PosedView {
    pub(super) camera: Pinhole,
    pub(super) cam_from_world: CameraFromWorld,
    /// Least and greatest depth of the scene, map units.
    pub(super) depths: [f64; 2],
    /// Map points that the server sees: position in pixels, depth in map units.
    pub(super) known: Vec<(Pixel, f64)>,
    /// Map points that images near this one saw, projected: they should be seen.
    pub(super) expected: Vec<Pixel>,
}

impl SentImage {
    /// Seals an image. An attacker without a server knows no position, and errors are measured on all keypoints.
    pub(super) fn of(
        evaluation: &AttackEvaluation,
        image: &KeypointImage,
        scheme: Scheme,
    ) -> Result<Self, EvalError> {
        let mut rng = evaluation.rng(&image.name, scheme, "sent");
        let observed = obfuscated(evaluation, image, &image.keypoints, scheme, &mut rng)?;
        let (lines, n) = (Observation::of_sent(&observed), image.keypoints.len());
        Ok(Self {
            observed,
            observations: lines.clone(),
            lines,
            known: vec![None; n],
            measured: vec![true; n],
            ignored: vec![false; n],
            pose: None,
        })
    }
}

/// Another seal of the image, or another frame of a stationary camera: the same rows in the same order.
pub(super) fn reseal_image(
    evaluation: &AttackEvaluation,
    image: &KeypointImage,
    scheme: Scheme,
    number: usize,
) -> Result<Vec<Observation>, EvalError> {
    let mut rng = evaluation.rng(&image.name, scheme, &format!("sent again {number}"));
    // A keypoint that the noise moves out of the image is clamped to it.
    let inside = |x: f64, side: u32| x.clamp(1e-3, f64::from(side) - 1e-3);
    let seen: Vec<Pixel> = image
        .keypoints
        .iter()
        .map(|p| {
            let [du, dv] = normal_pair(&mut rng).map(|z| z * evaluation.static_noise_px);
            Pixel::new(inside(p.u + du, image.width), inside(p.v + dv, image.height))
        })
        .collect();
    Ok(Observation::of_sent(&obfuscated(evaluation, image, &seen, scheme, &mut rng)?))
}

fn obfuscated(
    evaluation: &AttackEvaluation,
    image: &KeypointImage,
    keypoints: &[Pixel],
    scheme: Scheme,
    rng: &mut ChaCha8Rng,
) -> Result<Observations, EvalError> {
    obfuscate_points(keypoints, image.width, image.height, &scheme, evaluation.angle_bits, rng)
        .map_err(|source| EvalError::Seal { name: image.name.clone(), source })
}

/// Keypoints of the two files whose coordinates differ by less than this are the same, pixels.
const SAME_PX: f64 = 0.005;

/// For each match the image's keypoints at its position (SIFT finds several orientations at one position), at least
/// one; none where only `some_are_sent` and its keypoint is not.
fn rows_of(
    problem: &Problem,
    image: &KeypointImage,
    some_are_sent: bool,
) -> Result<Vec<Vec<usize>>, EvalError> {
    // Cells twice as wide as the tolerance: equal keypoints lie in the same or in adjacent cells.
    let cell = |p: &Pixel| [p.u, p.v].map(|x| (x / (2.0 * SAME_PX)).floor() as i64);
    let mut cells: BTreeMap<[i64; 2], Vec<usize>> = BTreeMap::new();
    for (i, p) in image.keypoints.iter().enumerate() {
        cells.entry(cell(p)).or_default().push(i);
    }
    let at = |p: &Pixel| -> Vec<usize> {
        let [x, y] = cell(p);
        let around = (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| [x + dx, y + dy]));
        let near = around.filter_map(|c| cells.get(&c)).flatten().copied();
        let same = |i: &usize| {
            let q = image.keypoints[*i];
            (q.u - p.u).abs() < SAME_PX && (q.v - p.v).abs() < SAME_PX
        };
        let mut rows: Vec<usize> = near.filter(same).collect();
        rows.sort_unstable();
        rows
    };
    let of_keypoint: Vec<Vec<usize>> = problem.keypoints.iter().map(at).collect();
    if let Some(missing) = of_keypoint.iter().position(|rows| rows.is_empty() && !some_are_sent) {
        let [u, v] = [problem.keypoints[missing].u, problem.keypoints[missing].v];
        return Err(EvalError::NoSuchKeypoint { image: image.name.clone(), u, v });
    }
    Ok(problem.keypoint_of_match.iter().map(|k| of_keypoint[*k].clone()).collect())
}

/// The problem restricted to these matches, with the image's rows as keypoints.
fn restricted_to(problem: &Problem, selected: &[usize], rows: &[Vec<usize>]) -> Problem {
    fn pick<T: Copy>(all: &[T], selected: &[usize]) -> Vec<T> {
        selected.iter().map(|m| all[*m]).collect()
    }
    Problem {
        name: problem.name.clone(),
        camera: problem.camera,
        keypoints: problem.keypoints.clone(),
        keypoint_of_match: selected.iter().map(|m| rows[*m][0]).collect(),
        points: pick(&problem.points, selected),
        cam_from_world: problem.cam_from_world,
        features: problem.features.clone(),
        ratio: problem.ratio.as_ref().map(|r| pick(r, selected)),
        votes: problem.votes.as_ref().map(|v| pick(v, selected)),
        track_length: problem.track_length.as_ref().map(|t| pick(t, selected)),
        seen_from: problem.seen_from.as_ref().map(|s| pick(s, selected)),
        gravity: problem.gravity,
    }
}

/// The server's knowledge under one scheme, accumulated over images.
#[derive(Default)]
pub(super) struct ServerStatistics {
    images: usize,
    posed: usize,
    keypoints: usize,
    measured: usize,
    /// Errors of known positions, pixels.
    errors: Vec<f64>,
}

impl ServerStatistics {
    pub(super) fn add(&mut self, view: &SentImage, truth: &[Pixel]) {
        self.images += 1;
        self.posed += usize::from(view.pose.is_some());
        self.keypoints += truth.len();
        self.measured += view.measured.iter().filter(|m| **m).count();
        let errors = view.known.iter().zip(truth).filter_map(|(k, t)| k.map(|p| p.distance(t)));
        self.errors.extend(errors);
    }

    /// # Errors
    /// [`EvalError::NoPose`] when no pose was found for any image: the server knows nothing then.
    pub(super) fn summary(&self, scheme: Scheme) -> Result<ServerSummary, EvalError> {
        if self.posed == 0 {
            return Err(EvalError::NoPose { scheme: scheme.to_string(), images: self.images });
        }
        let errors = ErrorSummary::of(&self.errors);
        let share = |count: usize| count as f64 / self.keypoints.max(1) as f64;
        Ok(ServerSummary {
            scheme: scheme.to_string(),
            images: self.images,
            trusted: self.posed,
            known: share(self.errors.len()),
            known_median_px: errors.median_px,
            known_under_10px: errors.under_10px,
            known_under_30px: errors.under_30px,
            measured: share(self.measured),
        })
    }
}
