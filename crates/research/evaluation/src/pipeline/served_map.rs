//! The served map: a whole map, or its regions.

use std::sync::OnceLock;

use crate::results::RegionsSummary;
use tempfile::TempDir;
use veiloc_features::Progress;
use veiloc_localization::LocalizeOptions;
use veiloc_map::regions::{
    DEFAULT_SEARCHED_REGIONS, FolderWriter, RegionFolder, RegionIndex, SplitOptions, cut, is_better_pose,
    search_rounds,
};
use veiloc_map::{MapFile, MapMemory};
use veiloc_obfuscation::{KnownPlace, SealError};
use veiloc_pose::State;
use veiloc_protocol::{Pack, SealedQuery};

use super::server::{LocalizeResult, decode_and_localize};
use crate::error::EvalError;

/// A map as it is served.
pub(crate) struct ServedMap<'a> {
    whole: &'a MapFile,
    regions: Option<Regions>,
    /// The pack, prepared on first use.
    place: OnceLock<KnownPlace>,
}

/// Regions, written and opened again as on the machines that serve them.
struct Regions {
    index: RegionIndex,
    maps: Vec<MapFile>,
    summary: RegionsSummary,
    /// Holds the temporary files until it is dropped.
    _folder: TempDir,
}

impl<'a> ServedMap<'a> {
    /// Serves the whole map, or splits it into regions; a query is then localized in the regions that hold most of
    /// the images that the whole map would retrieve, as a gateway of many machines does ([`search_rounds`]).
    ///
    /// # Errors
    /// [`EvalError`] when the map cannot be split, or regions cannot be written and opened.
    pub(crate) fn new(
        whole: &'a MapFile,
        options: Option<&SplitOptions>,
        progress: &dyn Progress,
    ) -> Result<Self, EvalError> {
        let regions = options.map(|options| Regions::of(whole, options, progress)).transpose()?;
        Ok(Self { whole, regions, place: OnceLock::new() })
    }

    /// The whole map.
    pub(crate) const fn whole(&self) -> &'a MapFile {
        self.whole
    }

    /// The place as a device with its pack knows it.
    ///
    /// # Errors
    /// [`SealError`] when the map has no pack.
    pub(crate) fn place(&self) -> Result<KnownPlace, SealError> {
        if let Some(place) = self.place.get() {
            return Ok(place.clone());
        }
        let (pack, _) = self.whole.pack()?;
        // As a device reads it.
        let place = KnownPlace::new(Pack::decode(&pack.encode())?)?;
        Ok(self.place.get_or_init(|| place).clone())
    }

    /// The answer to these bytes: with several regions the pose that a gateway would choose, with the times of its
    /// region alone.
    pub(crate) fn localize(&self, bytes: &[u8], options: &LocalizeOptions) -> LocalizeResult {
        // Invalid bytes are refused by any map.
        let (Some(regions), Ok(query)) = (&self.regions, SealedQuery::decode(bytes)) else {
            return decode_and_localize(self.whole, bytes, options);
        };
        let Some(global) = query.global() else { return decode_and_localize(self.whole, bytes, options) };
        let ranked = regions.index.rank(global, options.retrieve);
        let mut best: Option<LocalizeResult> = None;
        for round in
            search_rounds(ranked.into_iter().map(|one| (one.region, one.held)), DEFAULT_SEARCHED_REGIONS)
        {
            for map in round.into_iter().filter_map(|region| regions.maps.get(region)) {
                let answer = decode_and_localize(map, bytes, options);
                if best.as_ref().is_none_or(|known| is_better_pose(rank(&answer), rank(known))) {
                    best = Some(answer);
                }
            }
            if best.as_ref().is_some_and(|best| best.state() == State::Trusted) {
                break;
            }
        }
        best.unwrap_or_else(|| decode_and_localize(self.whole, bytes, options))
    }

    /// Facts about the regions, if there are any.
    pub(crate) fn summary(&self) -> Option<RegionsSummary> {
        self.regions.as_ref().map(|regions| regions.summary.clone())
    }
}

/// The order by which regions are compared.
fn rank(answer: &LocalizeResult) -> (bool, f64) {
    (answer.state() == State::Trusted, answer.log_evidence().unwrap_or(f64::NEG_INFINITY))
}

impl Regions {
    fn of(whole: &MapFile, options: &SplitOptions, progress: &dyn Progress) -> Result<Self, EvalError> {
        let folder =
            tempfile::tempdir().map_err(|source| EvalError::Io { path: std::env::temp_dir(), source })?;
        let regions = cut(whole, options)?;
        let writer = FolderWriter::begin(whole, "place", folder.path())?;
        progress.start("Splitting into regions", regions.len());
        let mut entries = Vec::with_capacity(regions.len());
        for region in &regions {
            entries.push(writer.region(region)?);
            progress.advance(1);
        }
        progress.finish();
        let manifest = writer.finish(&regions, entries)?;
        let open = RegionFolder::open(folder.path())?;
        let maps = (0..regions.len()).map(|number| open.open_region(number, MapMemory::Mapped));
        let summary = RegionsSummary {
            count: regions.len(),
            images_total: manifest.regions.iter().map(|region| region.images).sum(),
            bytes: manifest.regions.iter().map(|region| region.bytes).sum(),
            largest_bytes: manifest.regions.iter().map(|region| region.bytes).max().unwrap_or(0),
            index_bytes: manifest.index.bytes,
        };
        Ok(Self {
            index: open.open_index(MapMemory::Mapped)?,
            maps: maps.collect::<Result<_, _>>()?,
            summary,
            _folder: folder,
        })
    }
}
