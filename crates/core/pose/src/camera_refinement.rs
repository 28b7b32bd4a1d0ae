//! The camera of a pose: the given one, or another that the matches make likelier.
//!
//! It is tested after the focal length ([`crate::focal_search`]). A wrong principal point, as in a cropped image, and
//! pixels that are not square move the pose, but the residuals hardly grow: a shift of the principal point resembles a
//! rotation. Many matches can distinguish both, because a rotation also changes the perspective.

use crate::likelihood::{
    CameraChange, CameraEvidence, CameraObjective, CameraVerdict, FocalPrior, FocalVerdict, MapCameras,
    Matches, PoseWithCamera, Symmetric6,
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
    /// Whether the matches contradict the camera, and no other one was estimated.
    pub(crate) is_contradicted: bool,
    /// What the matches say about the given camera, if asked for.
    pub(crate) evidence: Option<CameraEvidence>,
}

/// How the camera is tested.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CameraTest {
    /// How well the camera is known.
    pub(crate) known: FocalPrior,
    /// Errors of the map's own cameras.
    pub(crate) map: MapCameras,
    /// Whether to return the evidence.
    pub(crate) with_evidence: bool,
    /// Whether the noise is estimated with the pose.
    pub(crate) estimate_noise: bool,
}

impl<'a> CameraRefinement<'a> {
    /// Tests the camera of a refined pose. `seen` are the correspondences that the pose can see, with the given camera;
    /// `factor` is the focal length relative to it. Under MSAC, the paper's recipe, nothing is tested.
    pub(crate) fn new(
        mut search: Search<'a>,
        seen: &Matches<'a>,
        mut polished: Polished,
        factor: f64,
        mut focal: FocalVerdict,
        test: &CameraTest,
    ) -> Self {
        let mut at = PoseWithCamera { pose: polished.pose, change: CameraChange::of_focal(factor) };
        if !search.is_likelihood() {
            let covariance = [[0.0; 6]; 6];
            let change = at.change;
            return Self {
                search,
                polished,
                change,
                covariance,
                focal,
                is_contradicted: false,
                evidence: None,
            };
        }
        let objective = Self::objective(&search, seen, &polished, test);
        let look = objective.look(&at);
        let evidence = if test.with_evidence { objective.evidence(&look) } else { None };
        let verdict = objective.test(&look);
        let covariance = match &verdict {
            CameraVerdict::Other(other) => {
                at.change = other.change.without_bending();
                search.fix_visible(seen.with_camera(at.change.pinhole(&seen.camera)));
                polished = search.polish(&other.pose, test.estimate_noise);
                at.pose = polished.pose;
                // The focal length was refined with the rest of the camera.
                focal = FocalVerdict::Fine;
                Self::objective(&search, seen, &polished, test).covariance_of_estimated(&at)
            }
            CameraVerdict::Fine | CameraVerdict::Contradicted => objective.covariance(&look),
        };
        let is_contradicted = verdict == CameraVerdict::Contradicted;
        Self { search, polished, change: at.change, covariance, focal, is_contradicted, evidence }
    }

    fn objective<'s>(
        search: &'s Search<'a>,
        seen: &'s Matches<'a>,
        polished: &Polished,
        test: &CameraTest,
    ) -> CameraObjective<'s> {
        CameraObjective {
            matches: seen,
            priors: search.priors(),
            active: search.possible(&polished.pose, polished.noise),
            noise: polished.noise,
            map: test.map,
            known: test.known,
        }
    }
}
