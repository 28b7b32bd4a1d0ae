//! Assigns images to regions.
//!
//! ```text
//! covisibility ── halves, each halved again (bisect), borders moved to where little is shared (border) ── cores
//!                 cores ── with the images beside them that share most with them (overlap) ── regions
//! ```
//! A query is localized in one region, with the images that retrieval returns. So images of the same part of the
//! scene belong together: the cut goes where few points are observed from both sides. Camera centres give the start,
//! and decide alone where no points are shared, so that distant rooms that look alike are separated.

mod bisect;
mod border;
mod covisibility;
mod overlap;

use crate::{MapFile, Region, RegionImage};
use rayon::prelude::*;

use self::bisect::Bisection;
use self::covisibility::Covisibility;
use self::overlap::beside;
use crate::MapError;

/// Options of cutting a map.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct SplitOptions {
    /// Maximum number of images per region, including the overlap. Default 500: some hundred megabytes, so that a
    /// machine holds many and loads a new one within seconds.
    pub images: usize,
    /// Share of the images reserved for the overlap, from 0 to 0.9; smaller cores leave more. Default 0.3: more costs
    /// bytes without benefit (docs/results/scale.md).
    pub overlap: f64,
}

impl Default for SplitOptions {
    fn default() -> Self {
        Self { images: 500, overlap: 0.3 }
    }
}

impl SplitOptions {
    /// With this maximum number of images per region.
    #[must_use]
    pub const fn with_images(self, images: usize) -> Self {
        Self { images, ..self }
    }

    /// With this share reserved for the overlap.
    #[must_use]
    pub const fn with_overlap(self, overlap: f64) -> Self {
        Self { overlap, ..self }
    }

    /// Maximum number of images per core.
    fn core(&self) -> Result<usize, MapError> {
        let refuse = |reason: String| Err(MapError::Cut { reason });
        if self.images == 0 {
            return refuse("regions of no image; ask for at least one".to_owned());
        }
        if !(0.0..=0.9).contains(&self.overlap) {
            return refuse(format!("an overlap of {}; give a share from 0 to 0.9", self.overlap));
        }
        let beside = (self.images as f64 * self.overlap).floor() as usize;
        Ok((self.images - beside).max(1))
    }
}

/// Cuts a map into regions, each with a core and an overlap. The cores partition the images. Depends on map and
/// options only.
///
/// # Errors
/// [`MapError::Cut`]: the map has no image or is a region itself, or the options are invalid.
pub fn cut(map: &MapFile, options: &SplitOptions) -> Result<Vec<Region>, MapError> {
    let core = options.core()?;
    let refuse = |reason: &str| Err(MapError::Cut { reason: reason.to_owned() });
    if map.part_of().is_some() {
        return refuse("it is a region of a larger map; cut the whole map");
    }
    if map.image_count() == 0 {
        return refuse("it has no images; build it of some");
    }
    let images = map.image_count() as u32;
    let region = |core: &[u32], beside: &[u32]| {
        let image = |is_core: bool| move |whole: &u32| RegionImage { whole: *whole, is_core };
        let mut of_images: Vec<RegionImage> =
            core.iter().map(image(true)).chain(beside.iter().map(image(false))).collect();
        of_images.sort_unstable();
        Region { images, of_images }
    };
    let all: Vec<u32> = (0..images).collect();
    if all.len() <= options.images {
        return Ok(vec![region(&all, &[])]);
    }
    let shared = Covisibility::of(map);
    let centres: Vec<[f64; 3]> =
        map.images().map(|image| image.cam_from_world().center().coords.into()).collect();
    let cores = Bisection { shared: &shared, centres: &centres, core }.cores();
    let whole = |core: &Vec<u32>| region(core, &beside(&shared, core, options.images - core.len()));
    Ok(cores.par_iter().map(whole).collect())
}
