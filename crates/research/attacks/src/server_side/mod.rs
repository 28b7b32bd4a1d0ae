//! Server-side attacks: a server that has found the pose projects the map points of its inliers, and so knows some
//! positions ([`crate::Observation::Known`]).
//!
//! - [`server_side`]: the paper's attack (its supplement, "Baseline server-side attack");
//! - [`iterative`]: the paper's iterative attack, which reuses estimated positions as known ones;
//! - [`occlusion`](occlusion()): where the map should have been seen and was not;
//! - [`guided_transfer`](guided_transfer()): map images warped into the query by the flow of the inliers.
//!
//! [`crate::graph()`] uses known positions as well, and is the strongest attack that needs neighbours.

mod flow;
mod guided;
mod iterative;
mod occlusion;
mod warp;

pub use guided::{GuidedEstimate, GuidedOptions, guided_transfer};
pub use iterative::iterative;
pub use occlusion::{MapVisibility, OcclusionEstimate, occlusion};

use crate::error::AttackError;
use crate::geometry_recovery::{ClosedFormOptions, RecoveredKeypoint, closed_form};
use crate::neighbours::NeighbourLists;
use crate::observation::Observation;

/// Use of neighbours that are lines when a neighbourhood also has known positions.
///
/// "If the neighborhood contains projected inlier points, we used a point-to-point distance instead of point-to-line
/// distance in Eq. (3)" (the paper's supplement) can be read either way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LineNeighbours {
    /// They are used beside the known ones: each neighbour contributes its own distance.
    #[default]
    Used,
    /// They are ignored: a known position carries more information than a line, and lines of one anchor vote for the
    /// anchor.
    Ignored,
}

/// The paper's server-side attack: Eq. 3 with the distance to the point for neighbours whose position is known.
///
/// A keypoint without a known neighbour is recovered from lines alone, as by [`closed_form`]. The answer for a known
/// keypoint is its position.
///
/// # Errors
/// [`AttackError::ListCount`] when the numbers of neighbour lists and observations differ,
/// [`AttackError::NoNeighbours`] when no keypoint has any.
pub fn server_side(
    observations: &[Observation],
    neighbours: &NeighbourLists,
    width: u32,
    height: u32,
    lines: LineNeighbours,
) -> Result<Vec<RecoveredKeypoint>, AttackError> {
    check(observations, neighbours)?;
    let known = known(observations);
    let options = ClosedFormOptions::default();
    match lines {
        LineNeighbours::Used => closed_form(observations, neighbours, width, height, &options),
        LineNeighbours::Ignored => {
            let meets: Vec<bool> = (0..neighbours.len())
                .map(|i| neighbours.of(i).iter().any(|j| known[*j as usize].is_some()))
                .collect();
            let lists = neighbours.filtered(|i, j| !meets[i] || known[j as usize].is_some());
            closed_form(observations, &lists, width, height, &options)
        }
    }
}

/// The known positions.
fn known(observations: &[Observation]) -> Vec<Option<veiloc_geometry::Pixel>> {
    let position = |o: &Observation| match o {
        Observation::Known(pixel) => Some(*pixel),
        _ => None,
    };
    observations.iter().map(position).collect()
}

fn check(observations: &[Observation], neighbours: &NeighbourLists) -> Result<(), AttackError> {
    if observations.len() != neighbours.len() {
        return Err(AttackError::ListCount { observations: observations.len(), lists: neighbours.len() });
    }
    let any = (0..neighbours.len()).any(|i| !neighbours.of(i).is_empty());
    if any || observations.len() < 2 { Ok(()) } else { Err(AttackError::NoNeighbours) }
}
