//! The part of a larger map that a region is.
//!
//! A map that is too large for one machine is cut into regions. A region is an ordinary map of some of the images,
//! with the profile of the whole map. Every image is in the core of exactly one region; other regions may have it in
//! their overlap.

/// An image of a region.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct RegionImage {
    /// Its index in the whole map.
    pub whole: u32,
    /// Whether it is in the core of this region, and so of no other.
    pub is_core: bool,
}

/// Which images of the whole map a region has. Its self-test, if any, is that of the whole map.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Region {
    /// Number of images of the whole map.
    pub images: u32,
    /// `[I]`, its images, in ascending order.
    pub of_images: Vec<RegionImage>,
}

impl Region {
    /// Number of images in its core.
    pub fn core_count(&self) -> usize {
        self.of_images.iter().filter(|image| image.is_core).count()
    }

    /// Checks the region against the number of its images.
    pub(crate) fn check(&self, images: usize, has_summaries: bool) -> Result<(), String> {
        if self.of_images.len() != images {
            return Err(format!("has {} images in a region of {images}", self.of_images.len()));
        }
        if !self.of_images.is_sorted_by(|a, b| a.whole < b.whole) {
            return Err("has images of the whole map that are not in ascending order".to_owned());
        }
        if self.of_images.last().is_some_and(|last| last.whole >= self.images) {
            return Err(format!("has an image beyond the {} of the whole map", self.images));
        }
        if self.core_count() == 0 {
            return Err("is a region without a core".to_owned());
        }
        if !has_summaries {
            return Err("is a region without summaries of its points".to_owned());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inconsistent_regions_are_named() {
        let image = |whole, is_core| RegionImage { whole, is_core };
        let of = |of_images: &[RegionImage]| Region { images: 9, of_images: of_images.to_vec() };
        let good = [image(2, true), image(5, false), image(8, true)];
        assert_eq!(of(&good).check(3, true), Ok(()));
        assert_eq!(of(&good).core_count(), 2);
        let refused =
            |of_images: &[RegionImage], images| of(of_images).check(images, true).expect_err("refused");
        assert!(refused(&good, 4).contains("3 images in a region of 4"));
        assert!(refused(&[image(5, true), image(2, true)], 2).contains("ascending order"));
        assert!(refused(&[image(5, true), image(5, true)], 2).contains("ascending order"));
        assert!(refused(&[image(5, true), image(9, true)], 2).contains("beyond the 9"));
        assert!(refused(&[image(5, false)], 1).contains("without a core"));
        assert!(refused(&[], 0).contains("without a core"));
        assert!(of(&good).check(3, false).expect_err("refused").contains("without summaries"));
    }
}
