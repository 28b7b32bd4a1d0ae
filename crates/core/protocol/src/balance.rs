//! Whether a query can determine a pose, as far as a device can check before sending.

use crate::{Observations, SealedQuery};

/// Minimum number of rows on each side of the dividing line.
///
/// A trusted pose needs four agreeing keypoints per side (`veiloc_pose::Confidence`). About a quarter of the rows agree
/// for an image of a mapped scene, an eighth for a difficult image: 32 rows leave four.
pub const MIN_PER_SIDE: usize = 32;

/// Too few rows on one side of the dividing line: the paper's degenerate case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "only {few} of {all} keypoints lie on one side of the dividing line, {MIN_PER_SIDE} are needed on each: the pose \
     would be imprecise or undetermined; move or turn the camera so that both sides show texture"
)]
pub struct UnbalancedAnchors {
    /// Rows on the side with fewer rows.
    pub few: usize,
    /// All rows.
    pub all: usize,
}

impl SealedQuery {
    /// Rows of each anchor; `None` for schemes without anchors. Decoys are counted as real rows: they are placed where
    /// the real ones are.
    pub fn sides(&self) -> Option<Vec<usize>> {
        match self.observations() {
            Observations::Anchored { pencils, lines } => {
                let rows = |anchor| lines.iter().filter(|line| line.anchor == anchor).count();
                Some(pencils.anchors().map(rows).collect())
            }
            Observations::Points(_) | Observations::Lines(_) | Observations::EitherLine(_) => None,
        }
    }

    /// Whether enough rows lie on both sides of the dividing line. Check this before sending: a query that is not sent
    /// reveals nothing, so another image may be taken and sealed.
    ///
    /// # Errors
    /// [`UnbalancedAnchors`] with the counts.
    pub fn check_sides(&self) -> Result<(), UnbalancedAnchors> {
        match self.sides() {
            Some(rows) => {
                // Lines of one anchor leave one direction free, which lines of any other anchor determine.
                let few = self.len() - rows.into_iter().max().unwrap_or(0);
                if few < MIN_PER_SIDE { Err(UnbalancedAnchors { few, all: self.len() }) } else { Ok(()) }
            }
            None => Ok(()),
        }
    }
}
