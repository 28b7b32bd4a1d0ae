//! The section of a region: one record for the region, then one per image.

use zerocopy::{FromBytes, IntoBytes};

use super::layout::{RegionImageRecord, RegionRecord};
use crate::region::{Region, RegionImage};

pub(super) fn encode(region: &Region) -> Vec<u8> {
    let mut encoded = RegionRecord { images: region.images, reserved: 0 }.as_bytes().to_vec();
    for RegionImage { whole, is_core } in &region.of_images {
        let record = RegionImageRecord { whole: *whole, core: u32::from(*is_core) };
        encoded.extend_from_slice(record.as_bytes());
    }
    encoded
}

/// Decodes the section and checks it against the number of images; returns the reason if it is invalid.
pub(super) fn decode(bytes: &[u8], images: usize, has_summaries: bool) -> Result<Region, String> {
    let (head, rest) =
        RegionRecord::read_from_prefix(bytes).map_err(|_| "shorter than its first record".to_owned())?;
    let records = <[RegionImageRecord]>::ref_from_bytes(rest).map_err(|_| "not whole records".to_owned())?;
    if head.reserved != 0 || records.iter().any(|r| r.core > 1) {
        return Err("reserved bytes are used".to_owned());
    }
    let image = |r: &RegionImageRecord| RegionImage { whole: r.whole, is_core: r.core == 1 };
    let region = Region { images: head.images, of_images: records.iter().map(image).collect() };
    region.check(images, has_summaries)?;
    Ok(region)
}
