//! One image as a server sees it after localizing it.

use veiloc_attacks::Observation;
use veiloc_geometry::{CameraFromWorld, Pinhole, Pixel};
use veiloc_protocol::Observations;

/// One image as the server sees it under one scheme.
pub(crate) struct ServerView {
    /// The sent observations.
    pub(crate) observed: Observations,
    /// `[N]`: the same as an attacker reads them, nothing else.
    pub(crate) sent: Vec<Observation>,
    /// `[N]`: the same, with the positions of inliers that are given to the attack.
    pub(crate) observations: Vec<Observation>,
    /// `[N]`: the positions of the inliers, whether or not they are given to the attack.
    pub(crate) known: Vec<Option<Pixel>>,
    /// `[N]`: whether the error of a keypoint is measured.
    pub(crate) measured: Vec<bool>,
    /// `[N]`: private keypoints whose descriptors are turned: they are neither measured nor counted as others.
    pub(crate) ignored: Vec<bool>,
    /// The camera with its pose and depths, if a pose was found.
    pub(crate) pose: Option<PosedView>,
}

#[derive(Clone)]
pub(crate) struct PosedView {
    pub(crate) camera: Pinhole,
    pub(crate) cam_from_world: CameraFromWorld,
    /// Least and greatest depth of the scene, map units.
    pub(crate) depths: [f64; 2],
    /// Map points that the server sees: position in pixels, depth in map units.
    pub(crate) known: Vec<(Pixel, f64)>,
    /// Map points that images near this one saw, projected: they should be seen.
    pub(crate) expected: Vec<Pixel>,
}
