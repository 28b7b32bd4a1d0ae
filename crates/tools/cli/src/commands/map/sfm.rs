//! Images without poses: flags of structure from motion, and its output.

use std::path::{Path, PathBuf};

use veiloc_map::PosedImages;
use veiloc_mapping::structure_from_motion::{SfmMatching, SfmOptions, SfmReport, reconstruct};

use crate::exit::Failure;
use crate::stages::Stages;
use crate::ui::Ui;

/// Images without poses.
#[derive(clap::Args)]
pub(super) struct SfmArgs {
    /// The Python whose pycolmap computes the poses of images without poses. Default: python3 of the PATH, or else the
    /// program colmap of the PATH.
    #[arg(long, value_name = "PROGRAM", conflicts_with = "posed")]
    python: Option<PathBuf>,
    /// Image pairs that are matched to compute poses: all pairs (`exhaustive`), or neighbours by name as for frames of a video
    /// (`sequential`). `auto`: neighbours if there are more than 300 images and their names are numbered at regular
    /// steps, otherwise all pairs.
    #[arg(long, value_enum, default_value_t = Matching::Auto, conflicts_with = "posed")]
    matching: Matching,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Matching {
    Auto,
    Exhaustive,
    Sequential,
}

/// Images without a pose that are listed.
const SHOWN: usize = 20;

impl SfmArgs {
    /// Computes poses of the images of a folder. The work folder is that of `--work`, or else beside the map.
    ///
    /// # Errors
    /// There is no program for it, or no model could be computed.
    pub(super) fn posed(
        &self,
        images: &Path,
        names: Option<&[String]>,
        work: Option<&Path>,
        out: &Path,
        ui: &Ui,
    ) -> Result<PosedImages, Failure> {
        let work = work.map_or_else(|| out.with_extension("sfm"), |work| work.join("sfm"));
        let mut options = SfmOptions::default();
        options.python.clone_from(&self.python);
        options.matching = match self.matching {
            Matching::Auto => SfmMatching::Auto,
            Matching::Exhaustive => SfmMatching::Exhaustive,
            Matching::Sequential => SfmMatching::Sequential,
        };
        let report = reconstruct(images, names, &work, &options, &Stages::new(ui))?;
        print(&report, &work, ui);
        Ok(report.posed)
    }
}

fn print(report: &SfmReport, work: &Path, ui: &Ui) {
    let registered = report.posed.images().len();
    let reused = if report.is_reused { ", from an earlier run" } else { "" };
    ui.info(format_args!(
        "{}: {registered} of {} images have a pose, by {}{reused}. The model has no metric scale; {} keeps features of the \
         images, so protect it as the map, or delete it when the map is finished.",
        report.model.display(),
        report.images,
        report.program,
        work.display()
    ));
    if !report.others.is_empty() {
        let listed: Vec<String> =
            report.others.iter().map(|(model, n)| format!("{} ({n} images)", model.display())).collect();
        ui.warn(format_args!(
            "warning: the images form {} models that are not connected; the largest is used. Take images between the \
             parts, or build a map of each with --posed: {}",
            report.others.len() + 1,
            listed.join(", ")
        ));
    }
    if report.unregistered.is_empty() {
        return;
    }
    let mut lines: Vec<String> = report
        .unregistered
        .iter()
        .take(SHOWN)
        .map(|image| format!("\n  {}: {}", image.name, image.cause))
        .collect();
    if let Some(more) = report.unregistered.len().checked_sub(SHOWN).filter(|more| *more > 0) {
        lines.push(format!("\n  and {more} more"));
    }
    ui.warn(format_args!("warning: {} images have no pose:{}", report.unregistered.len(), lines.concat()));
}
