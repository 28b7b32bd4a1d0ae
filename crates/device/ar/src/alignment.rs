//! The transform from the map to the AR world, from several answers.
//!
//! Each answer, with the pose of the camera in the AR world when it took the image, gives one transform:
//!
//! ```text
//! ar_from_map = ar_from_cam · cam_from_map
//! ```
//!
//! The last answers are compared with each other: two *agree* when their difference is within what their covariances
//! allow. The largest set that agrees with one answer of it is averaged, each transform weighted by the inverse of its
//! covariance. So a wrong answer moves nothing, wherever it comes, also the first one; and after a jump of the AR world
//! the new answers take over when they outweigh the old ones. Doubtful answers are compared, and never averaged.
//!
//! # Covariance
//! An answer's is the left tangent in the axes of the camera, `[w, v]`. That of the transform is the left tangent in
//! the axes of the AR world:
//!
//! ```text
//! w' = R w,   v' = R v + t × w'       (R, t) = ar_from_cam
//! ```
//!
//! To it come the errors that answers of one place share, which no number of answers averages out
//! ([`AlignmentOptions::position_floor`]), and the drift of the AR framework since the answer
//! ([`AlignmentOptions::drift`]).

use std::collections::VecDeque;

use veiloc_geometry::nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use veiloc_geometry::{CameraFromWorld, Rigid3, frames::World};
use veiloc_protocol::{Answer, AnswerPose, ContentAnchor, ContentAnchors};

use crate::distances::{self, DistanceRatio, Place};
use crate::unit::metres_per_unit;
use crate::{Accuracy, ArWorld, Axes, CameraFromAr, FrameworkPose};

/// How answers are compared and averaged.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct AlignmentOptions {
    /// Metres of a unit of the map. Default: as the answers state it.
    pub metres_per_unit: Option<f64>,
    /// Standard deviation of the position along each axis that answers of one place share, metres. Default 0.02.
    pub position_floor: f64,
    /// The same of the rotation about each axis, degrees. Default 0.2.
    pub rotation_floor_deg: f64,
    /// Standard deviation of the AR framework's position after a metre of path, metres. Default 0.01: what visual
    /// inertial odometry reaches.
    pub drift: f64,
    /// The same of its rotation, degrees. Default 0.05.
    pub rotation_drift_deg: f64,
    /// Answers that are compared. Default 24.
    pub answers: usize,
    /// After how many answers one counts half. Default 4: after a jump of the AR world, six answers take over.
    pub half_life: f64,
}

impl Default for AlignmentOptions {
    fn default() -> Self {
        Self {
            metres_per_unit: None,
            position_floor: 0.02,
            rotation_floor_deg: 0.2,
            drift: 0.01,
            rotation_drift_deg: 0.05,
            answers: 24,
            half_life: 4.0,
        }
    }
}

impl AlignmentOptions {
    /// These options with a unit of the map, in place of the one that the answers state.
    #[must_use]
    pub const fn with_metres_per_unit(mut self, metres: f64) -> Self {
        self.metres_per_unit = Some(metres);
        self
    }

    /// These options with other errors that answers share: metres and degrees.
    #[must_use]
    pub const fn with_floors(mut self, position: f64, rotation_deg: f64) -> Self {
        (self.position_floor, self.rotation_floor_deg) = (position, rotation_deg);
        self
    }

    /// These options with another drift of the AR framework per metre: metres and degrees.
    #[must_use]
    pub const fn with_drift(mut self, position: f64, rotation_deg: f64) -> Self {
        (self.drift, self.rotation_drift_deg) = (position, rotation_deg);
        self
    }
}

/// How far the transform is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum AlignmentState {
    /// No trusted answer came yet.
    Searching,
    /// One answer, or several of which no two agree: content may be shown, and may move.
    Tentative,
    /// At least two answers agree.
    Aligned,
}

impl AlignmentState {
    /// The name in text form.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Searching => "searching",
            Self::Tentative => "tentative",
            Self::Aligned => "aligned",
        }
    }
}

/// What an answer did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Update {
    /// It agrees with the transform, and is part of it.
    Used,
    /// It is trusted but contradicts the transform. It is remembered: if further answers agree with it, they take over.
    Contradicts,
    /// It is doubtful, and agrees with the transform. Nothing changed.
    DoubtfulAgrees,
    /// It is doubtful, and contradicts the transform, or there is none. Nothing changed.
    Doubtful,
    /// It has no pose, or one with a free direction. Nothing changed.
    NoPose,
    /// It does not state the unit of the map, and the options give none, or no number above 0. Nothing changed.
    UnknownUnit,
}

