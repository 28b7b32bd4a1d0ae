//! `veiloc map`: build, import, inspect, change, compress, split, publish and export maps.

mod align;
mod compress;
mod export;
mod frame;
pub(crate) mod info;
mod merge;
#[cfg(feature = "cluster")]
pub(crate) mod publish;
mod self_test;
mod sfm;
pub(crate) mod split;
mod view;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::args::extraction_args::ExtractionArgs;
use crate::args::feature_args::MapFeatureArgs;
use crate::args::global_args::MapGlobalArgs;
use veiloc_map::colmap::read_model;
use veiloc_map::{GravityDirection, MapFile, MapLock, MapModel, PosedImages};
use veiloc_mapping::build_cache::FolderCache;
use veiloc_mapping::importers::hloc::{check_pair_name, read_pairs, write_pairs};
use veiloc_mapping::{Input, MappingError, NameIndex, OnBadImage, VocabularyUpdate};

use self::frame::FrameArgs;
use self::info::InfoOutput;
use self::self_test::FinishArgs;
use self::sfm::{SfmArgs, SfmModels};
use crate::commands::frame_check::{FrameCheckArgs, REMEDY_OF_LOOK_ALIKES};
use crate::commands::posed::{read_posed_input, warn_of};
use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::files;
use crate::output::lists;
use crate::output::stages::Stages;
use crate::output::targets::{OutFile, OutFolder};
use crate::output::ui::Ui;

/// What to do with a map.
#[derive(clap::Subcommand)]
pub(crate) enum Command {
    /// Build a map from images, with or without known poses.
    Build(BuildArgs),
    /// Build a map from a complete COLMAP model, with its points and observations.
    Import(ImportArgs),
    /// Print facts about a map.
    Info(InfoArgs),
    /// Write a page that shows a map in 3D, its weak parts, and what to do about them.
    View(view::ViewArgs),
    /// Add images with known poses to a map, without rebuilding it.
    Add(AddArgs),
    /// Transform a map to metres, north and gravity, or to the frame of another map.
    Align(align::AlignArgs),
    /// Merge two maps that show a common part.
    Merge(merge::MergeArgs),
    /// Remove images from a map, with their keypoints and the points that only they observe.
    Remove(RemoveArgs),
    /// Write the profile that a device needs to seal queries for a map; it contains no map data.
    Profile(ProfileArgs),
    /// Compress a map: a tenth of the bytes with almost no loss.
    Compress(compress::CompressArgs),
    /// Split a map into regions, for maps that exceed one machine.
    Split(split::SplitArgs),
    /// Publish the regions of a map to object storage, for services.
    #[cfg(feature = "cluster")]
    Publish(publish::PublishArgs),
    /// Publish the regions of a map (needs the cargo feature `cluster`).
    #[cfg(not(feature = "cluster"))]
    Publish(crate::commands::missing_feature::Args),
    /// Fetch and verify the regions of a published map.
    #[cfg(feature = "cluster")]
    Fetch(publish::FetchArgs),
    /// Fetch the regions of a published map (needs the cargo feature `cluster`).
    #[cfg(not(feature = "cluster"))]
    Fetch(crate::commands::missing_feature::Args),
    /// List the published versions of a map, return to an older one, or remove old ones.
    #[cfg(feature = "cluster")]
    Versions(publish::VersionsArgs),
    /// List the published versions of a map (needs the cargo feature `cluster`).
    #[cfg(not(feature = "cluster"))]
    Versions(crate::commands::missing_feature::Args),
    /// Export a map for other programs: as a COLMAP model, its points as a PLY file, or both.
    Export(export::ExportArgs),
}

/// Gravity of a new map, its output file, and the output format.
#[derive(clap::Args)]
struct OutputArgs {
    /// Direction of gravity (down) in the axes of the map: a vector of any length, or an axis (x, -x, y, -y, z, -z). It
    /// is used with the gravity of queries (`seal --gravity`). Default: the direction that the format of `--posed` defines (AR
    /// captures, RealityCapture, OpenSfM with a reference); otherwise not known, and the gravity of queries is not used.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    down: Option<GravityDirection>,
    /// The poses are in metres: lengths in messages and reports are then in m instead of units. Default: if the format of
    /// `--posed` defines it (AR captures, EuRoC, OpenSfM with a reference); otherwise not known.
    #[arg(long)]
    metres: bool,
    /// The map file to write.
    #[arg(long, short, value_name = "FILE")]
    out: OutFile,
    /// Print facts about the map as JSON.
    #[arg(long)]
    json: bool,
}

