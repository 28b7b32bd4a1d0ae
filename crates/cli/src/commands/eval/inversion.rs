//! `veiloc eval inversion`: the paper's Tables 2 and 7: similarity of images that are reconstructed from attack results.

use std::path::{Path, PathBuf};

use veiloc_datasets::problem_files::{KeypointImage, keypoints_of_images, read_keypoints};
use veiloc_evaluation::attack_evaluation::inversion::{
    Classifier, Detector, ImageMetrics, InversionEvaluation, InversionNetwork, PerceptualDistance,
    evaluate_inversion, evaluation_table,
};
use veiloc_evaluation::attack_evaluation::{
    Attack, AttackEvaluation, MeasuredKeypoints, PrivateRegion, ServerKnowledge,
};
use veiloc_evaluation::report::inversion_page;
use veiloc_protocol::{ExtractionLimits, Scheme};

use crate::args::feature_args::ImageFeatureArgs;
use crate::args::json_args::JsonArgs;
use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::files;
use crate::output::items;
use crate::output::lists;
use crate::output::stages::Stages;
use crate::output::targets::OutFile;
use crate::output::ui::Ui;

use super::html;

/// Reconstruct images from recovered keypoints under every scheme, and compare them with the originals.
///
/// The paper's Tables 2 and 7, and more. Each image's keypoints are obfuscated under each scheme, attacked, and passed to an
/// image inversion network (research/train). The result is compared with the original on the network's grid: PSNR,
/// SSIM, ST-LPIPS, the objects that a detector still finds, and whether a classifier still recognises the content. Use
/// images that the network was not trained on.
#[derive(clap::Args)]
#[command(after_long_help = ATTACKS)]
pub(crate) struct Args {
    /// Images (JPEG, PNG, WebP, HEIC), or folders with all images in them and their sub-folders.
    #[arg(required = true, value_name = "IMAGE|FOLDER")]
    images: Vec<PathBuf>,
    /// Names of the images to use, one per line, relative to the one given folder.
    #[arg(long, value_name = "FILE")]
    list: Option<PathBuf>,
    /// Use only N of the images, evenly spaced. Default: all.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    limit: Option<u32>,
    /// Description (.toml) of the image inversion network, as exported by research/train.
    #[arg(long, value_name = "FILE")]
    network: PathBuf,
    /// Schemes, in the order of the table. Default: all.
    #[arg(long, value_delimiter = ',', value_name = "SCHEME,…", value_parser = Scheme::of_tables)]
    schemes: Vec<Scheme>,
    /// Attacks with true neighbours, as in `veiloc attack`; `graph` takes up to a minute an image.
    #[arg(long, value_delimiter = ',', default_value = "closed-form,graph", value_name = "ATTACK,…")]
    attacks: Vec<Attack>,
    /// Keypoints of other scenes, as written by `eval keypoints`: the attacker learns neighbours from them.
    #[arg(long, value_name = "FILE", num_args = 1..)]
    train: Vec<PathBuf>,
    /// Descriptions (.toml) of position networks, at most one per scheme.
    #[arg(long, value_name = "FILE", num_args = 1..)]
    positions: Vec<PathBuf>,
    /// Images of the scene's map, relative to the one given folder, one per line: the images that a server can compare
    /// with.
    #[arg(long, value_name = "FILE")]
    map_list: Option<PathBuf>,
    /// Neighbours per keypoint.
    #[arg(short, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=1000))]
    k: u32,
    /// Seed of every random choice.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Maximum number of keypoints per image; the strongest are used.
    #[arg(long, default_value_t = 1024, value_name = "N", value_parser = clap::value_parser!(u32).range(64..=65536))]
    max_keypoints: u32,
    /// Keypoints of the listed images with their descriptors, as `eval problems --keypoints` writes them. Default: they
    /// are extracted.
    #[arg(long, value_name = "FILE", requires = "list")]
    keypoints: Option<PathBuf>,
    /// Matches of these keypoints with a map (`eval problems`): the attacker is also a server that has localized the
    /// images, and attacks the keypoints that its map does not explain.
    #[arg(long, value_name = "PROBLEMS", requires = "keypoints")]
    server_matches: Option<PathBuf>,
    /// With --server-matches: the region that is black in a mask of each image (`door/3.jpg.png` for `door/3.jpg`) is not
    /// in the map, as a person is not. Default: no such region.
    #[arg(long, value_name = "DIR", requires = "server_matches")]
    private_masks: Option<PathBuf>,
    #[command(flatten)]
    features: ImageFeatureArgs,
    /// ST-LPIPS as an ONNX network, made by `scripts/export_onnx.py`.
    #[arg(long, value_name = "FILE")]
    perceptual: Option<PathBuf>,
    /// Classifier of the ImageNet classes as an ONNX network, made by `scripts/export_onnx.py` from EfficientNet-Lite0.
    /// The class of an image is the synset in the name of its file or folder (`n01440764_tench.jpg`), or else the
    /// classifier's answer for the original.
    #[arg(long, value_name = "FILE")]
    classifier: Option<PathBuf>,
    /// Object detector, as in `seal --hide`; it counts objects.
    #[arg(long, value_name = "FILE")]
    detector: Option<PathBuf>,
    /// Minimum score of an object.
    #[arg(long, default_value_t = 0.25, value_name = "SCORE")]
    min_score: f32,
    /// Write a contact sheet as PNG: the original, then a column for each row of the table, with boxes around objects.
    #[arg(long, value_name = "FILE")]
    contact_sheet: Option<OutFile>,
    /// Number of images on the contact sheet and in the report.
    #[arg(long, default_value_t = 6, value_name = "N")]
    show: u32,
    /// Write a report into FILE: one HTML file without network access, with the table and the images of the contact
    /// sheets; everyone who gets the file gets these images. Default: no report.
    #[arg(long, value_name = "FILE")]
    report: Option<OutFile>,
    #[command(flatten)]
    json: JsonArgs,
}