impl Update {
    /// The name in text form.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Used => "used",
            Self::Contradicts => "contradicts",
            Self::DoubtfulAgrees => "doubtful-agrees",
            Self::Doubtful => "doubtful",
            Self::NoPose => "no-pose",
            Self::UnknownUnit => "unknown-unit",
        }
    }
}

/// The transform from the map to the AR world.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Aligned {
    /// `x_ar = R x_map + t`, both in metres.
    pub ar_from_map: Rigid3<ArWorld, World>,
    /// Left tangent in the axes of the AR world: rotation (radians), then translation (metres), as of an answer's pose.
    pub covariance: [[f64; 6]; 6],
    /// Answers that it is the average of.
    pub used: usize,
    /// Trusted answers that contradict it, among those that are remembered.
    pub contradicting: usize,
}

/// A content anchor in the AR world.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct PlacedAnchor<'a> {
    /// The anchor.
    pub anchor: &'a ContentAnchor,
    /// Its pose, in the axes and units of the framework.
    pub world_from_anchor: FrameworkPose,
    /// Its distance from the camera, metres.
    pub distance: f64,
}

/// Answers of one AR session, and the transform that most of them agree on.
#[derive(Debug, Clone)]
pub struct Alignment {
    options: AlignmentOptions,
    answers: VecDeque<Measurement>,
    /// Path of the camera in the AR world, metres, by the poses that were given.
    path: f64,
    last: Option<Vector3<f64>>,
    aligned: Option<Aligned>,
    /// Metres of a unit of the map of these answers.
    metres_per_unit: f64,
}

/// One trusted answer.
#[derive(Debug, Clone)]
struct Measurement {
    ar_from_map: Rigid3<ArWorld, World>,
    /// Left tangent in the AR world, without drift.
    covariance: Matrix6<f64>,
    path: f64,
    place: Place,
    /// Part of the current transform.
    used: bool,
}

impl Default for Alignment {
    fn default() -> Self {
        Self::new(AlignmentOptions::default())
    }
}

impl Alignment {
    /// Without answers.
    pub const fn new(options: AlignmentOptions) -> Self {
        Self { options, answers: VecDeque::new(), path: 0.0, last: None, aligned: None, metres_per_unit: 1.0 }
    }

    /// Takes an answer to a frame, and the pose of the camera when it took that frame (not the pose now).
    pub fn add(&mut self, answer: &Answer, cam_from_ar: &CameraFromAr) -> Update {
        self.moved(cam_from_ar);
        let Some(pose) = &answer.pose else { return Update::NoPose };
        let Ok(metres) = metres_per_unit(answer, self.options.metres_per_unit) else {
            return Update::UnknownUnit;
        };
        let Some(measured) = self.measurement(pose, cam_from_ar, metres) else { return Update::NoPose };
        if !answer.trusted() {
            let agrees = |known: &Aligned| {
                let covariance = Matrix6::from_fn(|i, j| known.covariance[i][j]) + measured.covariance;
                is_within(&known.ar_from_map, &measured.ar_from_map, &covariance)
            };
            let agrees = self.aligned.as_ref().is_some_and(agrees);
            return if agrees { Update::DoubtfulAgrees } else { Update::Doubtful };
        }
        if metres != self.metres_per_unit {
            // Another map: what is known of the last one says nothing.
            self.answers.clear();
            (self.aligned, self.metres_per_unit) = (None, metres);
        }
        self.answers.push_back(measured);
        while self.answers.len() > self.options.answers.max(2) {
            self.answers.pop_front();
        }
        self.solve();
        if self.answers.back().is_some_and(|last| last.used) { Update::Used } else { Update::Contradicts }
    }

    /// Takes the pose of the camera between answers, for the length of its path. Without it, the path is that of the
    /// frames that were answered.
    pub fn moved(&mut self, cam_from_ar: &CameraFromAr) {
        let here = *cam_from_ar.inverse().translation();
        self.path += self.last.map_or(0.0, |last| (here - last).norm());
        self.last = Some(here);
    }

    /// Forgets all answers: for a new AR session, or when the framework says that it lost its world.
    pub fn reset(&mut self) {
        *self = Self::new(self.options);
    }

    /// The transform; `None` before the first trusted answer.
    pub const fn aligned(&self) -> Option<&Aligned> {
        self.aligned.as_ref()
    }

    /// How far the transform is known.
    pub fn state(&self) -> AlignmentState {
        match &self.aligned {
            None => AlignmentState::Searching,
            Some(aligned) if aligned.used < 2 => AlignmentState::Tentative,
            Some(_) => AlignmentState::Aligned,
        }
    }

