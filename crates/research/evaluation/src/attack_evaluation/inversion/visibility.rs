//! ROC AUC of a network's visibility output, on the positions that attacks give.

use crate::results::metrics::roc_auc;

/// Thresholds of correct and wrong positions: an error below one cell is invisible to the network, and the network
/// was trained to detect an error of two cells.
const RIGHT_CELLS: f64 = 1.0;
const WRONG_CELLS: f64 = 2.0;

/// Visibility of correctly and of wrongly placed keypoints.
#[derive(Debug, Clone, Default)]
pub(super) struct VisibilityScores {
    right: Vec<f32>,
    wrong: Vec<f32>,
}

impl VisibilityScores {
    /// Adds keypoints of an image: `visibility` is the visibility of each, NaN if it was not placed, `errors` its
    /// position error, pixels. `cell`: side of a cell, pixels. Keypoints with an error between both thresholds are
    /// left out.
    pub(super) fn add(&mut self, visibility: &[f32], errors: &[f64], cell: f64) {
        for (value, error) in visibility.iter().zip(errors).filter(|(value, _)| value.is_finite()) {
            if *error <= RIGHT_CELLS * cell {
                self.right.push(*value);
            } else if *error >= WRONG_CELLS * cell {
                self.wrong.push(*value);
            }
        }
    }

    /// ROC AUC: probability that a correct keypoint has a larger visibility than a wrong one; ties count half.
    pub(super) fn roc_auc(&self) -> Option<f64> {
        let of = |values: &[f32]| values.iter().copied().map(f64::from).collect::<Vec<_>>();
        roc_auc(&of(&self.right), &of(&self.wrong))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roc_auc_of_visibility() {
        let of = |visibility: &[f32], errors: &[f64]| {
            let mut all = VisibilityScores::default();
            all.add(visibility, errors, 8.0);
            all.roc_auc()
        };
        assert_eq!(of(&[0.9, 0.8, 0.2], &[0.0, 8.0, 16.0]), Some(1.0));
        assert_eq!(of(&[0.1, 0.8], &[0.0, 90.0]), Some(0.0));
        assert_eq!(of(&[0.5, 0.5, 0.5], &[0.0, 20.0, 30.0]), Some(0.5));
        assert_eq!(of(&[0.6, 0.5, 0.7, f32::NAN], &[0.0, 20.0, 20.0, 500.0]), Some(0.5));
        assert_eq!(of(&[0.6, 0.5], &[0.0, 12.0]), None, "between right and wrong");
        assert_eq!(of(&[], &[]), None);
    }
}
