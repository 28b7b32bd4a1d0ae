//! Where the layout of a session is in the next frame: where it was, turned into the camera, or somewhere new.

use veiloc_features::{Features, Keypoint};
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{Anchor, Intrinsics};
use veiloc_protocol::{CanonicalCamera, LEAST_A_SIDE, LayoutTurn, Scheme};

use super::align::{refined, seen};
use super::memory::Matched;
use super::{Orientation, Session, SessionAnchors, Start};
use crate::schemes::dcl::pencils;
use crate::{SealError, SealOptions};

/// What is decided before a frame is sealed.
pub(super) struct Placed {
    pub(super) turn: LayoutTurn,
    pub(super) start: Option<Start>,
    pub(super) starts: u32,
    /// By feature, the direction in which the camera sees it.
    pub(super) seen: Vec<Option<Vector3<f64>>>,
    pub(super) matched: Matched,
    /// Whether the camera has turned so far that the layout told one direction only, and was put anew.
    pub(super) turned_away: bool,
    /// By feature, whether it is left out because an earlier start told it; empty where none is.
    pub(super) left_out: Vec<bool>,
}

/// How the layout is turned against the camera of the next frame, and where the session will stand with it.
pub(super) fn place(
    session: &Session,
    features: &Features,
    camera: &Intrinsics,
    options: &SealOptions,
    held: &Orientation,
) -> Result<Placed, SealError> {
    let (scheme, canonical) = (options.scheme(), CanonicalCamera::for_intrinsics(camera)?);
    let descriptors = &features.descriptors;
    if session.memory.descriptors.as_ref().is_some_and(|known| known.kind() != descriptors.kind()) {
        return Err(SealError::SessionChanged { what: "descriptor kind" });
    }
    let direction = |k: &Keypoint| camera.unproject(k.pixel).map(|p| p.bearing());
    let directions: Vec<Option<Vector3<f64>>> = features.keypoints.iter().map(direction).collect();
    let mut turned_away = false;
    if let Some((start, cam_from_layout, matched)) = goes_on(session, features, &directions, held) {
        if start.scheme != scheme {
            return Err(SealError::SessionChanged { what: "scheme or layout" });
        }
        if start.camera != canonical {
            return Err(SealError::SessionChanged { what: "camera" });
        }
        let turn = turn(&cam_from_layout)?;
        turned_away = session.options.memory && is_one_sided(features, camera, canonical, scheme, turn);
        if !turned_away {
            let layout_from_world = start.layout_from_world.or(layout_from(turn, held));
            return Ok(Placed {
                turn,
                start: Some(Start { layout_from_world, ..start }),
                starts: session.starts,
                seen: directions,
                left_out: session.memory.told_before(descriptors, session.starts, &matched),
                matched,
                turned_away,
            });
        }
    }
    let (turn, start) = anew(session, scheme, canonical, held)?;
    let remembers = session.options.memory && session.options.anchors != SessionAnchors::Image;
    let before = if remembers { session.memory.overlapping(descriptors) } else { session.starts };
    // What was told is left out where the camera turned away, so that nothing adds up. A retry after a step, without orientation,
    // needs all that is seen to find its pose: that is what the number of starts is limited for.
    if let Some(most) = session.options.most_starts.filter(|most| before >= *most && !turned_away) {
        return Err(SealError::TooManyStarts { starts: before, most });
    }
    let starts = session.starts.saturating_add(1);
    let matched = session.memory.matched(descriptors, starts);
    Ok(Placed {
        turn,
        start,
        starts,
        seen: directions,
        left_out: if turned_away {
            session.memory.told_before(descriptors, starts, &matched)
        } else {
            Vec::new()
        },
        matched,
        turned_away,
    })
}

/// The rotation from the layout to the camera, where the frame can be of the start that is.
fn goes_on(
    session: &Session,
    features: &Features,
    directions: &[Option<Vector3<f64>>],
    held: &Orientation,
) -> Option<(Start, Rotation3<f64>, Matched)> {
    let start = session.start?;
    let matched = session.memory.matched(&features.descriptors, session.starts);
    let pairs = session.memory.pairs(&matched, directions);
    let measured = held.cam_from_world().zip(start.layout_from_world).map(|(c, l)| c * l.inverse());
    let limit = session.options.most_correction_deg.to_radians();
    let cam_from_layout = match measured {
        Some(measured) => refined(&pairs, measured, limit),
        None => seen(&pairs)?,
    };
    Some((start, cam_from_layout, matched))
}

/// A layout put where the camera of this frame has it.
fn anew(
    session: &Session,
    scheme: Scheme,
    camera: CanonicalCamera,
    held: &Orientation,
) -> Result<(LayoutTurn, Option<Start>), SealError> {
    let is_dcl = matches!(scheme, Scheme::Dcl(_));
    let cam_from_layout = match session.options.anchors {
        SessionAnchors::Image => Rotation3::identity(),
        SessionAnchors::World | SessionAnchors::Gravity if !is_dcl => {
            return Err(SealError::SessionScheme { scheme: scheme.name() });
        }
        SessionAnchors::World => Rotation3::identity(),
        SessionAnchors::Gravity => held.levelled().ok_or(SealError::NoGravity)?,
    };
    let turn = turn(&cam_from_layout)?;
    let stays = session.options.anchors != SessionAnchors::Image;
    // Nothing shares a start that is not known in the world and not remembered either.
    let shared = stays && (held.cam_from_world().is_some() || session.options.memory);
    let layout_from_world = layout_from(turn, held);
    Ok((turn, shared.then_some(Start { scheme, camera, layout_from_world })))
}

/// Where the layout is in the world, as its turn is told, so that later frames are turned against the very same.
fn layout_from(turn: LayoutTurn, held: &Orientation) -> Option<Rotation3<f64>> {
    held.cam_from_world().map(|cam_from_world| turn.cam_from_layout().inverse() * cam_from_world)
}

fn turn(cam_from_layout: &Rotation3<f64>) -> Result<LayoutTurn, SealError> {
    LayoutTurn::new(cam_from_layout).ok_or(SealError::NoOrientation)
}

/// Whether nearly all keypoints belong to one anchor, so that no pose is held.
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
    let mut counts = [0; Anchor::MOST];
    for keypoint in &features.keypoints {
        if let Some(p) = camera.unproject(keypoint.pixel) {
            counts[pencils.anchor_of(pinhole.project(p)).index()] += 1;
        }
    }
    let all: usize = counts.iter().sum();
    let others = all - counts.iter().copied().max().unwrap_or(0);
    // The strongest are sent, which may be fewer.
    others < LEAST_A_SIDE.max(all / 16)
}