const ATTACKS: &str = "\
Rows of the table:
  points, none          the true keypoints: the limit of the network
  guess                 prior-only baseline: the expected position on the single line
  closed-form, graph    attacks with true neighbours, which no real attacker has: the paper's, and a stronger one
  matched               what a server with --server-matches knows without an attack
  server-side, …        its attacks, with true neighbours: server-side and iterative (the paper's), occlusion
  realistic             the best of the attacks that --train, --positions and --map-list allow
  lines                 no attack: each descriptor spread over its line
  unordered, none       descriptors without positions
  none, none            no descriptor: the output of the network without input

Example: veiloc eval inversion images --list query.txt --map-list map.txt --network inversion.toml --contact-sheet sheet.png";

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    let extractor = args.features.device_extractor()?;
    let network = InversionNetwork::open(&args.network)?;
    let limits = ExtractionLimits { max_keypoints: args.max_keypoints, ..ExtractionLimits::default() };
    let metrics = metrics(args)?;
    let stages = Stages::new(ui);
    let map = match &args.map_list {
        Some(list) => keypoints_of_images(&listed(&args.images, list)?, extractor.as_ref(), limits, &stages)?,
        None => Vec::new(),
    };
    let all = match &args.list {
        Some(list) => listed(&args.images, list)?,
        None => items::expand_readable(&args.images, ui)?.into_iter().map(|item| item.path).collect(),
    };
    let known = args.keypoints.as_deref().map(|file| known_keypoints(file, args)).transpose()?;
    let most = args.limit.map_or(all.len(), |most| (most as usize).min(all.len()));
    let chosen = |i: usize| i * all.len() / most;
    let evaluation = InversionEvaluation {
        images: (0..most).map(|i| all[chosen(i)].clone()).collect(),
        keypoints: known.map_or_else(Vec::new, |known| (0..most).map(|i| known[chosen(i)].clone()).collect()),
        server: args.server_matches.as_ref().map(|problems| ServerKnowledge {
            problems: vec![problems.clone()],
            map_problems: Vec::new(),
            private: args.private_masks.clone().map(PrivateRegion::Masks),
            rotated: 0.0,
            measured: MeasuredKeypoints::Hidden,
        }),
        attack: AttackEvaluation {
            schemes: if args.schemes.is_empty() { Scheme::ALL.to_vec() } else { args.schemes.clone() },
            attacks: args.attacks.clone(),
            positions: args.positions.clone(),
            k: args.k as usize,
            seed: args.seed,
            ..AttackEvaluation::default()
        },
        train: args.train.clone(),
        map,
        network: &network,
        extractor: extractor.as_ref(),
        limits,
        shown: args.show as usize,
    };
    let (document, sheets) = evaluate_inversion(&evaluation, &metrics, &stages)?;
    args.json.print(&evaluation_table(&document), &document, ui)?;
    if let (Some(path), Some(sheet)) = (&args.contact_sheet, sheets.first())
        && let Some(png) = sheet.png()?
    {
        files::write(path, &png)?;
        ui.info(format!("{}: {}", path.display(), sheet.columns.join(" | ")));
    }
    if let Some(path) = &args.report {
        let page = inversion_page(&document, &sheets, &html::facts(Some(args.seed)));
        html::write_page(path, &page, ui)?;
    }
    Ok(Exit::Success)
}

/// The keypoints of the listed images, in the order of the list.
fn known_keypoints(file: &Path, args: &Args) -> Result<Vec<KeypointImage>, Failure> {
    let images = read_keypoints(file)?;
    let listed = args.list.as_deref().map(lists::read_with_cameras).transpose()?.unwrap_or_default();
    let of = |name: &str| {
        let found = images.iter().find(|image| image.name == name).cloned();
        found.ok_or_else(|| {
            Failure::with_help(
                format!("{}: it has no keypoints of {name}", file.display()),
                "write them with `eval problems --query-list LIST --keypoints FILE` for the same list",
            )
        })
    };
    listed.iter().map(|listed| of(&listed.name)).collect()
}

fn listed(folders: &[PathBuf], list: &Path) -> Result<Vec<PathBuf>, Failure> {
    let folder = lists::single_folder(folders)?;
    let listed = lists::read_with_cameras(list)?;
    let items = items::files_of_list(folder, listed.iter().map(|l| l.name.as_str()));
    items::refuse_bad(&items)?;
    Ok(items.into_iter().map(|item| item.path).collect())
}

fn metrics(args: &Args) -> Result<ImageMetrics, Failure> {
    let perceptual = args.perceptual.as_deref().map(PerceptualDistance::open).transpose()?;
    let classifier = args.classifier.as_deref().map(Classifier::open).transpose()?;
    let detector = args.detector.as_deref().map(Detector::open).transpose()?;
    let detector = detector.map(|detector| (detector, args.min_score));
    Ok(ImageMetrics { perceptual, classifier, detector })
}