/// Images with known poses.
#[derive(clap::Args)]
struct PosedArgs {
    /// Images with cameras and poses: a COLMAP model (also in sparse/0), or a file or folder of nerfstudio
    /// (transforms.json), Bundler, VisualSFM (.nvm), OpenSfM, Metashape (XML), RealityCapture (CSV), kapture, Polycam,
    /// Record3D or 3D Scanner App, or a trajectory of TUM, KITTI or EuRoC. The format is recognized and printed. Points are
    /// optional; if present, they help to find image pairs.
    #[arg(long, value_name = "PATH")]
    posed: Option<PathBuf>,
    /// Folder of the images. Without poses also a video: frames that moved by a few percent of the image, the sharpest of each
    /// step, are taken by ffmpeg (of the PATH, or of the Python package imageio-ffmpeg); it needs Python with NumPy.
    #[arg(long, value_name = "DIR|VIDEO")]
    images: PathBuf,
    /// Names of the images to use, one per line. Default: every image with a pose, or, without poses, every JPEG and PNG
    /// file of the folder.
    #[arg(long, value_name = "FILE")]
    list: Option<PathBuf>,
    #[command(flatten)]
    bad: BadImageArgs,
}

/// Handling of unusable images.
#[derive(clap::Args)]
struct BadImageArgs {
    /// Leave out images that are missing, unreadable or not of their camera's size, and name them. Default: refuse.
    #[arg(long)]
    skip_bad: bool,
}

impl BadImageArgs {
    const fn on_bad_image(&self) -> OnBadImage {
        if self.skip_bad { OnBadImage::Skip } else { OnBadImage::Refuse }
    }
}

/// Build a map from images, with or without known poses.
///
/// Poses are those of --posed, or else structure from motion computes them, by pycolmap or COLMAP: the map then has no metric
/// scale, and its work folder (--work, or beside the map) keeps what it computed, so that an interrupted build continues.
///
/// Extracts features, matches overlapping images, checks the matches against the known poses, triangulates map points,
/// localizes some of the map's own images as a self-test, and writes one file. A group of images whose poses are in
/// another frame than the rest is refused, or its poses are transformed with --align. An existing map stays unchanged if the
/// build is interrupted, or if nothing can be localized in the new map.
#[derive(clap::Args)]
pub(crate) struct BuildArgs {
    #[command(flatten)]
    posed: PosedArgs,
    #[command(flatten)]
    sfm: SfmArgs,
    #[command(flatten)]
    extraction: ExtractionArgs,
    #[command(flatten)]
    finish: FinishArgs,
    #[command(flatten)]
    pairs: PairArgs,
    #[command(flatten)]
    frame: FrameArgs,
    /// Folder for features and matches. An interrupted build, or a build with more images, computes only what is
    /// missing. It contains the same data on the images as the map: protect it in the same way. Default: nothing is
    /// stored.
    #[arg(long, value_name = "DIR")]
    work: Option<OutFolder>,
    #[command(flatten)]
    written: OutputArgs,
}

/// Selection of the image pairs to match.
#[derive(clap::Args)]
struct PairArgs {
    /// Match these image pairs and no others: two names per line, as in hloc's lists. Default: pairs that probably
    /// overlap, by poses and points.
    #[arg(long, value_name = "FILE")]
    pairs: Option<PathBuf>,
    /// Write the matched pairs as such a list. Default: not written.
    #[arg(long, value_name = "FILE")]
    out_pairs: Option<OutFile>,
}

/// Build a map from a complete COLMAP model, with its points and observations.
///
/// Descriptors are extracted from the images and assigned to the model's points by position.
#[derive(clap::Args)]
pub(crate) struct ImportArgs {
    /// Folder of the COLMAP model, text or binary.
    #[arg(long, value_name = "DIR")]
    model: PathBuf,
    /// Folder of the images.
    #[arg(long, value_name = "DIR")]
    images: PathBuf,
    #[command(flatten)]
    check: FrameCheckArgs,
    #[command(flatten)]
    bad: BadImageArgs,
    #[command(flatten)]
    extraction: ExtractionArgs,
    #[command(flatten)]
    finish: FinishArgs,
    #[command(flatten)]
    written: OutputArgs,
}

