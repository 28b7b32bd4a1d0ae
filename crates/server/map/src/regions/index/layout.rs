//! The layout of an index file. `docs/reference/map-format.md` is the specification.
//!
//! ```text
//! header     64 bytes
//! ends       [I] u64   where the other regions of each image end in `others`
//! cores      [I] u32   the region whose core has the image
//! others     [M] u32   other regions that hold it, in rising order
//! globals    [I, G] i8
//! ```

use std::ops::Range;
use std::path::Path;

use crate::{MapFile, Region};
use veiloc_protocol::ProfileId;
use xxhash_rust::xxh3::Xxh3;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::MapError;

/// The version of the index that this program writes and reads.
pub const INDEX_VERSION: u32 = 1;

/// Magic number of an index.
const MAGIC: [u8; 8] = *b"\x89VEILIDX";

/// The header of the file.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
struct Header {
    magic: [u8; 8],
    version: u32,
    regions: u32,
    images: u64,
    /// Total number of overlap memberships.
    others: u64,
    /// Number of codes of a global descriptor.
    global: u32,
    reserved: u32,
    profile: [u8; 16],
    /// XXH3-64 of the whole file, this field taken as zero.
    checksum: u64,
}

/// Validated counts and ranges of an index.
#[derive(Debug)]
pub(super) struct Layout {
    pub(super) regions: usize,
    pub(super) images: usize,
    pub(super) global: usize,
    pub(super) profile: ProfileId,
    pub(super) ends: Range<usize>,
    pub(super) cores: Range<usize>,
    pub(super) others: Range<usize>,
    pub(super) globals: Range<usize>,
}

/// Why the bytes of an index are invalid.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum IndexFault {
    Version(u32),
    Other(String),
}

impl IndexFault {
    pub(super) fn at(self, path: &Path) -> MapError {
        let path = path.to_owned();
        match self {
            Self::Version(found) => MapError::IndexVersion { path, found, supported: INDEX_VERSION },
            Self::Other(reason) => MapError::Index { path, reason },
        }
    }
}

impl Layout {
    pub(super) fn of(bytes: &[u8]) -> Result<Self, IndexFault> {
        let wrong = |reason: &str| IndexFault::Other(reason.to_owned());
        if !bytes.starts_with(&MAGIC) {
            return Err(wrong("not an index of regions"));
        }
        let (header, body) =
            Header::read_from_prefix(bytes).map_err(|_| wrong("an index that was cut short"))?;
        if header.version != INDEX_VERSION {
            return Err(IndexFault::Version(header.version));
        }
        let mut end = size_of::<Header>();
        let mut part = |count: u64, size: usize| {
            let length = usize::try_from(count).ok()?.checked_mul(size)?;
            let start = end;
            end = start.checked_add(length)?;
            Some(start..end)
        };
        let global = header.global as usize;
        let parts = part(header.images, size_of::<u64>())
            .zip(part(header.images, size_of::<u32>()))
            .zip(part(header.others, size_of::<u32>()))
            .zip(part(header.images, global));
        let Some((((ends, cores), others), globals)) = parts else {
            return Err(wrong("counts beyond all memory"));
        };
        if end != bytes.len() {
            return Err(IndexFault::Other(format!(
                "an index of {} bytes that should have {end}",
                bytes.len()
            )));
        }
        if checksum(&header, body) != header.checksum {
            return Err(wrong("the checksum is wrong: the index is damaged"));
        }
        if header.reserved != 0 {
            return Err(wrong("reserved bytes are used"));
        }
        let layout = Self {
            regions: header.regions as usize,
            images: header.images as usize,
            global,
            profile: ProfileId::from_bytes(header.profile),
            ends,
            cores,
            others,
            globals,
        };
        layout.check(bytes).map_err(IndexFault::Other)?;
        Ok(layout)
    }

    /// Checks that every image has a valid core region and ascending overlap regions, and that every region has a
    /// core.
    fn check(&self, bytes: &[u8]) -> Result<(), String> {
        let ends: &[u64] = records(bytes, &self.ends)?;
        let [cores, others]: [&[u32]; 2] = [records(bytes, &self.cores)?, records(bytes, &self.others)?];
        if self.regions > self.images {
            return Err(format!("{} regions of {} images", self.regions, self.images));
        }
        let mut has_core = vec![false; self.regions];
        let mut start = 0_usize;
        for (image, (end, core)) in ends.iter().zip(cores).enumerate() {
            let end = usize::try_from(*end).ok().filter(|end| (start..=others.len()).contains(end));
            let own = end.map(|end| &others[start..end]);
            let own = own.ok_or_else(|| format!("the regions of image {image} do not lie in their place"))?;
            match has_core.get_mut(*core as usize) {
                Some(has_core) => *has_core = true,
                None => return Err(format!("image {image} is in region {core} of {}", self.regions)),
            }
            let is_other = |region: &u32| region != core && (*region as usize) < self.regions;
            if !own.is_sorted_by(|a, b| a < b) || !own.iter().all(is_other) {
                return Err(format!("image {image} is beside regions that it cannot be beside"));
            }
            start += own.len();
        }
        if start != others.len() {
            return Err("regions of no image".to_owned());
        }
        match has_core.iter().position(|has_core| !has_core) {
            Some(region) => Err(format!("region {region} has no core")),
            None => Ok(()),
        }
    }
}

fn records<'a, T: FromBytes + Immutable + KnownLayout>(
    bytes: &'a [u8],
    range: &Range<usize>,
) -> Result<&'a [T], String> {
    <[T]>::ref_from_bytes(&bytes[range.clone()]).map_err(|_| "not whole numbers".to_owned())
}

pub(super) fn encode(map: &MapFile, regions: &[Region]) -> Vec<u8> {
    let mut cores = vec![0_u32; map.image_count()];
    let mut beside: Vec<Vec<u32>> = vec![Vec::new(); map.image_count()];
    for (number, region) in (0_u32..).zip(regions) {
        for image in &region.of_images {
            if image.is_core {
                cores[image.whole as usize] = number;
            } else {
                beside[image.whole as usize].push(number);
            }
        }
    }
    let ends: Vec<u64> = beside
        .iter()
        .scan(0, |end, own| {
            *end += own.len() as u64;
            Some(*end)
        })
        .collect();
    let others = beside.concat();
    let global = map.profile().global_model().global_len();
    let mut body = Vec::with_capacity(ends.len() * (12 + global) + 4 * others.len());
    body.extend_from_slice(ends.as_bytes());
    body.extend_from_slice(cores.as_bytes());
    body.extend_from_slice(others.as_bytes());
    map.images().for_each(|image| body.extend_from_slice(image.global().as_bytes()));
    let mut header = Header {
        magic: MAGIC,
        version: INDEX_VERSION,
        regions: regions.len() as u32,
        images: cores.len() as u64,
        others: others.len() as u64,
        global: global as u32,
        reserved: 0,
        profile: *map.profile().id().as_bytes(),
        checksum: 0,
    };
    header.checksum = checksum(&header, &body);
    [header.as_bytes(), &body].concat()
}

fn checksum(header: &Header, body: &[u8]) -> u64 {
    let mut hash = Xxh3::new();
    hash.update(Header { checksum: 0, ..*header }.as_bytes());
    hash.update(body);
    hash.digest()
}
