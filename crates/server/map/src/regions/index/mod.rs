//! The index: the global descriptor of every image of the whole map, and the regions that hold it.
//!
//! For machines that only select regions for a query. They rank images exactly as retrieval in the whole map does,
//! and select the regions that hold the retrieved images.

mod layout;

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use crate::{MapFile, MapMemory};
use veiloc_descriptor::{GlobalDescriptor, GlobalIndex};
use veiloc_protocol::ProfileId;
use veiloc_simd::MappedFile;
use zerocopy::FromBytes as _;

pub use self::layout::INDEX_VERSION;
use self::layout::Layout;
use crate::MapError;

/// An opened index file.
///
/// It is validated once when it is opened; accessors neither fail nor panic.
#[derive(Debug)]
pub struct RegionIndex {
    path: PathBuf,
    bytes: MappedFile,
    layout: Layout,
    /// Built on first use.
    signs: OnceLock<GlobalIndex>,
}

/// A region, and how many of the retrieved images it holds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RankedRegion {
    /// Its number in the manifest.
    pub region: usize,
    /// Number of retrieved images in its core or overlap.
    pub held: usize,
    /// Similarity of the best of them, -1 to 1.
    pub similarity: f32,
}

impl RegionIndex {
    /// Opens an index. With [`MapMemory::Mapped`] the file must not be overwritten while it is open.
    ///
    /// # Errors
    /// [`MapError::Io`], [`MapError::IndexVersion`], or [`MapError::Index`] with the reason.
    pub fn open(path: &Path, memory: MapMemory) -> Result<Self, MapError> {
        let bytes = match memory {
            MapMemory::Copied => MappedFile::copied(path),
            MapMemory::Mapped => MappedFile::open(path),
        };
        let bytes = bytes.map_err(MapError::io(path))?;
        let layout = Layout::of(&bytes).map_err(|fault| fault.at(path))?;
        Ok(Self { path: path.to_owned(), bytes, layout, signs: OnceLock::new() })
    }

    /// Encodes the index of a map with these regions.
    pub(crate) fn encode(map: &MapFile, regions: &[crate::Region]) -> Vec<u8> {
        layout::encode(map, regions)
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Length of the file, bytes.
    pub fn byte_count(&self) -> usize {
        self.bytes.len()
    }

    /// Id of the profile for which queries must be sealed.
    pub const fn profile(&self) -> ProfileId {
        self.layout.profile
    }

    /// Number of images of the whole map.
    pub const fn image_count(&self) -> usize {
        self.layout.images
    }

    /// Number of regions.
    pub const fn region_count(&self) -> usize {
        self.layout.regions
    }

    /// Number of codes of a global descriptor.
    pub const fn global_len(&self) -> usize {
        self.layout.global
    }

    /// The region whose core has this image; the index must be below [`Self::image_count`].
    pub fn core_of(&self, image: usize) -> usize {
        self.numbers(&self.layout.cores)[image] as usize
    }

    /// The regions whose overlap has this image, in ascending order.
    pub fn beside(&self, image: usize) -> impl ExactSizeIterator<Item = usize> {
        let ends = self.ends();
        let start = image.checked_sub(1).map_or(0, |before| ends[before] as usize);
        self.numbers(&self.layout.others)[start..ends[image] as usize].iter().map(|region| *region as usize)
    }

    /// Codes of the global descriptor of an image.
    pub fn global(&self, image: usize) -> &[i8] {
        &self.globals()[image * self.layout.global..(image + 1) * self.layout.global]
    }

    /// The `count` images most similar to a query, best first, as the whole map retrieves them; ties in map order.
    ///
    /// The query must be sealed for [`Self::profile`]; a descriptor of another length is equally dissimilar to all
    /// images.
    pub fn retrieve(&self, query: &GlobalDescriptor, count: usize) -> Vec<(usize, f32)> {
        let codes = |image| (image, self.global(image));
        match self.signs() {
            None => query.most_similar((0..self.layout.images).map(codes), count),
            Some(signs) => {
                let named = signs.candidates(query, GlobalIndex::candidates_for(count));
                query.most_similar(named.into_iter().map(codes), count)
            }
        }
    }

    /// The regions that hold any of the `count` images most similar to a query: those with most of them first, then
    /// those with the most similar image, then by number.
    pub fn rank(&self, query: &GlobalDescriptor, count: usize) -> Vec<RankedRegion> {
        let mut ranked: Vec<RankedRegion> = Vec::new();
        for (image, similarity) in self.retrieve(query, count) {
            for region in std::iter::once(self.core_of(image)).chain(self.beside(image)) {
                match ranked.iter_mut().find(|known| known.region == region) {
                    Some(known) => known.held += 1,
                    None => ranked.push(RankedRegion { region, held: 1, similarity }),
                }
            }
        }
        let worse = |a: &RankedRegion, b: &RankedRegion| {
            b.similarity.total_cmp(&a.similarity).then(a.region.cmp(&b.region))
        };
        ranked.sort_by(|a, b| b.held.cmp(&a.held).then(worse(a, b)));
        ranked
    }

    /// As in the whole map: [`MapFile::global_index`].
    fn signs(&self) -> Option<&GlobalIndex> {
        let make = || GlobalIndex::new(self.globals(), self.layout.global);
        (self.layout.images >= GlobalIndex::MIN_IMAGES).then(|| self.signs.get_or_init(make))
    }

    fn globals(&self) -> &[i8] {
        <[i8]>::ref_from_bytes(&self.bytes[self.layout.globals.clone()]).expect("any bytes are codes")
    }

    fn numbers(&self, range: &std::ops::Range<usize>) -> &[u32] {
        <[u32]>::ref_from_bytes(&self.bytes[range.clone()]).expect("aligned and whole, checked when opened")
    }

    fn ends(&self) -> &[u64] {
        let range = self.layout.ends.clone();
        <[u64]>::ref_from_bytes(&self.bytes[range]).expect("aligned and whole, checked when opened")
    }
}