/// Print facts about a map.
#[derive(clap::Args)]
pub(crate) struct InfoArgs {
    /// The map.
    map: PathBuf,
    /// Also list the images: name, keypoints, keypoints with a map point, camera.
    #[arg(long)]
    images: bool,
    /// Print one JSON document to stdout.
    #[arg(long)]
    json: bool,
}

/// Add images with known poses to a map, without rebuilding it.
///
/// Before they join, the images are localized in the map. If their poses are in another frame than the map, the command
/// refuses them, or transforms them with --align.
#[derive(clap::Args)]
#[command(mut_arg("posed", |posed| posed.required(true)))]
pub(crate) struct AddArgs {
    /// The map.
    map: PathBuf,
    #[command(flatten)]
    posed: PosedArgs,
    #[command(flatten)]
    features: MapFeatureArgs,
    #[command(flatten)]
    global: MapGlobalArgs,
    /// Text before the names of the images in the map, for example `session-2/`: for a session whose files have the same
    /// names as images of the map. Default: none.
    #[arg(long, value_name = "TEXT", default_value = "", hide_default_value = true)]
    prefix: String,
    #[command(flatten)]
    frame: FrameArgs,
    #[command(flatten)]
    finish: FinishArgs,
    /// The map file to write. Default: the map itself.
    #[arg(long, short, value_name = "FILE")]
    out: Option<OutFile>,
    /// Print facts about the map as JSON.
    #[arg(long)]
    json: bool,
}

/// Remove images from a map, with their keypoints and the points that only they observe.
///
/// The vocabulary stays, so that queries sealed for the map remain valid. Its words are means of descriptors of many
/// images, including the removed ones. With --retrain it is trained again on the remaining images: then no removed
/// descriptor contributes to it, but the profile changes, and devices must fetch it again.
#[derive(clap::Args)]
pub(crate) struct RemoveArgs {
    /// The map.
    map: PathBuf,
    /// Names of the images.
    #[arg(required = true, value_name = "NAME")]
    names: Vec<String>,
    /// Train the vocabulary again on the remaining images; devices must then fetch the profile again.
    #[arg(long)]
    retrain: bool,
    #[command(flatten)]
    finish: FinishArgs,
    /// The map file to write. Default: the map itself.
    #[arg(long, short, value_name = "FILE")]
    out: Option<OutFile>,
    /// Print facts about the map as JSON.
    #[arg(long)]
    json: bool,
}

/// Write the profile that a device needs to seal queries for a map; it contains no map data.
#[derive(clap::Args)]
pub(crate) struct ProfileArgs {
    /// The map.
    map: PathBuf,
    /// The profile file to write.
    #[arg(long, short, value_name = "FILE")]
    out: OutFile,
}

pub(crate) fn run(command: &Command, ui: &Ui) -> Outcome {
    match command {
        Command::Build(args) => build(args, ui),
        Command::Import(args) => import(args, ui),
        Command::Info(args) => {
            InfoOutput { list: args.images, json: args.json, ..InfoOutput::default() }.print(&args.map, ui)
        }
        Command::Add(args) => add(args, ui),
        Command::View(args) => view::run(args, ui),
        Command::Align(args) => align::run(args, ui),
        Command::Merge(args) => merge::run(args, ui),
        Command::Remove(args) => remove(args, ui),
        Command::Profile(args) => profile(args, ui),
        Command::Compress(args) => compress::run(args, ui),
        Command::Split(args) => split::run(args, ui),
        #[cfg(feature = "cluster")]
        Command::Publish(args) => publish::publish(args, ui),
        #[cfg(feature = "cluster")]
        Command::Fetch(args) => publish::fetch(args, ui),
        #[cfg(feature = "cluster")]
        Command::Versions(args) => publish::versions(args, ui),
        #[cfg(not(feature = "cluster"))]
        Command::Publish(args) => crate::commands::missing_feature::run(args, "map publish", "cluster"),
        #[cfg(not(feature = "cluster"))]
        Command::Fetch(args) => crate::commands::missing_feature::run(args, "map fetch", "cluster"),
        #[cfg(not(feature = "cluster"))]
        Command::Versions(args) => crate::commands::missing_feature::run(args, "map versions", "cluster"),
        Command::Export(args) => export::run(args, ui),
    }
}

