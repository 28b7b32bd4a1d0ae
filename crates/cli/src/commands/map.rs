//! `veiloc map`: build, import, inspect and change maps.

use std::path::{Path, PathBuf};

use serde::Serialize;
use veiloc_map::colmap::{read_model, read_posed};
use veiloc_map::{MapFile, MapLock, MapModel, PosedImages};
use veiloc_mapping::{BadImage, BuildOptions, Doubt, Input, MappingError, OnBadImage, SkippedImages, Words};

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
    /// Take images out of a map, with their keypoints and the points that only they saw.
    Remove(RemoveArgs),
    /// Write what a device needs to seal queries for a map; it holds no map data.
    Profile(ProfileArgs),
}

/// What is extracted from an image, and what devices are asked to do.
#[derive(clap::Args)]
pub(crate) struct ExtractionArgs {
    /// Kind of features.
    #[arg(long, default_value = "sift", value_name = "KIND")]
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
        options.settings.extraction.max_keypoints = self.max_keypoints;
        options.device.max_keypoints = self.query_keypoints;
        options.features.clone_from(&self.features);
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
    /// Folder of a COLMAP model with cameras and poses, text or binary. Points are not needed; where there are some,
    /// they help to find images that show the same.
    #[arg(long, value_name = "DIR")]
    posed: PathBuf,
    /// Folder of the images.
    #[arg(long, value_name = "DIR")]
    images: PathBuf,
    /// Names of the images to use, one a line. Default: every image of the model.
    #[arg(long, value_name = "FILE")]
    list: Option<PathBuf>,
    #[command(flatten)]
    bad: BadArgs,
}

/// What to do about images that cannot be used.
#[derive(clap::Args)]
struct BadArgs {
    /// Leave out images that are missing, unreadable or not of their camera's size, and say which. Default: refuse.
    #[arg(long)]
    skip_bad: bool,
}

impl BadArgs {
    const fn on_bad_image(&self) -> OnBadImage {
        if self.skip_bad { OnBadImage::Skip } else { OnBadImage::Refuse }
    }
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
    bad: BadArgs,
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
    /// List the images too: name, keypoints, how many of them see a point, camera.
    #[arg(long)]
    images: bool,
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

/// Take images out of a map, with their keypoints and the points that only they saw.
///
/// The vocabulary stays, so that queries sealed for the map still fit. Its words are averages of descriptors of many
/// images, also of those that leave. With --retrain it is learned again from the images that stay: then no descriptor of
/// the others has a share in it, but the profile is another one, and devices must fetch it again.
#[derive(clap::Args)]
pub(crate) struct RemoveArgs {
    /// The map.
    map: PathBuf,
    /// Names of the images.
    #[arg(required = true, value_name = "NAME")]
    names: Vec<String>,
    /// Learn the vocabulary again from the images that stay; devices must then fetch the profile again.
    #[arg(long)]
    retrain: bool,
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
        Command::Info(args) => {
            Told { list: args.images, json: args.json, ..Told::default() }.info(&args.map, ui)
        }
        Command::Add(args) => add(args, ui),
        Command::Remove(args) => remove(args, ui),
        Command::Profile(args) => profile(args, ui),
    }
}

fn build(args: &BuildArgs, ui: &Ui) -> Outcome {
    let given = args.posed.read()?;
    let options = args.extraction.options();
    let (model, report) =
        veiloc_mapping::build(&given.input(), &options, &Stages::new(ui)).map_err(with_skip_bad)?;
    veiloc_map::write(&model, &args.written.out)?;
    let told =
        Told { json: args.written.json, skipped: report.skipped, doubts: report.doubts, ..Told::default() };
    told.info(&args.written.out, ui)
}

