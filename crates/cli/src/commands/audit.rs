//! `veiloc audit`: runs all attacks on the user's own images and writes a report.

mod inputs;

use std::path::{Path, PathBuf};
use std::time::Instant;

use veiloc_evaluation::attack_evaluation::{
    Attack, AttackEvaluation, Audit, AuditOptions, PROTECTION, attacks_table, run_audit, strongest_table,
};
use veiloc_evaluation::report::audit_page;
use veiloc_protocol::ExtractionLimits;

use crate::args::feature_args::ImageFeatureArgs;
use crate::args::json_args::JsonArgs;
use crate::commands::attack::AdversaryArgs;
use crate::commands::eval::html;
use crate::output::command_line::command_line;
use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::files;
use crate::output::stages::Stages;
use crate::output::targets::OutFileOrFolder;
use crate::output::ui::Ui;

use inputs::Inputs;

/// Attack the queries of your own images and write a report.
///
/// Reads images (and extracts their keypoints) or files of keypoints, obfuscates the keypoints as a device would, runs
/// every attack under every scheme, and writes one HTML page: the strongest attack on each scheme, all figures, true
/// and recovered keypoints drawn over the images. Nothing is sent over the network. The page contains the images and
/// the positions of their keypoints: keep it as private as the images.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Images (JPEG, PNG, WebP, HEIC), folders of images, and files of keypoints (.jsonl, .jsonl.gz). Keypoints are drawn over
    /// the image of the same name, which may be given or lie beside the file. `--synthetic N` without inputs attacks
    /// only the synthetic scene.
    #[arg(required_unless_present = "synthetic", value_name = "IMAGE|FOLDER|KEYPOINTS")]
    inputs: Vec<PathBuf>,
    /// Destination of the report: a file name that ends in `.html`, or a folder, which then gets `audit.html`.
    #[arg(short, long, default_value = "audit.html", value_name = "FILE|FOLDER")]
    out: OutFileOrFolder,
    /// Attack only the first N images of each folder or file.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..))]
    limit: u32,
    /// Draw the first N images; the figures cover all images.
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(0..=100))]
    show: u32,
    /// Leave the images out of the report. It still contains the positions of keypoints.
    #[arg(long)]
    no_images: bool,
    /// Leave out the paper's synthetic scene (Fig. 4).
    #[arg(long)]
    no_synthetic: bool,
    /// Number of keypoints of the synthetic scene.
    #[arg(long, value_name = "N", default_value_t = 1500, conflicts_with = "no_synthetic",
          value_parser = clap::value_parser!(u32).range(1..=100_000))]
    synthetic: u32,
    /// Attacks, as in `veiloc attack`. Default: static-camera (several sealed queries of one image); with several
    /// images that have descriptors also transfer, which uses the other images as a server's map; and, with the true
    /// neighbours from an oracle, closed-form, closed-form-informed and graph.
    #[arg(long, value_delimiter = ',', value_name = "ATTACK,…")]
    attacks: Option<Vec<Attack>>,
    #[command(flatten)]
    features: ImageFeatureArgs,
    #[command(flatten)]
    adversary: AdversaryArgs,
    /// Maximum number of keypoints per image; the strongest are used.
    #[arg(long, default_value_t = 2048, value_name = "N", value_parser = clap::value_parser!(u32).range(64..=65536))]
    max_keypoints: u32,
    /// Longest side, pixels; larger images are scaled down first.
    #[arg(long, default_value_t = 1600, value_name = "PX", value_parser = clap::value_parser!(u32).range(64..=8192))]
    max_size: u32,
    #[command(flatten)]
    json: JsonArgs,
}

/// Runs `veiloc audit`.
///
/// # Errors
/// An input cannot be read, the inputs contradict each other, or results cannot be written.
pub(crate) fn run(args: &Args, ui: &Ui) -> Outcome {
    let started = Instant::now();
    // Fails before the long computation if the report cannot be written.
    let report = report_path(&args.out)?;
    let limits = ExtractionLimits { max_keypoints: args.max_keypoints, max_image_side: args.max_size };
    let bars = Stages::new(ui);
    let extractor = args.features.device_extractor()?;
    let inputs = Inputs::read(&args.inputs, args.limit as usize, extractor.as_ref(), limits, &bars, ui)?;
    let attacks = args.attacks.clone().unwrap_or_else(|| inputs.default_attacks());
    let options = AuditOptions {
        evaluation: AttackEvaluation {
            images: Some(args.limit as usize),
            synthetic: if args.no_synthetic { 0 } else { args.synthetic as usize },
            groups: inputs.groups(),
            ..args.adversary.evaluation(&attacks)?
        },
        shown: args.show as usize,
        command: command_line(),
    };
    let file_of = |group, index| (!args.no_images).then(|| inputs.file_of(group, index)).flatten();
    let audit = run_audit(&options, &file_of, &bars)?;
    print_result(args, &audit, ui)?;
    html::write_page(&report, &audit_page(&audit, &options), ui)?;
    ui.info(format!("done in {:.0} s", started.elapsed().as_secs_f64()));
    Ok(Exit::Success)
}

/// Prints the tables, or the document, to stdout; with the document the tables go to stderr.
fn print_result(args: &Args, audit: &Audit, ui: &Ui) -> Result<(), Failure> {
    let document = &audit.document;
    let part = document.inputs.as_ref().or(document.synthetic.as_ref());
    let text = part.map_or_else(String::new, |part| {
        format!(
            "{PROTECTION}\n\n{}\nThe strongest attack on each scheme\n{}",
            attacks_table(&part.attacks),
            strongest_table(&part.attacks)
        )
    });
    args.json.print(&text, document, ui)
}

/// Returns the file of the report and creates its folder.
fn report_path(out: &Path) -> Result<PathBuf, Failure> {
    if files::is_standard(out) {
        return Err(Failure::with_help(
            "-: the report cannot go to stdout",
            "name a file or folder with --out",
        ));
    }
    let is_page =
        out.extension().is_some_and(|e| e.eq_ignore_ascii_case("html") || e.eq_ignore_ascii_case("htm"));
    let path = if is_page && !out.is_dir() { out.to_owned() } else { out.join("audit.html") };
    if let Some(folder) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
        files::make_folder(folder)?;
    }
    Ok(path)
}
