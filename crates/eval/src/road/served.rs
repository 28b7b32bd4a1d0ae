//! What queries are asked in: a map, or the regions that it was cut into.

use tempfile::TempDir;
use veiloc_features::Progress;
use veiloc_map::{MapFile, MapMemory};
use veiloc_query::SealedQuery;
use veiloc_regions::{Folder, FolderWriter, Index, SplitOptions, cut};
use veiloc_results::RegionsSummary;

use crate::error::EvalError;

/// A map as it is served.
pub(crate) struct Served<'a> {
    whole: &'a MapFile,
    regions: Option<Regions>,
}

/// Regions, written and opened again as machines that serve them have them.
struct Regions {
    index: Index,
    maps: Vec<MapFile>,
    /// Images that retrieval gives.
    retrieve: usize,
    summary: RegionsSummary,
    /// Holds the files.
    _folder: TempDir,
}

impl<'a> Served<'a> {
    /// As it is, or cut so; a query is then asked in the region that holds most of the `retrieve` images which the whole map
    /// would give it.
    ///
    /// # Errors
    /// [`EvalError`] when it cannot be cut so, or regions cannot be written and opened.
    pub(crate) fn new(
        whole: &'a MapFile,
        options: Option<&SplitOptions>,
        retrieve: usize,
        progress: &dyn Progress,
    ) -> Result<Self, EvalError> {
        let regions = options.map(|options| Regions::of(whole, options, retrieve, progress)).transpose()?;
        Ok(Self { whole, regions })
    }

    /// The map that it is, or that the regions are of.
    pub(crate) const fn whole(&self) -> &'a MapFile {
        self.whole
    }

    /// The map that a query is asked in. One that cannot be read is refused by any.
    pub(crate) fn for_sent(&self, bytes: &[u8]) -> &MapFile {
        let of_region = || {
            let regions = self.regions.as_ref()?;
            let query = SealedQuery::decode(bytes).ok()?;
            regions.maps.get(regions.index.rank(query.global(), regions.retrieve).first()?.region)
        };
        of_region().unwrap_or(self.whole)
    }

    /// Facts about the regions, where there are some.
    pub(crate) fn summary(&self) -> Option<RegionsSummary> {
        self.regions.as_ref().map(|regions| regions.summary.clone())
    }
}

impl Regions {
    fn of(
        whole: &MapFile,
        options: &SplitOptions,
        retrieve: usize,
        progress: &dyn Progress,
    ) -> Result<Self, EvalError> {
        let folder =
            tempfile::tempdir().map_err(|source| EvalError::Io { path: std::env::temp_dir(), source })?;
        let regions = cut(whole, options)?;
        let writer = FolderWriter::begin(whole, "place", folder.path())?;
        progress.start("Cutting regions", regions.len());
        let mut entries = Vec::with_capacity(regions.len());
        for region in &regions {
            entries.push(writer.region(region)?);
            progress.advance(1);
        }
        progress.finish();
        let manifest = writer.finish(&regions, entries)?;
        let open = Folder::open(folder.path())?;
        let maps = (0..regions.len()).map(|number| open.open_region(number, MapMemory::Mapped));
        let summary = RegionsSummary {
            count: regions.len(),
            images_held: manifest.regions.iter().map(|region| region.images).sum(),
            bytes: manifest.regions.iter().map(|region| region.bytes).sum(),
            largest_bytes: manifest.regions.iter().map(|region| region.bytes).max().unwrap_or(0),
            index_bytes: manifest.index.bytes,
        };
        Ok(Self {
            index: open.open_index(MapMemory::Mapped)?,
            maps: maps.collect::<Result<_, _>>()?,
            retrieve,
            summary,
            _folder: folder,
        })
    }
}
