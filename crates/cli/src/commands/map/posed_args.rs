//! Images with known poses: flags, and what they name.

use std::path::PathBuf;

use veiloc_map::{GravityDirection, PosedImages};
use veiloc_mapping::{Input, OnBadImage};

use super::sfm::SfmModels;
use crate::commands::posed::read_posed_input;
use crate::output::exit::Failure;
use crate::output::lists;
use crate::output::ui::Ui;

/// Images with known poses.
#[derive(clap::Args)]
pub(super) struct PosedArgs {
    /// Images with cameras and poses: a COLMAP model (also in sparse/0), or a file or folder of nerfstudio
    /// (transforms.json), Bundler, VisualSFM (.nvm), OpenSfM, Metashape (XML), RealityCapture (CSV), kapture, Polycam,
    /// Record3D or 3D Scanner App, or a trajectory of TUM, KITTI or EuRoC. The format is recognized and printed. Points are
    /// optional; if present, they help to find image pairs.
    #[arg(long, value_name = "PATH")]
    pub(super) posed: Option<PathBuf>,
    /// Folder of the images. Without poses also a video: frames that moved by a few percent of the image, the sharpest of each
    /// step, are taken by ffmpeg (of the PATH, or of the Python package imageio-ffmpeg); it needs Python with NumPy.
    #[arg(long, value_name = "DIR|VIDEO")]
    pub(super) images: PathBuf,
    /// Names of the images to use, one per line. Default: every image with a pose, or, without poses, every photograph
    /// of the folder.
    #[arg(long, value_name = "FILE")]
    list: Option<PathBuf>,
    #[command(flatten)]
    pub(super) bad: BadImageArgs,
}

/// Handling of unusable images.
#[derive(clap::Args)]
pub(super) struct BadImageArgs {
    /// Leave out images that are missing, unreadable or not of their camera's size, and name them. Default: refuse.
    #[arg(long)]
    pub(super) skip_bad: bool,
}

impl BadImageArgs {
    pub(super) const fn on_bad_image(&self) -> OnBadImage {
        if self.skip_bad { OnBadImage::Skip } else { OnBadImage::Refuse }
    }
}

/// The data that [`PosedArgs`] names.
pub(super) struct PosedInput<'a> {
    pub(super) images: PosedImages,
    /// The folder of the images.
    pub(super) folder: PathBuf,
    /// The direction of gravity that the format defines.
    pub(super) down: Option<GravityDirection>,
    /// Whether the format defines that lengths are metres.
    pub(super) is_metric: bool,
    pub(super) names: Option<Vec<String>>,
    pub(super) args: &'a PosedArgs,
}

impl PosedArgs {
    /// Reads the posed images; without `--posed` it computes them.
    pub(super) fn read(
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
    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        let listed = self.names.iter().flatten().map(String::as_str);
        let of_model = self.images.images().iter().filter(|_| self.names.is_none());
        listed.chain(of_model.map(|image| image.name.as_str()))
    }

    pub(super) fn input(&self) -> Input<'_> {
        let input = Input::new(&self.images, &self.folder).on_bad_image(self.args.bad.on_bad_image());
        match &self.names {
            Some(names) => input.with_names(names),
            None => input,
        }
    }
}