fn import(args: &ImportArgs, ui: &Ui) -> Outcome {
    let colmap = read_model(&args.model)?;
    let options = args.extraction.options();
    let posed = PosedImages::from(&colmap);
    let input = Input::new(&posed, &args.images).on_bad_image(args.bad.on_bad_image());
    let (model, report) =
        veiloc_mapping::import(&colmap, &input, &options, &Stages::new(ui)).map_err(with_skip_bad)?;
    ui.say(&report);
    veiloc_map::write(&model, &args.written.out)?;
    let told =
        Told { json: args.written.json, skipped: report.skipped, doubts: report.doubts, ..Told::default() };
    told.info(&args.written.out, ui)
}

fn add(args: &AddArgs, ui: &Ui) -> Outcome {
    let given = args.posed.read()?;
    let change = Change::begin(&args.map, args.out.as_deref(), ui)?;
    let mut model = change.read()?;
    let report = veiloc_mapping::add(&mut model, &given.input(), &Stages::new(ui)).map_err(with_skip_bad)?;
    change.write(&model)?;
    let told = Told { json: args.json, skipped: report.skipped, doubts: report.doubts, ..Told::default() };
    told.info(change.out, ui)
}

fn remove(args: &RemoveArgs, ui: &Ui) -> Outcome {
    let change = Change::begin(&args.map, args.out.as_deref(), ui)?;
    let mut model = change.read()?;
    let words = if args.retrain { Words::Retrain } else { Words::Keep };
    let profile = model.profile.id();
    veiloc_mapping::remove(&mut model, &args.names, words, &Stages::new(ui))?;
    change.write(&model)?;
    ui.say(match words {
        Words::Keep => {
            "What is left of the images: their share in the words of the vocabulary, which are averages of descriptors \
             of many images and are published in the profile. --retrain learns them again without these images. Copies \
             and backups of the old map hold the images' keypoints still."
        }
        Words::Retrain if model.profile.id() == profile => {
            "The profile is as it was: nothing in it was learned from the images. Copies and backups of the old map hold \
             the images' keypoints still."
        }
        Words::Retrain => {
            "The vocabulary was learned again without the images, so the map has a new profile: publish it, and have \
             devices fetch it; queries sealed with the old one are refused. Copies and backups of the old map hold the \
             images' keypoints still."
        }
    });
    Told { json: args.json, ..Told::default() }.info(change.out, ui)
}

/// A map that is being changed: nobody else changes it from the moment it is read until it is written.
struct Change<'a> {
    map: &'a Path,
    out: &'a Path,
    lock: MapLock,
}

impl<'a> Change<'a> {
    /// Waits for whoever changes the map, and says so.
    fn begin(map: &'a Path, out: Option<&'a Path>, ui: &Ui) -> Result<Self, Failure> {
        let out = out.unwrap_or(map);
        let lock = if let Some(lock) = MapLock::try_acquire(out)? {
            lock
        } else {
            ui.say(format!("{}: waiting for another program that changes it", out.display()));
            MapLock::acquire(out)?
        };
        Ok(Self { map, out, lock })
    }

    fn read(&self) -> Result<MapModel, Failure> {
        Ok(MapFile::open(self.map)?.to_model())
    }

    fn write(&self, model: &MapModel) -> Result<(), Failure> {
        Ok(self.lock.write(model)?)
    }
}

/// The library names what is bad; how to leave it out, the program says.
fn with_skip_bad(error: MappingError) -> Failure {
    match error {
        MappingError::BadImages(_) => Failure::with_help(
            error,
            "mend these, take them from the list, or leave them out with --skip-bad",
        ),
        error => error.into(),
    }
}

fn profile(args: &ProfileArgs, ui: &Ui) -> Outcome {
    let map = MapFile::open(&args.map)?;
    let bytes = map.profile().encode();
    files::write(&args.out, &bytes)?;
    ui.say(format!("{}: profile {}, {} bytes", args.out.display(), map.profile().id(), bytes.len()));
    Ok(Exit::Success)
}

/// What [`PosedArgs`] name, read.
struct Posed<'a> {
    images: PosedImages,
    names: Option<Vec<String>>,
    args: &'a PosedArgs,
}

impl PosedArgs {
    fn read(&self) -> Result<Posed<'_>, Failure> {
        let images = read_posed(&self.posed)?;
        let names = self.list.as_deref().map(files::read_list).transpose()?;
        Ok(Posed { images, names, args: self })
    }
}