fn build(args: &BuildArgs, ui: &Ui) -> Outcome {
    if args.written.metres && args.posed.posed.is_none() {
        return Err(Failure::with_help(
            "--metres is for poses in metres, and structure from motion has no scale",
            "build the map without it, then transform it to metres with `veiloc map align`",
        ));
    }
    let mut others = Vec::new();
    let input = args.posed.read(ui, |names| {
        let (images, work, out) = (&args.posed.images, args.work.as_deref(), &args.written.out);
        let mut computed = args.sfm.models(images, names, work, out, ui)?;
        others = computed.models.split_off(1);
        Ok(computed)
    })?;
    let mut outcome = build_one(args, &input, &args.written.out, ui);
    for (number, images) in (2..).zip(others) {
        let folder = input.folder.clone();
        let part =
            PosedInput { images, folder, down: None, is_metric: false, names: None, args: &args.posed };
        // A part that is too small to be a map does not stop the others; the first failure is reported at the end.
        let built = build_one(args, &part, &numbered(&args.written.out, number), ui);
        outcome = outcome.and(built);
    }
    outcome
}

/// The file of another part: `hall-2.vmap` beside `hall.vmap`.
fn numbered(out: &Path, number: usize) -> PathBuf {
    let stem = out.file_stem().unwrap_or_default().to_string_lossy();
    let ending = out.extension().map_or_else(String::new, |ending| format!(".{}", ending.to_string_lossy()));
    out.with_file_name(format!("{stem}-{number}{ending}"))
}

fn build_one(args: &BuildArgs, posed_input: &PosedInput<'_>, out: &Path, ui: &Ui) -> Outcome {
    if args.pairs.out_pairs.is_some() {
        posed_input.names().try_for_each(check_pair_name)?;
    }
    let options = args.extraction.options()?;
    let pairs = args.pairs.pairs.as_deref().map(read_pairs).transpose()?;
    if let (Some(path), Some(pairs)) = (&args.pairs.pairs, &pairs) {
        warn_of_unknown(path, pairs, posed_input.names(), ui);
    }
    let input = match &pairs {
        Some(pairs) => posed_input.input().with_pairs(pairs),
        None => posed_input.input(),
    };
    let input = input.on_other_frame(args.frame.on_other_frame());
    let cache = args.work.as_deref().map(|folder| FolderCache::in_folder(folder, &options)).transpose()?;
    let input = match &cache {
        Some(cache) => input.with_cache(cache),
        None => input,
    };
    let (mut model, mut report) =
        veiloc_mapping::build(&input, &options, &Stages::new(ui)).map_err(with_remedy)?;
    if let Some(fault) = cache.and_then(|cache| cache.finish().err()) {
        ui.warn(format!(
            "the work folder is incomplete, and the missing part will be computed again: \
             {fault}"
        ));
    }
    model.down = args.written.down.or(posed_input.down);
    model.is_metric = args.written.metres || posed_input.is_metric;
    args.finish.finish(&mut model, &mut report.warnings, out, ui)?;
    veiloc_map::write(&model, out)?;
    let output = InfoOutput {
        json: args.written.json,
        skipped: report.skipped,
        warnings: report.warnings,
        frame: report.frame,
        ..InfoOutput::default()
    };
    let outcome = output.print(out, ui)?;
    if let Some(path) = &args.pairs.out_pairs {
        write_pairs(path, report.pairs.iter().map(|(a, b)| (a.as_str(), b.as_str())))?;
        ui.info(format!("{}: {} pairs", path.display(), report.pairs.len()));
    }
    Ok(outcome)
}

