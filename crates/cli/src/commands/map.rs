//! `veiloc map`: build, import, inspect and change maps.

use std::path::{Path, PathBuf};

use serde::Serialize;
use veiloc_map::{MapFile, MapModel};
use veiloc_mapping::BuildOptions;

use crate::exit::{Exit, Failure, Outcome};
use crate::files;
use crate::stages::Stages;
use crate::ui::Ui;

/// What to do with a map.
#[derive(clap::Subcommand)]
pub(crate) enum Command {
    /// Build a map from images whose poses are known.
    Build(BuildArgs),
    /// Make a map of a complete COLMAP model: its points and observations are kept.
    Import(ImportArgs),
    /// Say what is in a map.
    Info(InfoArgs),
    /// Add images with known poses to a map, without building it again.
    Add(AddArgs),
    /// Take images out of a map, with the points that only they saw.
    Remove(RemoveArgs),
    /// Write what a device needs to seal queries for a map; it holds no map data.
    Profile(ProfileArgs),
}

/// What is extracted from an image, and what devices are asked to do.
#[derive(clap::Args)]
pub(crate) struct ExtractionArgs {
    /// Kind of features.
    #[arg(long, default_value = "sift", value_parser = ["sift"])]
    features: String,
    /// Keypoints of an image at most, the strongest.
    #[arg(long, default_value_t = 4096, value_name = "N", value_parser = clap::value_parser!(u32).range(64..=65536))]
    max_keypoints: u32,
    /// Keypoints devices are asked for at most, the strongest; it is published in the profile.
    #[arg(long, default_value_t = 2048, value_name = "N", value_parser = clap::value_parser!(u32).range(256..=4096))]
    query_keypoints: u32,
}

impl ExtractionArgs {
    /// The library's options.
    pub(crate) fn options(&self) -> BuildOptions {
        let mut options = BuildOptions::default();
        options.max_keypoints = self.max_keypoints as usize;
        options.device.max_keypoints = self.query_keypoints;
        options
    }
}

/// Where a new map goes, and how it is told.
#[derive(clap::Args)]
struct WrittenArgs {
    /// The map file to write.
    #[arg(long, short, value_name = "FILE")]
    out: PathBuf,
    /// Print facts about the map as JSON.
    #[arg(long)]
    json: bool,
}

/// Images with poses.
#[derive(clap::Args)]
struct PosedArgs {
    /// Folder of a COLMAP model with cameras and poses, text or binary; its points are not used.
    #[arg(long, value_name = "DIR")]
    posed: PathBuf,
    /// Folder of the images.
    #[arg(long, value_name = "DIR")]
    images: PathBuf,
    /// Names of the images to use, one a line. Default: every image of the model.
    #[arg(long, value_name = "FILE")]
    list: Option<PathBuf>,
}

/// Build a map from images whose poses are known.
///
/// Extracts features, matches images that see the same things, checks the matches against the known poses,
/// triangulates map points, and writes one file. An interrupted build leaves an older map as it was.
#[derive(clap::Args)]
pub(crate) struct BuildArgs {
    #[command(flatten)]
    posed: PosedArgs,
    #[command(flatten)]
    extraction: ExtractionArgs,
    #[command(flatten)]
    written: WrittenArgs,
}

/// Make a map of a complete COLMAP model: its points and observations are kept.
///
/// Descriptors are extracted from the images and joined to the model's points by position.
#[derive(clap::Args)]
pub(crate) struct ImportArgs {
    /// Folder of the COLMAP model, text or binary.
    #[arg(long, value_name = "DIR")]
    model: PathBuf,
    /// Folder of the images.
    #[arg(long, value_name = "DIR")]
    images: PathBuf,
    #[command(flatten)]
    extraction: ExtractionArgs,
    #[command(flatten)]
    written: WrittenArgs,
}

/// Say what is in a map.
#[derive(clap::Args)]
pub(crate) struct InfoArgs {
    /// The map.
    map: PathBuf,
    /// Print one JSON document to stdout.
    #[arg(long)]
    json: bool,
}

/// Add images with known poses to a map, without building it again.
#[derive(clap::Args)]
pub(crate) struct AddArgs {
    /// The map.
    map: PathBuf,
    #[command(flatten)]
    posed: PosedArgs,
    /// The map file to write. Default: the map itself.
    #[arg(long, short, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print facts about the map as JSON.
    #[arg(long)]
    json: bool,
}

/// Take images out of a map, with the points that only they saw.
#[derive(clap::Args)]
pub(crate) struct RemoveArgs {
    /// The map.
    map: PathBuf,
    /// Names of the images.
    #[arg(required = true, value_name = "NAME")]
    names: Vec<String>,
    /// The map file to write. Default: the map itself.
    #[arg(long, short, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print facts about the map as JSON.
    #[arg(long)]
    json: bool,
}

/// Write what a device needs to seal queries for a map; it holds no map data.
#[derive(clap::Args)]
pub(crate) struct ProfileArgs {
    /// The map.
    map: PathBuf,
    /// The profile file to write.
    #[arg(long, short, value_name = "FILE")]
    out: PathBuf,
}

