//! Content anchors that go with a map to another coordinate frame.

use veiloc_geometry::nalgebra::{Quaternion, UnitQuaternion, Vector3};
use veiloc_map::{AlignmentAccuracy, MapModel};
use veiloc_protocol::{AnchorPose, ContentAnchors};

use super::{
    AlignmentFault, KnownPosition, KnownPositions, accuracy_in_map, align_to_positions, faults_in_map,
};
use crate::calibration::run::scale;
use crate::coordinate_frames::{MAX_TESTED, Similarity3, similarity_between};
use crate::error::MappingError;
use crate::progress::Progress;

/// The similarity from the coordinate frame of anchors to that of a map.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct AnchorTransform {
    /// `x_map = s R x_anchors + t`.
    pub map_from_anchors: Similarity3,
    /// Images that agree on it.
    pub images: usize,
    /// How well it is known.
    pub accuracy: AlignmentAccuracy,
    /// What speaks against it.
    pub faults: Vec<AlignmentFault>,
}

/// Moves content anchors by a similarity: their positions as points, and their rotations. Lengths in their content stay.
///
/// # Errors
/// [`MappingError::Anchors`]: a position is out of bounds; then nothing changes.
pub fn carry_anchors(anchors: &mut ContentAnchors, new_from_map: &Similarity3) -> Result<(), MappingError> {
    let turn = UnitQuaternion::from_rotation_matrix(&new_from_map.rotation);
    Ok(anchors.transform(|AnchorPose { q: [w, x, y, z], t }| {
        let q = turn * UnitQuaternion::from_quaternion(Quaternion::new(*w, *x, *y, *z));
        AnchorPose { q: [q.w, q.i, q.j, q.k], t: new_from_map.transform(&Vector3::from(*t)).into() }
    })?)
}

/// Finds the transform by the camera centres of images that the map has in common with those recorded with the anchors.
///
/// # Errors
/// [`MappingError::Alignment`]: the common images are too few, or their centres determine no similarity.
pub fn anchors_by_images(anchors: &ContentAnchors, map: &MapModel) -> Result<AnchorTransform, MappingError> {
    let position = |image: &veiloc_protocol::FrameImage| {
        let known = map.images[map.image_index(&image.name)?].cam_from_world.center().coords;
        let in_map = image.cam_from_world.pose()?.center().coords;
        Some(KnownPosition { name: image.name.clone(), in_map, known, has_height: true, sd: 0.0 })
    };
    let positions = anchors.images().iter().filter_map(position).collect();
    let known = KnownPositions { positions, has_heights: true, ..KnownPositions::default() };
    let found = align_to_positions(&known, None)?;
    let images = found.used.iter().filter(|used| **used).count();
    Ok(judged(anchors, map, found.new_from_map, images, found.accuracy, found.faults))
}

/// Finds the transform by localizing images of the anchors' map in the map that replaces it.
///
/// # Errors
/// [`MappingError::Alignment`]: other descriptors, fewer than three localized images, or no similarity on which more than half of
/// them agree.
pub fn anchors_by_localizing(
    anchors: &ContentAnchors,
    old: &MapModel,
    map: &MapModel,
    progress: &dyn Progress,
) -> Result<AnchorTransform, MappingError> {
    let frame = similarity_between(old, map, MAX_TESTED, progress)?;
    let accuracy = accuracy_in_map(old, &frame, None);
    let faults = faults_in_map(old, &frame, map);
    Ok(judged(anchors, map, frame.map_from_given, frame.localized, accuracy, faults))
}

/// Adds what speaks against the transform at the anchors.
fn judged(
    anchors: &ContentAnchors,
    map: &MapModel,
    map_from_anchors: Similarity3,
    images: usize,
    accuracy: AlignmentAccuracy,
    mut faults: Vec<AlignmentFault>,
) -> AnchorTransform {
    let found = AnchorTransform { map_from_anchors, images, accuracy, faults: Vec::new() };
    let sds = anchors.anchors().iter().map(|anchor| found.position_sd(anchor.map_from_anchor.t));
    // The largest; NaN counts as such.
    let sd = sds.fold(0.0, |worst: f64, sd| if worst.is_nan() || sd <= worst { worst } else { sd });
    let scale = scale(map);
    let is_known = sd <= MAX_ANCHOR_SD * scale;
    if !is_known {
        faults.push(AlignmentFault::Anchor { sd, scale });
    }
    AnchorTransform { faults, ..found }
}

impl AnchorTransform {
    /// The ± of a place of the anchors' coordinate frame in the map: root mean square distance, map units.
    pub fn position_sd(&self, place: [f64; 3]) -> f64 {
        self.accuracy.at(self.map_from_anchors.transform(&place.into()).into()).0 * 3.0_f64.sqrt()
    }
}

/// The ± from which an anchor is not carried, of the typical distance of observed points; two maps whose frames are further apart
/// are not merged either.
const MAX_ANCHOR_SD: f64 = 0.02;
