//! Placement of a session's layout in the next frame: rotated from the previous frames, or placed anew.

use veiloc_features::{Features, Keypoint};
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{Anchor, Intrinsics};
use veiloc_protocol::{CanonicalCamera, LayoutTurn, MIN_PER_SIDE, Scheme};

use super::align::{estimate_rotation, refine_rotation};
use super::memory::LandmarkMatches;
use super::{Orientation, Session, SessionAnchors, Start};
use crate::schemes::dcl::pencils;
use crate::{Extracted, SealError};

/// Decisions made before a frame is sealed.
pub(super) struct LayoutPlacement {
    pub(super) turn: LayoutTurn,
    /// The camera in which anchors have their positions.
    pub(super) camera: CanonicalCamera,
    pub(super) start: Option<Start>,
    pub(super) starts: u32,
    /// By feature, its direction in the camera.
    pub(super) seen: Vec<Option<Vector3<f64>>>,
    pub(super) matched: LandmarkMatches,
    /// Whether nearly all keypoints would belong to one anchor, and the layout was placed anew.
    pub(super) turned_away: bool,
    /// By feature, whether it is dropped because an earlier start sent it; empty where no feature is.
    pub(super) dropped: Vec<bool>,
}

/// Rotation of the layout relative to the camera of the next frame, and the state of the session after it.
pub(super) fn place_layout(
    session: &Session,
    extracted: &Extracted,
    scheme: Scheme,
) -> Result<LayoutPlacement, SealError> {
    let Extracted { features, camera, orientation, .. } = extracted;
    let camera = &camera.intrinsics;
    let canonical = CanonicalCamera::for_intrinsics(camera)?;
    let descriptors = &features.descriptors;
    if session.memory.descriptors.as_ref().is_some_and(|known| known.kind() != descriptors.kind()) {
        return Err(SealError::SessionChanged { what: "descriptor kind" });
    }
    let direction = |k: &Keypoint| camera.unproject(k.pixel).map(|p| p.bearing());
    let directions: Vec<Option<Vector3<f64>>> = features.keypoints.iter().map(direction).collect();
    let mut turned_away = false;
    if let Some((start, cam_from_layout, matched)) =
        continue_start(session, features, &directions, orientation)
    {
        if start.scheme != scheme {
            return Err(SealError::SessionChanged { what: "scheme or layout" });
        }
        if !start.camera.is_near(canonical) {
            return Err(SealError::SessionChanged { what: "camera" });
        }
        let turn = turn(&cam_from_layout)?;
        turned_away = session.options.memory && is_one_sided(features, camera, start.camera, scheme, turn);
        if !turned_away {
            let layout_from_world = start.layout_from_world.or(layout_from(turn, orientation));
            return Ok(LayoutPlacement {
                turn,
                camera: start.camera,
                start: Some(Start { layout_from_world, ..start }),
                starts: session.starts,
                seen: directions,
                dropped: session.memory.sent_before(descriptors, session.starts, &matched),
                matched,
                turned_away,
            });
        }
    }
    let (turn, start) = new_start(session, scheme, canonical, orientation)?;
    let remembers = session.options.memory && session.options.anchors != SessionAnchors::Image;
    let before =
        if remembers { session.memory.overlapping(descriptors, &directions) } else { session.starts };
    // When the camera turned away, keypoints that were sent before are dropped, so that their lines do not add up. A
    // retry after a step, without orientation, needs all keypoints to find its pose; the limit on starts exists for
    // this case.
    if let Some(most) = session.options.max_starts.filter(|most| before >= *most && !turned_away) {
        return Err(SealError::TooManyStarts { starts: before, most });
    }
    let starts = session.starts.saturating_add(1);
    let matched = session.memory.matched(descriptors, starts);
    Ok(LayoutPlacement {
        turn,
        camera: canonical,
        start,
        starts,
        seen: directions,
        dropped: if turned_away {
            session.memory.sent_before(descriptors, starts, &matched)
        } else {
            Vec::new()
        },
        matched,
        turned_away,
    })
}

/// The rotation from the layout to the camera, when the frame can belong to the current start.
fn continue_start(
    session: &Session,
    features: &Features,
    directions: &[Option<Vector3<f64>>],
    orientation: &Orientation,
) -> Option<(Start, Rotation3<f64>, LandmarkMatches)> {
    let start = session.start?;
    let matched = session.memory.matched(&features.descriptors, session.starts);
    let pairs = session.memory.pairs(&matched, directions);
    let measured = orientation.cam_from_world().zip(start.layout_from_world).map(|(c, l)| c * l.inverse());
    let limit = session.options.max_correction_deg.to_radians();
    let cam_from_layout = match measured {
        Some(measured) => refine_rotation(&pairs, measured, limit),
        None => estimate_rotation(&pairs)?,
    };
    Some((start, cam_from_layout, matched))
}

/// A layout placed at the camera of this frame.
fn new_start(
    session: &Session,
    scheme: Scheme,
    camera: CanonicalCamera,
    orientation: &Orientation,
) -> Result<(LayoutTurn, Option<Start>), SealError> {
    let is_dcl = matches!(scheme, Scheme::Dcl(_));
    let cam_from_layout = match session.options.anchors {
        SessionAnchors::Image => Rotation3::identity(),
        SessionAnchors::World | SessionAnchors::Gravity if !is_dcl => {
            return Err(SealError::SessionScheme { scheme: scheme.name() });
        }
        SessionAnchors::World => Rotation3::identity(),
        SessionAnchors::Gravity => orientation.levelled().ok_or(SealError::NoGravity)?,
    };
    let turn = turn(&cam_from_layout)?;
    let stays = session.options.anchors != SessionAnchors::Image;
    // If a start is neither located in the world nor remembered, no later frame can share it.
    let shared = stays && (orientation.cam_from_world().is_some() || session.options.memory);
    let layout_from_world = layout_from(turn, orientation);
    Ok((turn, shared.then_some(Start { scheme, camera, layout_from_world })))
}

/// The layout's rotation in the world, from the rounded rotation that is sent, so that later frames use the same.
fn layout_from(turn: LayoutTurn, orientation: &Orientation) -> Option<Rotation3<f64>> {
    orientation.cam_from_world().map(|cam_from_world| turn.cam_from_layout().inverse() * cam_from_world)
}

fn turn(cam_from_layout: &Rotation3<f64>) -> Result<LayoutTurn, SealError> {
    LayoutTurn::new(cam_from_layout).ok_or(SealError::NoOrientation)
}

/// Whether nearly all keypoints belong to one anchor, so that the pose is not determined.
fn is_one_sided(
    features: &Features,
    camera: &Intrinsics,
    canonical: CanonicalCamera,
    scheme: Scheme,
    turn: LayoutTurn,
) -> bool {
    let Scheme::Dcl(layout) = scheme else { return false };
    let pinhole = canonical.pinhole();
    let pencils = pencils(layout, &pinhole, turn);
    let mut counts = [0; Anchor::MAX_COUNT];
    for keypoint in &features.keypoints {
        if let Some(p) = camera.unproject(keypoint.pixel) {
            counts[pencils.anchor_of(pinhole.project(p)).index()] += 1;
        }
    }
    let all: usize = counts.iter().sum();
    let others = all - counts.iter().copied().max().unwrap_or(0);
    // Only the strongest are sent, possibly fewer than these.
    others < MIN_PER_SIDE.max(all / 16)
}
