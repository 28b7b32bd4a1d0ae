//! One image as a server sees it that has localized it.

use veiloc_attacks::Observation;
use veiloc_geometry::{CameraFromWorld, Pinhole, Pixel};
use veiloc_protocol::Observations;

/// One image as the server sees it under one scheme.
pub(crate) struct View {
    /// What was sent.
    pub(crate) observed: Observations,
    /// `[N]`: the same as an attacker reads it, nothing else.
    pub(crate) sent: Vec<Observation>,
    /// `[N]`: the same with the positions of the inliers, as far as the attack is told them.
    pub(crate) observations: Vec<Observation>,
    /// `[N]`: the positions of the inliers, whether the attack is told them or not.
    pub(crate) known: Vec<Option<Pixel>>,
    /// `[N]`: whether the errors of a keypoint count.
    pub(crate) measured: Vec<bool>,
    /// The camera and its pose, where one was found, and what the map tells of depth.
    pub(crate) pose: Option<Posed>,
}

#[derive(Clone)]
pub(crate) struct Posed {
    pub(crate) camera: Pinhole,
    pub(crate) cam_from_world: CameraFromWorld,
    /// Least and greatest depth of the scene, map units.
    pub(crate) depths: [f64; 2],
    /// Where the server sees points of its map, pixels, and how deep they lie, map units.
    pub(crate) known: Vec<(Pixel, f64)>,
}