    /// The pose in the framework's world of content whose place in the map is known: `world_from_anchor`.
    ///
    /// `map_from_anchor`: position in the map's units, rotation from the content's axes to the map's, right-handed.
    /// `None` before the first trusted answer, and for a rotation of zero.
    pub fn world_from_anchor(&self, axes: Axes, map_from_anchor: &FrameworkPose) -> Option<FrameworkPose> {
        let aligned = self.aligned.as_ref()?;
        let position = map_from_anchor.position.map(|c| c * self.metres_per_unit);
        let [x, y, z, w] = map_from_anchor.rotation;
        let map_from_anchor = Rigid3::<World, Anchor>::from_quaternion([w, x, y, z], position)?;
        Some(axes.object_pose(&aligned.ar_from_map.compose(&map_from_anchor)))
    }

    /// Content anchors of the map (`GET /v1/maps/{map}/anchors`) in the framework's world, the nearest to the camera first. Empty
    /// before the first trusted answer.
    pub fn place_anchors<'a>(
        &self,
        axes: Axes,
        anchors: &'a ContentAnchors,
        cam_from_ar: &CameraFromAr,
    ) -> Vec<PlacedAnchor<'a>> {
        let Some(camera) = self.cam_from_map(cam_from_ar).map(|camera| camera.center().coords) else {
            return Vec::new();
        };
        let placed = |(anchor, distance): (&'a ContentAnchor, f64)| {
            let [w, x, y, z] = anchor.map_from_anchor.q;
            let pose = FrameworkPose { position: anchor.map_from_anchor.t, rotation: [x, y, z, w] };
            let world_from_anchor = self.world_from_anchor(axes, &pose)?;
            Some(PlacedAnchor { anchor, world_from_anchor, distance: distance * self.metres_per_unit })
        };
        anchors.nearest(camera.into()).into_iter().filter_map(placed).collect()
    }

    /// The pose of the camera in the map, map units, by its pose in the AR world now: between answers, and smoother
    /// than a single one.
    pub fn cam_from_map(&self, cam_from_ar: &CameraFromAr) -> Option<CameraFromWorld> {
        let in_metres = cam_from_ar.compose(&self.aligned.as_ref()?.ar_from_map);
        let translation = in_metres.translation() / self.metres_per_unit;
        Some(CameraFromWorld::new(*in_metres.rotation(), translation))
    }

    /// How exactly a point of the AR world near this camera is known in the map.
    pub fn accuracy(&self, cam_from_ar: &CameraFromAr) -> Option<Accuracy> {
        let aligned = self.aligned.as_ref()?;
        let covariance = Matrix6::from_fn(|i, j| aligned.covariance[i][j]);
        // The tangent at the camera: v + w × t.
        let here = transport(&Matrix3::identity(), &-cam_from_ar.inverse().translation());
        Some(Accuracy::of_covariance(&(here * covariance * here.transpose())))
    }

    /// Distances between cameras by the answers, against those of the AR framework.
    pub fn distance_ratio(&self) -> Option<DistanceRatio> {
        let places: Vec<&Place> = self.answers.iter().map(|answer| &answer.place).collect();
        distances::ratio(&places, self.options.drift)
    }

    /// One answer as a transform; `None` when it leaves a direction free.
    fn measurement(&self, pose: &AnswerPose, cam_from_ar: &CameraFromAr, metres: f64) -> Option<Measurement> {
        let cam_from_map =
            CameraFromWorld::from_quaternion(pose.rotation, pose.translation.map(|t| t * metres))?;
        // Rotation in radians, translation in metres.
        let unit = |i: usize| if i < 3 { 1.0 } else { metres };
        let mut covariance = Matrix6::from_fn(|i, j| pose.covariance[i][j] * unit(i) * unit(j));
        if !covariance.iter().all(|c| c.is_finite()) {
            return None;
        }
        covariance += diagonal(self.options.rotation_floor_deg, self.options.position_floor);
        let ar_from_cam = cam_from_ar.inverse();
        let to_world = transport(ar_from_cam.rotation().matrix(), ar_from_cam.translation());
        Some(Measurement {
            ar_from_map: ar_from_cam.compose(&cam_from_map),
            covariance: to_world * covariance * to_world.transpose(),
            path: self.path,
            place: Place {
                in_map: cam_from_map.center().coords,
                in_ar: *ar_from_cam.translation(),
                sd: pose.position_sd() * metres,
                path: self.path,
            },
            used: false,
        })
    }

    /// Covariance of the drift along a path, about the place where the camera is now.
    fn drift(&self, path: f64) -> Matrix6<f64> {
        let here = transport(&Matrix3::identity(), &self.last.unwrap_or_default());
        let grown = diagonal(self.options.rotation_drift_deg * path, self.options.drift * path);
        here * grown * here.transpose()
    }

    /// Chooses the answers that agree, and averages them.
    fn solve(&mut self) {
        let count = self.answers.len();
        let agree = |i: usize, j: usize| {
            let (a, b) = (&self.answers[i], &self.answers[j]);
            let covariance = a.covariance + b.covariance + self.drift((a.path - b.path).abs());
            i == j || is_within(&a.ar_from_map, &b.ar_from_map, &covariance)
        };
        let weight = |i: usize| 0.5_f64.powf((count - 1 - i) as f64 / self.options.half_life.max(0.1));
        let total = |set: &[usize]| set.iter().map(|i| weight(*i)).sum::<f64>();
        let set_of = |i: usize| -> Vec<usize> { (0..count).filter(|j| agree(i, *j)).collect() };
        let sets = (0..count).map(set_of);
        let best = sets.max_by(|a, b| total(a).total_cmp(&total(b))).unwrap_or_default();
        let current: Vec<usize> = (0..count).filter(|i| self.answers[*i].used).collect();
        // Other answers take over only when several agree, and clearly outweigh those in use.
        let shares = best.iter().any(|i| current.contains(i));
        let takes_over =
            current.is_empty() || shares || (best.len() > 1 && total(&best) > SWITCH * total(&current));
        let set = if takes_over { best } else { current };
        let Some(pivot) = set.last() else { return };
        let Some(estimate) = self.average(&set, self.answers[*pivot].ar_from_map) else { return };
        for (i, answer) in self.answers.iter_mut().enumerate() {
            answer.used = set.contains(&i);
        }
        self.aligned = Some(estimate);
    }

    /// The average of the answers of a set, each weighted by the inverse of its covariance.
    fn average(&self, set: &[usize], start: Rigid3<ArWorld, World>) -> Option<Aligned> {
        let mut ar_from_map = start;
        let mut covariance = Matrix6::zeros();
        for _ in 0..ROUNDS {
            let (mut information, mut pull) = (Matrix6::zeros(), Vector6::zeros());
            for answer in set.iter().map(|i| &self.answers[*i]) {
                let own = answer.covariance + self.drift(self.path - answer.path);
                let inverse = own.cholesky()?.inverse();
                information += inverse;
                pull += inverse * Vector6::from(ar_from_map.step_to(&answer.ar_from_map));
            }
            let solved = information.cholesky()?;
            ar_from_map = ar_from_map.perturbed(&solved.solve(&pull).into());
            covariance = solved.inverse();
        }
        // What the answers share does not average out.
        let here = transport(&Matrix3::identity(), &self.last.unwrap_or_default());
        let floor = diagonal(self.options.rotation_floor_deg, self.options.position_floor);
        covariance += here * floor * here.transpose();
        Some(Aligned {
            ar_from_map,
            covariance: std::array::from_fn(|i| std::array::from_fn(|j| covariance[(i, j)])),
            used: set.len(),
            contradicting: self.answers.len() - set.len(),
        })
    }
}