pub(crate) fn run(command: &Command, ui: &Ui) -> Outcome {
    match command {
        Command::Build(args) => build(args, ui),
        Command::Import(args) => import(args, ui),
        Command::Info(args) => info(&args.map, args.json, ui),
        Command::Add(args) => add(args, ui),
        Command::Remove(args) => remove(args, ui),
        Command::Profile(args) => profile(args, ui),
    }
}

fn build(args: &BuildArgs, ui: &Ui) -> Outcome {
    let posed = veiloc_map::colmap::read_model(&args.posed.posed)?;
    let names = args.posed.names(&posed)?;
    let options = args.extraction.options();
    let model = veiloc_mapping::build(&posed, &args.posed.images, &names, &options, &Stages::new(ui))?;
    save(&model, &args.written.out, args.written.json, ui)
}

fn import(args: &ImportArgs, ui: &Ui) -> Outcome {
    let colmap = veiloc_map::colmap::read_model(&args.model)?;
    let options = args.extraction.options();
    let (model, report) = veiloc_mapping::import(&colmap, &args.images, &options, &Stages::new(ui))?;
    ui.say(report);
    save(&model, &args.written.out, args.written.json, ui)
}

fn add(args: &AddArgs, ui: &Ui) -> Outcome {
    let mut model = MapFile::open(&args.map)?.to_model();
    let posed = veiloc_map::colmap::read_model(&args.posed.posed)?;
    let names = args.posed.names(&posed)?;
    veiloc_mapping::add(&mut model, &posed, &args.posed.images, &names, &Stages::new(ui))?;
    save(&model, args.out.as_ref().unwrap_or(&args.map), args.json, ui)
}

fn remove(args: &RemoveArgs, ui: &Ui) -> Outcome {
    let mut model = MapFile::open(&args.map)?.to_model();
    veiloc_mapping::remove(&mut model, &args.names)?;
    save(&model, args.out.as_ref().unwrap_or(&args.map), args.json, ui)
}

fn profile(args: &ProfileArgs, ui: &Ui) -> Outcome {
    let map = MapFile::open(&args.map)?;
    let bytes = map.profile().encode();
    files::write(&args.out, &bytes)?;
    ui.say(format!("{}: profile {}, {} bytes", args.out.display(), map.profile().id(), bytes.len()));
    Ok(Exit::Success)
}

impl PosedArgs {
    fn names(&self, posed: &veiloc_map::colmap::ColmapModel) -> Result<Vec<String>, Failure> {
        match &self.list {
            Some(list) => files::read_list(list),
            None => Ok(posed.image_names()),
        }
    }
}

fn save(model: &MapModel, path: &Path, json: bool, ui: &Ui) -> Outcome {
    veiloc_map::write(model, path)?;
    info(path, json, ui)
}

#[derive(Serialize)]
struct Info {
    version: u32,
    file: String,
    bytes: u64,
    format_version: u32,
    images: usize,
    cameras: usize,
    keypoints: usize,
    points: usize,
    bytes_per_point: f64,
    mean_track_length: f64,
    mean_reprojection_error_px: f64,
    descriptors: String,
    global: String,
    profile: String,
}

fn info(path: &Path, json: bool, ui: &Ui) -> Outcome {
    let map = MapFile::open(path)?;
    let bytes = std::fs::metadata(path).map_or(0, |m| m.len());
    let points = map.point_count();
    let per_point = |total: f64| if points == 0 { 0.0 } else { total / points as f64 };
    let observations: usize = (0..points).map(|i| map.track_length(veiloc_map::PointId(i as u32))).sum();
    let error: f64 = (0..points).map(|i| map.reprojection_error(veiloc_map::PointId(i as u32))).sum();
    let info = Info {
        version: 1,
        file: path.display().to_string(),
        bytes,
        format_version: veiloc_map::FORMAT_VERSION,
        images: map.image_count(),
        cameras: map.camera_count(),
        keypoints: (0..map.image_count()).map(|i| map.image(i).keypoints().len()).sum(),
        points,
        bytes_per_point: per_point(bytes as f64),
        mean_track_length: per_point(observations as f64),
        mean_reprojection_error_px: per_point(error),
        descriptors: map.profile().descriptor_kind().name().to_owned(),
        global: map.profile().global_model().name().to_owned(),
        profile: map.profile().id().to_string(),
    };
    if json {
        ui.json(&info)?;
    } else {
        ui.print(describe(&info));
    }
    Ok(Exit::Success)
}

fn describe(info: &Info) -> String {
    format!(
        "{}: map format {}, {:.1} MB\n  images      {} with {} cameras, {} keypoints\n  points      {}, seen by {:.1} images each, mean reprojection error {:.2} px\n  a point     {:.0} bytes of the file\n  devices     {} features, global descriptors {}, profile {}\n",
        info.file,
        info.format_version,
        info.bytes as f64 / 1e6,
        info.images,
        info.cameras,
        info.keypoints,
        info.points,
        info.mean_track_length,
        info.mean_reprojection_error_px,
        info.bytes_per_point,
        info.descriptors,
        info.global,
        info.profile,
    )
}
