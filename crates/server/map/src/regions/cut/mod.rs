//! Which images go into which region.
//!
//! ```text
//! covisibility ── halves, each halved again (bisect), borders moved to where little is shared (border) ── cores
//!                 cores ── with the images beside them that share most with them (overlap) ── regions
//! ```
//! A query is localized in one region, by the images that retrieval gives. So images that show the same belong together:
//! the cut goes where few points are seen from both sides. Camera centres say where to begin, and where nothing is shared
//! they alone decide, so that rooms that look alike and lie far apart do not mix.

mod bisect;
mod border;
mod covisibility;
mod overlap;

use crate::{MapFile, Region, RegionImage};
use rayon::prelude::*;

use self::bisect::Cutter;
use self::covisibility::Covisibility;
use self::overlap::beside;
use crate::MapError;

/// How a map is cut.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct SplitOptions {
    /// Images of a region at most, those beside its core among them. Default 500: some hundred megabytes, so that a machine
    /// holds many and a new one is there within seconds.
    pub images: usize,
    /// Share of these that is kept free for images of other regions, from 0 to 0.9; a core that fills less than the rest
    /// leaves them more. Default 0.3: more costs bytes and gains nothing (docs/results/scale.md).
    pub overlap: f64,
}

impl Default for SplitOptions {
    fn default() -> Self {
        Self { images: 500, overlap: 0.3 }
    }
}

impl SplitOptions {
    /// Regions of at most so many images.
    #[must_use]
    pub const fn with_images(self, images: usize) -> Self {
        Self { images, ..self }
    }

    /// With this share kept free for images of other regions.
    #[must_use]
    pub const fn with_overlap(self, overlap: f64) -> Self {
        Self { overlap, ..self }
    }

    /// Images in the core of a region at most.
    fn core(&self) -> Result<usize, MapError> {
        let refuse = |reason: String| Err(MapError::Cut { reason });
        if self.images == 0 {
            return refuse("regions of no image; ask for one at least".to_owned());
        }
        if !(0.0..=0.9).contains(&self.overlap) {
            return refuse(format!("an overlap of {}; give a share from 0 to 0.9", self.overlap));
        }
        let beside = (self.images as f64 * self.overlap).floor() as usize;
        Ok((self.images - beside).max(1))
    }
}

/// Cuts a map: its regions, each with a core and what lies beside it. Together the cores are the map, and none share an
/// image. Depends on map and options alone.
///
/// # Errors
/// [`MapError::Cut`] when the map has no image or is a region itself, or when nothing can be cut so.
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
    let cores = Cutter { shared: &shared, centres: &centres, core }.cores();
    let whole = |core: &Vec<u32>| region(core, &beside(&shared, core, options.images - core.len()));
    Ok(cores.par_iter().map(whole).collect())
}