/// The frame of content.
#[derive(Debug, Clone, Copy)]
enum Anchor {}

/// The quantile 0.999 of the squared Mahalanobis distance with six degrees of freedom.
const GATE: f64 = 22.46;
/// How many times the weight of the answers in use others must have to take over.
const SWITCH: f64 = 1.5;
/// Steps of the average, whose transforms are not a vector space.
const ROUNDS: usize = 3;

/// Whether two transforms differ by no more than the covariance of their difference allows.
fn is_within(a: &Rigid3<ArWorld, World>, b: &Rigid3<ArWorld, World>, covariance: &Matrix6<f64>) -> bool {
    let step = Vector6::from(a.step_to(b));
    // NaN is not within.
    covariance.cholesky().is_some_and(|c| step.dot(&c.solve(&step)) <= GATE)
}

/// The change of a left tangent `[w, v]` under `(R, t)`: `w' = R w`, `v' = R v + t × w'`.
fn transport(rotation: &Matrix3<f64>, translation: &Vector3<f64>) -> Matrix6<f64> {
    let mut change = Matrix6::zeros();
    change.fixed_view_mut::<3, 3>(0, 0).copy_from(rotation);
    change.fixed_view_mut::<3, 3>(3, 3).copy_from(rotation);
    change.fixed_view_mut::<3, 3>(3, 0).copy_from(&(translation.cross_matrix() * rotation));
    change
}

/// A covariance with equal standard deviations about and along all axes.
fn diagonal(rotation_deg: f64, position: f64) -> Matrix6<f64> {
    let (rotation, position) = (rotation_deg.to_radians().powi(2), position * position);
    Matrix6::from_diagonal(&Vector6::new(rotation, rotation, rotation, position, position, position))
}
