//! The camera of a pose: the given one, or another that the matches make likelier.
//!
//! It is tested after the focal length ([`crate::focal_search`]). A wrong principal point, as in a cropped image, and
//! pixels that are not square move the pose, but the residuals hardly grow: a shift of the principal point resembles a
//! rotation. Many matches can distinguish both, because a rotation also changes the perspective.

use crate::likelihood::{
    CameraChange, CameraObjective, FocalPrior, FocalVerdict, Matches, PoseWithCamera, Symmetric6,
};
use crate::ransac::search::{Polished, Search};

/// A refined pose with its camera.
pub(crate) struct CameraRefinement<'a> {
    /// The search over the correspondences with that camera.
    pub(crate) search: Search<'a>,
    pub(crate) polished: Polished,
    /// The camera relative to the given one.
    pub(crate) change: CameraChange,
    /// What the camera model adds to the covariance of the pose.
    pub(crate) covariance: Symmetric6,
    /// The verdict on the given focal length: as before, unless another camera was estimated.
    pub(crate) focal: FocalVerdict,
}

impl<'a> CameraRefinement<'a> {
    /// Tests the camera of a refined pose. `seen` are the correspondences that the pose can see, with the given camera;
    /// `factor` is the focal length relative to it. Under MSAC, the paper's recipe, nothing is tested.
    pub(crate) fn new(
        mut search: Search<'a>,
        seen: &Matches<'a>,
        mut polished: Polished,
        factor: f64,
        known: FocalPrior,
        mut focal: FocalVerdict,
        estimate_noise: bool,
    ) -> Self {
        let mut at = PoseWithCamera { pose: polished.pose, change: CameraChange::of_focal(factor) };
        if !search.is_likelihood() {
            let covariance = [[0.0; 6]; 6];
            return Self { search, polished, change: at.change, covariance, focal };
        }
        let better = Self::objective(&search, seen, &polished, known).better_camera(&at);
        if let Some(other) = &better {
            at.change = other.change.without_bending();
            search.fix_visible(seen.with_camera(at.change.pinhole(&seen.camera)));
            polished = search.polish(&other.pose, estimate_noise);
            at.pose = polished.pose;
            // The focal length was refined with the rest of the camera.
            focal = FocalVerdict::Fine;
        }
        let objective = Self::objective(&search, seen, &polished, known);
        let covariance =
            if better.is_some() { objective.covariance_of_estimated(&at) } else { objective.covariance(&at) };
        Self { search, polished, change: at.change, covariance, focal }
    }

    fn objective<'s>(
        search: &'s Search<'a>,
        seen: &'s Matches<'a>,
        polished: &Polished,
        known: FocalPrior,
    ) -> CameraObjective<'s> {
        CameraObjective {
            matches: seen,
            priors: search.priors(),
            active: search.possible(&polished.pose, polished.noise),
            noise: polished.noise,
            known,
            with_focal: known == FocalPrior::Calibrated,
        }
    }
}
