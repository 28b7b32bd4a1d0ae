//! Which part of a larger map a map is.
//!
//! A map that is too large for one machine is cut into regions, each an ordinary map of some of the images, with the profile
//! of the whole one. Every image is in the core of exactly one region; regions overlap in images beside the core of each.

/// An image of a region.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct RegionImage {
    /// Its index in the whole map.
    pub whole: u32,
    /// Whether it is in the core of this region; of no other region then.
    pub is_core: bool,
}

/// What a region is of. Its self-test, where it has one, is the whole map's.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Region {
    /// Number of images of the whole map.
    pub images: u32,
    /// `[I]`, its own images, in rising order.
    pub of_images: Vec<RegionImage>,
}

impl Region {
    /// Number of images in its core.
    pub fn core_count(&self) -> usize {
        self.of_images.iter().filter(|image| image.is_core).count()
    }

    /// Whether it can be of a map of so many images.
    pub(crate) fn check(&self, images: usize, is_remembered: bool) -> Result<(), String> {
        if self.of_images.len() != images {
            return Err(format!("names {} images of a region of {images}", self.of_images.len()));
        }
        if !self.of_images.is_sorted_by(|a, b| a.whole < b.whole) {
            return Err("names images of the whole map that are not in rising order".to_owned());
        }
        if self.of_images.last().is_some_and(|last| last.whole >= self.images) {
            return Err(format!("names an image beyond the {} of the whole map", self.images));
        }
        if self.core_count() == 0 {
            return Err("is a region without a core".to_owned());
        }
        if !is_remembered {
            return Err("is a region that remembers nothing of its points".to_owned());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_fit_is_named() {
        let image = |whole, is_core| RegionImage { whole, is_core };
        let of = |of_images: &[RegionImage]| Region { images: 9, of_images: of_images.to_vec() };
        let good = [image(2, true), image(5, false), image(8, true)];
        assert_eq!(of(&good).check(3, true), Ok(()));
        assert_eq!(of(&good).core_count(), 2);
        let refused =
            |of_images: &[RegionImage], images| of(of_images).check(images, true).expect_err("refused");
        assert!(refused(&good, 4).contains("3 images of a region of 4"));
        assert!(refused(&[image(5, true), image(2, true)], 2).contains("rising order"));
        assert!(refused(&[image(5, true), image(5, true)], 2).contains("rising order"));
        assert!(refused(&[image(5, true), image(9, true)], 2).contains("beyond the 9"));
        assert!(refused(&[image(5, false)], 1).contains("without a core"));
        assert!(refused(&[], 0).contains("without a core"));
        assert!(of(&good).check(3, false).expect_err("refused").contains("remembers nothing"));
    }
}
