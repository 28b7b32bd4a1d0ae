//! Images without poses: flags of structure from motion, and its output.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use veiloc_geometry::Intrinsics;
use veiloc_map::PosedImages;
use veiloc_mapping::structure_from_motion::{
    SfmMatching, SfmOptions, SfmReport, frames_of_video, reconstruct,
};

use super::posed_args::PosedArgs;
use super::remedy::with_remedy;
use crate::output::exit::Failure;
use crate::output::stages::Stages;
use crate::output::ui::Ui;

/// Images without poses.
#[derive(clap::Args)]
pub(super) struct SfmArgs {
    /// Image pairs that are matched to compute poses: all pairs (`exhaustive`), or neighbours by name as for frames of a video
    /// (`sequential`). `auto`: neighbours if there are more than 300 images and their names are numbered at regular
    /// steps, otherwise all pairs.
    #[arg(long, value_enum, default_value_t = Matching::Auto, conflicts_with = "posed")]
    matching: Matching,
    /// If the images form several models that are not connected, write a map of each: the largest to --out, the others beside it
    /// as NAME-2.vmap, NAME-3.vmap, … by size. Default: the largest only.
    #[arg(long, conflicts_with_all = ["posed", "pairs", "out_pairs", "json"])]
    components: bool,
    /// All images that are twice as wide as high are equirectangular panoramas, also if their metadata does not say so, as the frames of
    /// a video. Each becomes five images of the map: front, right, back, left and up; what is below the camera is left out. It needs
    /// pycolmap.
    #[arg(long, conflicts_with = "posed")]
    panoramas: bool,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Matching {
    Auto,
    Exhaustive,
    Sequential,
}

/// Focal lengths of cameras that are used for maps, of the longer side of their images.
const PLAUSIBLE: std::ops::RangeInclusive<f64> = 0.2..=8.0;

/// Images without a pose that are listed.
const SHOWN: usize = 20;

/// Poses that were computed.
pub(super) struct SfmModels {
    /// The models, largest first, at least one; more than one only with `--components`.
    pub(super) models: Vec<PosedImages>,
    /// The folder of their images: the given one, or that of the frames of a video.
    pub(super) folder: PathBuf,
}

impl SfmArgs {
    /// Computes poses of the images of a folder, or of the frames of a video. The work folder is that of `--work`, or else beside
    /// the map.
    ///
    /// # Errors
    /// There is no program for it, or no model could be computed.
    pub(super) fn models(
        &self,
        names: Option<&[String]>,
        work: Option<&Path>,
        out: &Path,
        posed: &PosedArgs,
        ui: &Ui,
    ) -> Result<SfmModels, Failure> {
        let (images, python) = (posed.images.as_path(), posed.python.as_deref());
        let work = work.map_or_else(|| out.with_extension("sfm"), |work| work.join("sfm"));
        let mut options = SfmOptions::default();
        options.python = python.map(Path::to_owned);
        options.skip_bad = posed.bad.skip_bad;
        options.are_panoramas = self.panoramas;
        options.matching = match self.matching {
            Matching::Auto => SfmMatching::Auto,
            Matching::Exhaustive => SfmMatching::Exhaustive,
            Matching::Sequential => SfmMatching::Sequential,
        };
        let stages = Stages::new(ui);
        let report = if images.is_file() {
            if names.is_some() {
                return Err(Failure::with_help(
                    format!("{}: --list names images of a folder, and this is a video", images.display()),
                    "leave out --list, or give a folder of images",
                ));
            }
            let frames = frames_of_video(images, &work, python, &stages)?;
            let of = frames.of.map_or_else(|| ", from an earlier run".to_owned(), |n| format!(" of {n}"));
            ui.info(format_args!(
                "{}: {} frames{of} are used, in {}",
                images.display(),
                frames.names.len(),
                frames.folder.display()
            ));
            if let Some(fault) = &frames.fault {
                ui.warn(format_args!(
                    "warning: {}: the video is damaged or cut short, so frames are missing (ffmpeg: {fault}); copy it again",
                    images.display()
                ));
            }
            reconstruct(&frames.folder, Some(&frames.names), &work, &options, &stages)
        } else {
            reconstruct(images, names, &work, &options, &stages)
        };
        let report = report.map_err(with_remedy)?;
        self.print(&report, &work, ui);
        let others = report.others.into_iter().filter(|_| self.components).map(|(_, posed)| posed);
        let models = std::iter::once(report.posed).chain(others).collect();
        Ok(SfmModels { models, folder: report.folder })
    }

    fn print(&self, report: &SfmReport, work: &Path, ui: &Ui) {
        for (reason, count) in &report.left_out {
            ui.info(format_args!("{count} files are left out: {reason}. --list names the images to use"));
        }
        for bad in &report.bad {
            ui.warn(format_args!("warning: left out: {bad}"));
        }
        if report.panoramas > 0 {
            ui.info(format_args!(
                "{} panoramas: five images of each are used, in {}",
                report.panoramas,
                report.folder.display()
            ));
        }
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
        let cameras: BTreeSet<String> =
            report.posed.images().iter().map(|image| image.camera.to_string()).collect();
        if let (Some(camera), 1) = (cameras.first(), cameras.len()) {
            ui.info(format_args!(
            "Estimated camera: {camera}. Give it to queries of the same camera and zoom, with --camera, which also reads a \
             map: another calibration contradicts the map by what this estimate is wrong."
        ));
        } else {
            ui.info(format_args!(
            "{} cameras were estimated; `veiloc map info --images` lists them. Give a query the one that took it, with --camera.",
            cameras.len()
        ));
        }
        let longer = |camera: &Intrinsics| f64::from(camera.width.max(camera.height));
        let is_implausible =
            |camera: &Intrinsics| !PLAUSIBLE.contains(&(camera.pinhole().mean_focal() / longer(camera)));
        let images = report.posed.images();
        if let Some(first) = images.iter().find(|image| is_implausible(&image.camera)) {
            let count = images.iter().filter(|image| is_implausible(&image.camera)).count();
            ui.warn(format_args!(
                "warning: the estimated camera of {count} images ({} is one) is hardly possible: {}. Are images of one camera cut, or of \
                 several zooms? Leave those out with --list; poses in this map may be wrong",
                first.name, first.camera
            ));
        }
        if !report.others.is_empty() {
            let listed: Vec<String> = report
                .others
                .iter()
                .map(|(model, posed)| format!("{} ({} images)", model.display(), posed.images().len()))
                .collect();
            let (count, listed) = (report.others.len() + 1, listed.join(", "));
            let use_of = if self.components {
                "each becomes a map. Take images between the parts to join them"
            } else {
                "the largest is used. Take images between the parts, or write a map of each with --components"
            };
            ui.warn(format_args!(
            "warning: the images form {count} models that are not connected; {use_of}. The smaller ones: {listed}"
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
        ui.warn(format_args!(
            "warning: {} images have no pose:{}",
            report.unregistered.len(),
            lines.concat()
        ));
    }
}
