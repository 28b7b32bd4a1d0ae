//! Whether a query can fix a pose at all, as far as a device can tell before it sends it.

use crate::{Observations, SealedQuery};

/// Fewest rows on each side of the dividing line that are worth sending.
///
/// A trusted pose needs four agreeing keypoints a side (`veiloc_pose::Confidence`). Of the rows of an image of a
/// mapped place about a quarter agree in the end, of a hard one an eighth: 32 leave four.
pub const LEAST_A_SIDE: usize = 32;

/// Too few rows on one side of the dividing line: the paper's degenerate case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "only {few} of {all} keypoints lie on one side of the dividing line, {LEAST_A_SIDE} are needed on each: the pose \
     would be loosely held or undetermined; move or turn the camera so that both sides show texture"
)]
pub struct Lopsided {
    /// Rows on the poorer side.
    pub few: usize,
    /// All rows.
    pub all: usize,
}

impl SealedQuery {
    /// Rows of each anchor; `None` for schemes without anchors. Decoys count as what they stand for: they are made to lie
    /// where the real ones do.
    pub fn sides(&self) -> Option<Vec<usize>> {
        match self.observations() {
            Observations::Anchored { pencils, lines } => {
                let rows = |anchor| lines.iter().filter(|line| line.anchor == anchor).count();
                Some(pencils.anchors().map(rows).collect())
            }
            Observations::Points(_) | Observations::Lines(_) | Observations::EitherLine(_) => None,
        }
    }

    /// Whether enough rows lie on both sides of the dividing line. To be asked before sending; a query that is not sent
    /// tells nobody anything, so another image may be taken and sealed.
    ///
    /// # Errors
    /// [`Lopsided`] with the counts.
    pub fn check_sides(&self) -> Result<(), Lopsided> {
        match self.sides() {
            Some(rows) => {
                // Lines of one anchor leave a direction free that any others hold.
                let few = self.len() - rows.into_iter().max().unwrap_or(0);
                if few < LEAST_A_SIDE { Err(Lopsided { few, all: self.len() }) } else { Ok(()) }
            }
            None => Ok(()),
        }
    }
}