/// Warns of pairs that are not matched, because an image of theirs is not mapped.
fn warn_of_unknown<'a>(
    path: &Path,
    pairs: &'a [(String, String)],
    mapped: impl Iterator<Item = &'a str>,
    ui: &Ui,
) {
    const SHOWN: usize = 5;
    let mapped = NameIndex::new(mapped.map(|name| (name, ())));
    let is_unknown = |name: &&String| mapped.get(name).is_none();
    let unknown: BTreeSet<&String> = pairs.iter().flat_map(|(a, b)| [a, b]).filter(is_unknown).collect();
    if unknown.is_empty() {
        return;
    }
    let left_out = pairs.iter().filter(|(a, b)| unknown.contains(a) || unknown.contains(b)).count();
    let shown: Vec<&str> = unknown.iter().take(SHOWN).map(|name| name.as_str()).collect();
    let more = match unknown.len().saturating_sub(SHOWN) {
        0 => String::new(),
        n => format!(" and {n} more"),
    };
    ui.warn(format_args!(
        "warning: {}: {left_out} of {} pairs are left out, because these images are not mapped: {}{more}",
        path.display(),
        pairs.len(),
        shown.join(", ")
    ));
}

fn import(args: &ImportArgs, ui: &Ui) -> Outcome {
    let colmap = read_model(&args.model)?;
    warn_of(&args.model, colmap.remarks(), ui);
    let options = args.extraction.options()?;
    let posed = PosedImages::from(&colmap);
    let input = Input::new(&posed, &args.images)
        .on_bad_image(args.bad.on_bad_image())
        .on_other_frame(args.check.on_other_frame());
    let imported = veiloc_mapping::import(&colmap, &input, &options, &Stages::new(ui));
    let (mut model, mut report) = imported.map_err(|error| match error {
        MappingError::OtherFrame { .. } => Failure::with_help(error, frame::REMEDY_OF_IMPORT),
        error => with_remedy(error),
    })?;
    model.down = args.written.down;
    model.is_metric = args.written.metres;
    ui.info(&report);
    args.finish.finish(&mut model, &mut report.warnings, &args.written.out, ui)?;
    veiloc_map::write(&model, &args.written.out)?;
    let output = InfoOutput {
        json: args.written.json,
        frame: report.frame,
        skipped: report.skipped,
        warnings: report.warnings,
        ..InfoOutput::default()
    };
    output.print(&args.written.out, ui)
}

fn add(args: &AddArgs, ui: &Ui) -> Outcome {
    let posed_input = args.posed.read(ui, |_| Err(Failure::refused("give poses with --posed")))?;
    let edit = MapEdit::begin(&args.map, args.out.as_deref(), ui)?;
    let mut model = edit.read()?;
    let extractors = args.features.extractors(&model.profile)?;
    let global = args.global.extractor(&args.features.models(), &model.profile)?;
    let mut input = posed_input.input().with_extractors(&extractors).with_prefix(&args.prefix);
    input = input.on_other_frame(args.frame.on_other_frame());
    if let Some(global) = &global {
        input = input.with_global(global);
    }
    let mut report = veiloc_mapping::add(&mut model, &input, &Stages::new(ui)).map_err(with_remedy)?;
    args.finish.finish(&mut model, &mut report.warnings, edit.out, ui)?;
    edit.write(&model)?;
    let output = InfoOutput {
        json: args.json,
        frame: report.frame,
        skipped: report.skipped,
        warnings: report.warnings,
        ..InfoOutput::default()
    };
    output.print(edit.out, ui)
}

fn remove(args: &RemoveArgs, ui: &Ui) -> Outcome {
    let edit = MapEdit::begin(&args.map, args.out.as_deref(), ui)?;
    let mut model = edit.read()?;
    let words = if args.retrain { VocabularyUpdate::Retrain } else { VocabularyUpdate::Keep };
    let profile = model.profile.id();
    veiloc_mapping::remove(&mut model, &args.names, words, &Stages::new(ui))?;
    let mut warnings = Vec::new();
    args.finish.finish(&mut model, &mut warnings, edit.out, ui)?;
    edit.write(&model)?;
    ui.info(match words {
        VocabularyUpdate::Keep => {
            "The images still contribute to the words of the vocabulary, which are means of descriptors \
             of many images and are published in the profile. --retrain trains the vocabulary without \
             these images. Copies and backups of the old map still contain the images' keypoints."
        }
        VocabularyUpdate::Retrain if model.profile.id() == profile => {
            "The profile is unchanged: nothing in it was trained on the images. Copies and backups of the \
             old map still contain the images' keypoints."
        }
        VocabularyUpdate::Retrain => {
            "The vocabulary was trained again without the images, so the map has a new profile: publish \
             it, and let devices fetch it; queries sealed with the old one are refused. Copies and \
             backups of the old map still contain the images' keypoints."
        }
    });
    InfoOutput { json: args.json, warnings, ..InfoOutput::default() }.print(edit.out, ui)
}

