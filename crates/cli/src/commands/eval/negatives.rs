//! Out-of-map images of `veiloc eval scene`: every pose that they get is wrong.

use std::path::{Path, PathBuf};

use veiloc_datasets::problem_files::is_in_design_split;
use veiloc_evaluation::NegativeImage;
use veiloc_features::load_gray;
use veiloc_geometry::Intrinsics;
use veiloc_protocol::FocalKnowledge;

use crate::args::camera::{CameraArg, CameraSource};
use crate::output::exit::Failure;
use crate::output::items::{self, Item};
use crate::output::lists;
use crate::output::ui::Ui;

/// Queries that must not be localized.
#[derive(clap::Args)]
pub(super) struct NegativeArgs {
    /// Folder of the images of the condition `negatives`, with its sub-folders: out-of-map images, whose
    /// poses are all wrong.
    #[arg(long, value_name = "DIR")]
    negatives: Option<PathBuf>,
    /// Names of the out-of-map images to use, one per line, relative to the folder; a camera may follow each name
    /// (MODEL W H PARAMS…, as in hloc's query lists). Default: all.
    #[arg(long, value_name = "FILE", requires = "negatives")]
    negatives_list: Option<PathBuf>,
    /// Use one half of the out-of-map images, chosen by the file name alone: `design` to choose thresholds with, `final`
    /// for final figures only. Bit 32 of the 64-bit FNV-1a hash of the file name without folders is 0 in `design` and 1
    /// in `final`.
    #[arg(long, value_enum, default_value_t = Split::All, requires = "negatives")]
    negatives_split: Split,
    /// The camera of all out-of-map images, as in `veiloc seal --camera`. Default: the camera in the list, then EXIF, and
    /// otherwise an assumed camera that the query marks as unknown: no distortion, a focal length of 1.2 times the
    /// longer side.
    #[arg(long, value_name = "MODEL,W,H,PARAMS…|FILE", requires = "negatives")]
    negatives_camera: Option<CameraArg>,
}

/// Images without use that are named.
const SHOWN: usize = 5;

/// Why an image cannot be a query: it cannot be read, or has another size than its camera.
fn fault_of(path: &Path, camera: Option<&Intrinsics>) -> Option<String> {
    let image = match load_gray(path) {
        Ok(image) => image,
        Err(error) => return Some(error.to_string()),
    };
    let (width, height) = (image.width(), image.height());
    let camera = camera.filter(|camera| (camera.width, camera.height) != (width, height))?;
    let (path, of_camera) = (path.display(), (camera.width, camera.height));
    Some(format!("{path}: {width} x {height} pixels, and its camera has {} x {}", of_camera.0, of_camera.1))
}

/// Halves of a set of images: one for design, the other untouched until the final figures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Split {
    /// The half for design and calibration.
    Design,
    /// The half for final figures only.
    Final,
    /// All images.
    All,
}

impl Split {
    fn holds(self, file: &Path) -> bool {
        self == Self::All || is_in_design_split(file) == (self == Self::Design)
    }
}

impl NegativeArgs {
    /// Returns the images, each with its camera if one is given; `scene` is the folder of the scene's own images.
    pub(super) fn images(&self, scene: Option<&Path>, ui: &Ui) -> Result<Vec<NegativeImage>, Failure> {
        let Some(folder) = &self.negatives else { return Ok(Vec::new()) };
        let shown = folder.display();
        if !folder.is_dir() {
            let help = "give the folder of the out-of-map images";
            return Err(Failure::with_help(format!("{shown} is not a folder"), help));
        }
        if scene.is_some_and(|own| own.canonicalize().ok() == folder.canonicalize().ok()) {
            return Err(Failure::with_help(
                format!("{shown}: these negatives are images of the evaluated scene"),
                "give images of another scene",
            ));
        }
        let camera =
            self.negatives_camera.as_ref().map(|c| c.source(FocalKnowledge::Calibrated)).transpose()?;
        let common = match camera {
            Some(CameraSource::Given(known)) => Some(known.intrinsics),
            Some(CameraSource::Exif | CameraSource::Assumed) | None => None,
        };
        let given = self.listed(folder, common, ui)?;
        let all = given.len();
        let items: Vec<Item> = given.iter().map(|(item, _)| item.clone()).collect();
        let (mut images, mut left_out) = (Vec::new(), Vec::new());
        for ((Item { path, fault, .. }, camera), name) in given.into_iter().zip(items::names(&items)) {
            if fault.is_none() && !self.negatives_split.holds(&path) {
                continue;
            }
            match fault.map(|fault| fault.of(&name)).or_else(|| fault_of(&path, camera.as_ref())) {
                Some(fault) => left_out.push(fault),
                None => images.push(NegativeImage { name, path, camera }),
            }
        }
        if !left_out.is_empty() {
            let mut shown: Vec<String> = left_out.iter().take(SHOWN).cloned().collect();
            if left_out.len() > SHOWN {
                shown.push(format!("and {} more", left_out.len() - SHOWN));
            }
            ui.warn(format_args!(
                "{} of {all} out-of-map images cannot be used, and are left out:\n  {}",
                left_out.len(),
                shown.join("\n  ")
            ));
        }
        if images.is_empty() {
            return Err(Failure::with_help(
                format!("none of the {all} out-of-map images can be used, or belongs to this half"),
                "give more images, or leave out --negatives-split",
            ));
        }
        Ok(images)
    }

    fn listed(
        &self,
        folder: &PathBuf,
        common: Option<Intrinsics>,
        ui: &Ui,
    ) -> Result<Vec<(Item, Option<Intrinsics>)>, Failure> {
        let Some(list) = &self.negatives_list else {
            let items = items::expand_images(std::slice::from_ref(folder), ui).into_iter();
            return Ok(items.map(|item| (item, common)).collect());
        };
        let listed = lists::read_with_cameras(list)?;
        if let Some(own) = listed.iter().find(|l| common.is_some() && l.camera.is_some()) {
            let message = format!(
                "{}: line {}: {} has its own camera, and --negatives-camera is given too",
                list.display(),
                own.line,
                own.name
            );
            return Err(Failure::with_help(
                message,
                "leave out --negatives-camera, or give a list without cameras",
            ));
        }
        let items = items::files_of_list(folder, listed.iter().map(|l| l.name.as_str()));
        Ok(items.into_iter().zip(listed).map(|(item, l)| (item, l.camera.or(common))).collect())
    }
}