impl Posed<'_> {
    fn input(&self) -> Input<'_> {
        let input = Input::new(&self.images, &self.args.images).on_bad_image(self.args.bad.on_bad_image());
        match &self.names {
            Some(names) => input.with_names(names),
            None => input,
        }
    }
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
    warnings: Vec<Warning>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    skipped: Vec<Skipped>,
    #[serde(skip_serializing_if = "Option::is_none")]
    image_list: Option<Vec<ImageInfo>>,
}

/// Why the map may be good for nothing.
#[derive(Serialize)]
struct Warning {
    name: &'static str,
    message: String,
}

/// An image that was left out.
#[derive(Serialize)]
struct Skipped {
    name: String,
    reason: String,
}

/// An image of the map.
#[derive(Serialize)]
struct ImageInfo {
    name: String,
    keypoints: usize,
    points_seen: usize,
    camera: String,
}

/// How facts about a map are told, and what the command that made it knows beyond them.
#[derive(Default)]
struct Told {
    json: bool,
    list: bool,
    skipped: Vec<BadImage>,
    doubts: Vec<Doubt>,
}

impl Told {
    fn info(self, path: &Path, ui: &Ui) -> Outcome {
        let map = MapFile::open(path)?;
        let images: Vec<ImageInfo> = map
            .images()
            .map(|image| ImageInfo {
                name: image.name().to_owned(),
                keypoints: image.keypoints().len(),
                points_seen: (0..image.keypoints().len()).filter(|k| image.point_of(*k).is_some()).count(),
                camera: image.camera().to_string(),
            })
            .collect();
        let mut doubts = self.doubts;
        let seen: Vec<usize> = images.iter().map(|i| i.points_seen).collect();
        for doubt in Doubt::of_counts(map.point_count(), &seen) {
            if !doubts.contains(&doubt) {
                doubts.push(doubt);
            }
        }
        let warning = |d: &Doubt| Warning { name: d.name(), message: d.to_string() };
        let skipped = |bad: &BadImage| Skipped { name: bad.name.clone(), reason: bad.reason.to_string() };
        let info = Info {
            warnings: doubts.iter().map(warning).collect(),
            skipped: self.skipped.iter().map(skipped).collect(),
            image_list: self.list.then_some(images),
            ..facts(&map, path)
        };
        if !self.skipped.is_empty() {
            ui.say(SkippedImages(self.skipped));
        }
        for warning in &info.warnings {
            ui.say(format!("warning: {}", warning.message));
        }
        if self.json {
            ui.json(&info)?;
        } else {
            ui.print(describe(&info));
        }
        Ok(Exit::Success)
    }
}

fn facts(map: &MapFile, path: &Path) -> Info {
    let bytes = map.byte_count() as u64;
    let points = map.point_count();
    let per_point = |total: f64| if points == 0 { 0.0 } else { total / points as f64 };
    let observations: usize = (0..points).map(|i| map.track_length(veiloc_map::PointId(i as u32))).sum();
    let error: f64 = (0..points).map(|i| map.reprojection_error(veiloc_map::PointId(i as u32))).sum();
    Info {
        version: 1,
        file: path.display().to_string(),
        bytes,
        format_version: map.format_version(),
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
        warnings: Vec::new(),
        skipped: Vec::new(),
        image_list: None,
    }
}

fn describe(info: &Info) -> String {
    let mut text = format!(
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
    );
    for image in info.image_list.iter().flatten() {
        let ImageInfo { name, keypoints, points_seen, camera } = image;
        let name = printable(name);
        text.extend([format!("{points_seen:>7} of {keypoints:>6} keypoints see points  {camera}  {name}\n")]);
    }
    text
}

/// A name as it is, but for characters that would steer a terminal.
fn printable(name: &str) -> String {
    let shown = |c: char| if c.is_control() { c.escape_default().to_string() } else { c.to_string() };
    name.chars().map(shown).collect()
}
