//! Boxes, and non-maximum suppression.

/// A detected object.
#[derive(Clone, Copy, PartialEq)]
pub struct Detection {
    /// Number of its class.
    pub class: usize,
    /// Score of the detection, 0 to 1.
    pub score: f32,
    /// Left, upper, right and lower border in pixels of the image file (the corner of the first pixel is 0, 0).
    pub corners: [f32; 4],
}

// The position of people must not be logged (rule L8).
impl std::fmt::Debug for Detection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Detection(class {})", self.class)
    }
}

impl Detection {
    /// Intersection over union of two boxes.
    pub fn overlap(&self, other: &Self) -> f32 {
        let [left, upper, right, lower] = self.corners;
        let [left2, upper2, right2, lower2] = other.corners;
        let side = |low: f32, high: f32| (high - low).max(0.0);
        let shared = side(left.max(left2), right.min(right2)) * side(upper.max(upper2), lower.min(lower2));
        let all =
            side(left, right) * side(upper, lower) + side(left2, right2) * side(upper2, lower2) - shared;
        if all > 0.0 { shared / all } else { 0.0 }
    }
}

/// Non-maximum suppression: of boxes of one class that overlap by more than `most`, only the one with the highest score
/// stays. Sorted by falling score.
pub(crate) fn suppress_overlaps(mut all: Vec<Detection>, most: f32) -> Vec<Detection> {
    all.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut kept: Vec<Detection> = Vec::new();
    for detection in all {
        if !kept.iter().any(|k| k.class == detection.class && k.overlap(&detection) > most) {
            kept.push(detection);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(class: usize, score: f32, left: f32, width: f32) -> Detection {
        Detection { class, score, corners: [left, 0.0, left + width, 10.0] }
    }

    #[test]
    fn overlapping_boxes_are_suppressed_by_score() {
        let all =
            vec![at(0, 0.5, 0.0, 10.0), at(0, 0.9, 1.0, 10.0), at(0, 0.3, 40.0, 10.0), at(1, 0.4, 1.0, 10.0)];
        let kept: Vec<f32> = suppress_overlaps(all.clone(), 0.5).iter().map(|d| d.score).collect();
        assert_eq!(kept, [0.9, 0.4, 0.3]);
        assert!((all[0].overlap(&all[1]) - 90.0 / 110.0).abs() < 1e-6);
        assert_eq!(all[0].overlap(&all[2]), 0.0);
        assert_eq!(at(0, 1.0, 5.0, 0.0).overlap(&at(0, 1.0, 5.0, 0.0)), 0.0, "an empty box has no area");
    }
}