/// A map that is being changed; it is locked against other writers from reading to writing.
struct MapEdit<'a> {
    map: &'a Path,
    out: &'a Path,
    lock: MapLock,
}

impl<'a> MapEdit<'a> {
    /// Waits for the lock of the map, and reports the wait.
    fn begin(map: &'a Path, out: Option<&'a Path>, ui: &Ui) -> Result<Self, Failure> {
        let out = out.unwrap_or(map);
        let lock = if let Some(lock) = MapLock::try_acquire(out)? {
            lock
        } else {
            ui.info(format!("{}: waiting for another program that changes it", out.display()));
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

/// Adds the flags that are the remedy, which the library does not know, to the error.
fn with_remedy(error: MappingError) -> Failure {
    match error {
        MappingError::BadImages(_) => Failure::with_help(
            error,
            "repair them, remove them from the list, or leave them out with --skip-bad",
        ),
        MappingError::OtherFrame { .. } => Failure::with_help(error, frame::REMEDY),
        MappingError::PosesDisagree { .. } => Failure::with_help(error, REMEDY_OF_LOOK_ALIKES),
        error => error.into(),
    }
}

fn profile(args: &ProfileArgs, ui: &Ui) -> Outcome {
    let map = MapFile::open(&args.map)?;
    let bytes = map.profile().encode();
    files::write(&args.out, &bytes)?;
    ui.info(format!("{}: profile {}, {} bytes", args.out.display(), map.profile().id(), bytes.len()));
    Ok(Exit::Success)
}

/// The data that [`PosedArgs`] names.
struct PosedInput<'a> {
    images: PosedImages,
    /// The folder of the images.
    folder: PathBuf,
    /// The direction of gravity that the format defines.
    down: Option<GravityDirection>,
    /// Whether the format defines that lengths are metres.
    is_metric: bool,
    names: Option<Vec<String>>,
    args: &'a PosedArgs,
}

impl PosedArgs {
    /// Reads the posed images; without `--posed` it computes them.
    fn read(
        &self,
        ui: &Ui,
        compute: impl FnOnce(Option<&[String]>) -> Result<SfmModels, Failure>,
    ) -> Result<PosedInput<'_>, Failure> {
        let names = self.list.as_deref().map(lists::read_list).transpose()?;
        let Some(posed) = &self.posed else {
            // Images without a pose were named; the others are used.
            let SfmModels { models, folder } = compute(names.as_deref())?;
            let images = models.into_iter().next().ok_or_else(|| Failure::refused("no image has a pose"))?;
            return Ok(PosedInput { images, folder, down: None, is_metric: false, names: None, args: self });
        };
        if self.images.is_file() {
            return Err(Failure::with_help(
                format!(
                    "{}: this is a file, and --posed needs the folder of its images",
                    self.images.display()
                ),
                "give the folder; leave out --posed to build a map of a video",
            ));
        }
        let read = read_posed_input(posed, &self.images, ui)?;
        let folder = self.images.clone();
        Ok(PosedInput {
            images: read.images,
            folder,
            down: read.down,
            is_metric: read.is_metric,
            names,
            args: self,
        })
    }
}

impl PosedInput<'_> {
    /// Names of the images to use.
    fn names(&self) -> impl Iterator<Item = &str> {
        let listed = self.names.iter().flatten().map(String::as_str);
        let of_model = self.images.images().iter().filter(|_| self.names.is_none());
        listed.chain(of_model.map(|image| image.name.as_str()))
    }

    fn input(&self) -> Input<'_> {
        let input = Input::new(&self.images, &self.folder).on_bad_image(self.args.bad.on_bad_image());
        match &self.names {
            Some(names) => input.with_names(names),
            None => input,
        }
    }
}
