//! `veiloc map split`: splits a map into regions.

use std::path::{Path, PathBuf};

use serde::Serialize;
use veiloc_map::MapFile;
use veiloc_map::regions::{FolderWriter, Manifest, RegionEntry, SplitOptions, cut};
use veiloc_mapping::Progress as _;
use veiloc_report::significant;

use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::stages::Stages;
use crate::output::targets::OutFolder;
use crate::output::ui::Ui;

/// Split a map into regions, for maps that exceed one machine.
///
/// Every image is in the core of one region; a region also contains overlapping images beside its core. Each region is
/// a map with the profile of the whole map: queries sealed for the whole map are valid for every region. Files are
/// named by their content hash, and a manifest lists them. Images cannot be added to a region or removed from it: keep
/// the whole map, change it, and split it again.
#[derive(clap::Args)]
pub(crate) struct SplitArgs {
    /// The map.
    map: PathBuf,
    /// Folder to write: `manifest.json` and `objects`. Objects that only an older manifest in the folder names are
    /// removed.
    #[arg(long, short, value_name = "DIR")]
    out: OutFolder,
    /// Maximum number of images per region, including those beside its core.
    #[arg(long, value_name = "N", default_value_t = 500, value_parser = clap::value_parser!(u32).range(1..))]
    images: u32,
    /// Share of a region's images that is reserved for images of other regions, from 0 to 0.9; a smaller core leaves
    /// more for them.
    #[arg(long, value_name = "SHARE", default_value_t = 0.3)]
    overlap: f64,
    /// Name of the map, under which services serve it. Default: the name of the file without its extension.
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// Print one JSON document to stdout.
    #[arg(long)]
    json: bool,
}

/// The regions that were written.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct SplitDocument<'a> {
    /// 1.
    version: u32,
    /// The written folder, as given.
    folder: String,
    /// Id of the manifest: the SHA-256 of its bytes.
    manifest: String,
    /// Name of the map.
    map: &'a str,
    /// Id of the profile, as sealed queries carry it.
    profile: String,
    /// Number of images of the whole map.
    images: u64,
    /// Number of points of the whole map.
    points: u64,
    /// Bytes of all objects: regions, index and profile.
    bytes: u64,
    /// Bytes of the whole map's file.
    map_bytes: u64,
    /// Bytes of the index.
    index_bytes: u64,
    /// The regions.
    regions: Vec<RegionDocument>,
}

/// A region.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct RegionDocument {
    /// SHA-256 of its map file, which is its name in `objects`.
    sha256: String,
    /// Bytes of its map file.
    bytes: u64,
    /// Number of its images.
    images: u64,
    /// Number of images in its core, which are in no other core.
    core_images: u64,
    /// Number of its points.
    points: u64,
    /// Mean of the camera centres of its core, map units.
    center: [f64; 3],
    /// Distance of the farthest camera centre of its core from `center`, map units.
    radius: f64,
}

impl RegionDocument {
    fn of(region: &RegionEntry) -> Self {
        Self {
            sha256: region.sha256.to_string(),
            bytes: region.bytes,
            images: region.images,
            core_images: region.core_images,
            points: region.points,
            center: region.center,
            radius: region.radius,
        }
    }
}

pub(super) fn run(args: &SplitArgs, ui: &Ui) -> Outcome {
    let map = MapFile::open(&args.map)?;
    let name = args.name()?;
    let stages = Stages::new(ui);
    let options = SplitOptions::default().with_images(args.images as usize).with_overlap(args.overlap);
    let regions = cut(&map, &options)?;
    let writer = FolderWriter::begin(&map, &name, &args.out)?;
    stages.start("Writing regions", regions.len());
    let mut entries = Vec::with_capacity(regions.len());
    for region in &regions {
        entries.push(writer.region(region)?);
        stages.advance(1);
    }
    stages.finish();
    let manifest = writer.finish(&regions, entries)?;
    let document = document(&manifest, &map, &args.out);
    if args.json {
        ui.json(&document)?;
    } else {
        ui.print(describe(&document));
    }
    Ok(Exit::Success)
}

impl SplitArgs {
    fn name(&self) -> Result<String, Failure> {
        let of_file = || self.map.file_stem().and_then(|stem| stem.to_str()).map(str::to_owned);
        let name = self.name.clone().or_else(of_file).unwrap_or_default();
        if veiloc_map::is_map_name(&name) {
            return Ok(name);
        }
        let wrong = format!("{name:?} is not a valid map name");
        Err(Failure::with_help(wrong, "give 1 to 64 letters, digits, `-`, `_` and `.` with --name"))
    }
}

fn document<'a>(manifest: &'a Manifest, map: &MapFile, folder: &Path) -> SplitDocument<'a> {
    SplitDocument {
        version: 1,
        folder: folder.display().to_string(),
        manifest: manifest.id().to_string(),
        map: &manifest.map,
        profile: map.profile().id().to_string(),
        images: manifest.images,
        points: manifest.points,
        bytes: manifest.byte_count(),
        map_bytes: map.byte_count(),
        index_bytes: manifest.index.bytes,
        regions: manifest.regions.iter().map(RegionDocument::of).collect(),
    }
}

fn describe(document: &SplitDocument<'_>) -> String {
    let mb = |bytes: u64| bytes as f64 / 1e6;
    let images_in_regions: u64 = document.regions.iter().map(|region| region.images).sum();
    let mut text = format!(
        "{}: {} regions of {}, manifest {}\n  images      {}, each in {:.2} regions on average\n  bytes       {:.1} MB, of the whole map {:.1} MB; of the index {:.1} MB\n",
        document.folder,
        document.regions.len(),
        document.map,
        document.manifest,
        document.images,
        images_in_regions as f64 / document.images as f64,
        mb(document.bytes),
        mb(document.map_bytes),
        mb(document.index_bytes),
    );
    for region in document.regions.iter().take(SHOWN) {
        let [x, y, z] = region.center;
        text.extend([format!(
            "  {}  {:>5} images, {:>5} in the core, {:>8} points, {:>7.1} MB, within {} of ({}, {}, {})\n",
            &region.sha256[..12],
            region.images,
            region.core_images,
            region.points,
            mb(region.bytes),
            significant(region.radius),
            significant(x),
            significant(y),
            significant(z),
        )]);
    }
    let more = document.regions.len().saturating_sub(SHOWN);
    if more > 0 {
        text.extend([format!("  and {more} more, listed in the manifest\n")]);
    }
    text
}

/// Maximum number of regions in the text output.
const SHOWN: usize = 20;
