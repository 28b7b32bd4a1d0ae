//! A sparse map: every tenth image of the list, or more so that [`MIN_IMAGES`] remain.

/// Step through the list.
const EVERY: usize = 10;

/// Minimum number of remaining images, if there are as many.
const MIN_IMAGES: usize = 4;

/// The step for this number of images.
pub(super) const fn step_for(images: usize) -> usize {
    let most = images.saturating_sub(1) / (MIN_IMAGES - 1);
    if most < 1 {
        1
    } else if most < EVERY {
        most
    } else {
        EVERY
    }
}

/// The names of the remaining images.
pub(crate) fn subsampled(names: &[String]) -> Vec<String> {
    names.iter().step_by(step_for(names.len())).cloned().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_tenth_image_and_at_least_four_remain() {
        for (images, every, left) in [
            (87, 10, 9),
            (83, 10, 9),
            (31, 10, 4),
            (30, 9, 4),
            (19, 6, 4),
            (10, 3, 4),
            (4, 1, 4),
            (2, 1, 2),
            (1, 1, 1),
        ] {
            let names: Vec<String> = (0..images).map(|i| format!("{i}.jpg")).collect();
            let thin = subsampled(&names);
            assert_eq!((step_for(images), thin.len(), thin[0].as_str()), (every, left, "0.jpg"), "{images}");
        }
        assert!(subsampled(&[]).is_empty());
    }
}
