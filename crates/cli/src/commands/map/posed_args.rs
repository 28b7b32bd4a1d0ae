//! Images with known poses: flags, and what they name.

use std::path::{Path, PathBuf};

use veiloc_map::{GravityDirection, PosedImages};
use veiloc_mapping::importers::poses::{pose_rig_images, read_rig_cameras};
use veiloc_mapping::importers::ros_bag::{BagFrames, BagOptions, frames_of_bag, is_bag};
use veiloc_mapping::{Input, MaskFacts, OnBadImage};

use super::sfm::SfmModels;
use crate::commands::posed::{read_posed_input, warn_of};
use crate::output::exit::Failure;
use crate::output::lists;
use crate::output::stages::Stages;
use crate::output::ui::Ui;

/// Images with known poses.
#[derive(clap::Args)]
pub(super) struct PosedArgs {
    /// Images with cameras and poses: a COLMAP model (also in sparse/0), or a file or folder of nerfstudio
    /// (transforms.json), Bundler, VisualSFM (.nvm), OpenSfM, Metashape (XML), RealityCapture (CSV), kapture, Polycam,
    /// Record3D or 3D Scanner App, or a trajectory of TUM, KITTI or EuRoC. The format is recognized and printed. Points are
    /// optional; if present, they help to find image pairs. Or a bag of ROS (.mcap, .db3, the folder of a bag, .bag of ROS 1) with
    /// images and odometry, which the Python package `veiloc[ros]` reads; its map is in metres, and down is -z.
    #[arg(long, value_name = "PATH")]
    pub(super) posed: Option<PathBuf>,
    /// The images are of several cameras that are fixed to one device: their calibration, as Kalibr (camchain.yaml) or COLMAP
    /// (rig_config.json, or the folder of a model with rigs) writes it. --posed then needs the poses of the reference camera
    /// only, cam0 of Kalibr. Images of one moment have one name in the folders of their cameras: cam0/17.png, cam1/17.png.
    #[arg(long, value_name = "FILE", requires = "posed")]
    rig_cameras: Option<PathBuf>,
    /// Folder of the images. Without poses also a video: frames that moved by a few percent of the image, the sharpest of each
    /// step, are taken by ffmpeg (of the PATH, or of the Python package imageio-ffmpeg); it needs Python with NumPy. With a bag
    /// the folder gets its images: a new folder, or that of an earlier run of the same bag.
    #[arg(long, value_name = "DIR|VIDEO")]
    pub(super) images: PathBuf,
    /// Folder of masks of the images, `door/3.jpg.png` for `door/3.jpg` as in COLMAP: of what is black, people for example, nothing
    /// gets into the map. An image without a mask is used as a whole. Poses without --posed are computed from whole images.
    #[arg(long, value_name = "DIR")]
    masks: Option<PathBuf>,
    /// Names of the images to use, one per line. Default: every image with a pose, or, without poses, every photograph
    /// of the folder.
    #[arg(long, value_name = "FILE")]
    list: Option<PathBuf>,
    /// A topic of images of the bag; repeat it for several cameras. Default: the only one.
    #[arg(long, value_name = "NAME")]
    topic: Vec<String>,
    /// The topic of the poses of the bag, or a frame of its transforms (map, odom). Default: the only topic of odometry, or
    /// else the transforms from map or odom.
    #[arg(long, value_name = "NAME")]
    odometry: Option<String>,
    /// The Python that is used: its pycolmap computes the poses of images without poses, its `veiloc[ros]` reads bags. Default:
    /// python3 of the PATH, or else for poses the program colmap of the PATH.
    #[arg(long, value_name = "PROGRAM")]
    pub(super) python: Option<PathBuf>,
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
        let bag = self.posed.as_deref().filter(|posed| is_bag(posed));
        let of_bags = [("--topic", !self.topic.is_empty()), ("--odometry", self.odometry.is_some())];
        if let Some((option, _)) = of_bags.iter().find(|(_, is_given)| *is_given && bag.is_none()) {
            return Err(Failure::with_help(
                format!("{option} is for a bag of ROS, and --posed gives none"),
                "leave it out, or give the bag with --posed",
            ));
        }
        if self.posed.is_some() && bag.is_none() && self.python.is_some() {
            return Err(Failure::with_help(
                "--python is for images without poses and for bags, and --posed gives poses",
                "leave it out",
            ));
        }
        // Computing poses takes long.
        if let Some(masks) = self.masks.as_deref().filter(|masks| !masks.is_dir()) {
            return Err(Failure::with_help(
                format!("{}: there is no such folder", masks.display()),
                "give the folder of the masks, or leave out --masks",
            ));
        }
        let names = self.list.as_deref().map(lists::read_list).transpose()?;
        if let Some(bag) = bag {
            return self.read_bag(bag, names, ui);
        }
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
            images: self.with_rig(read.images, &folder, ui)?,
            folder,
            down: read.down,
            is_metric: read.is_metric,
            names,
            args: self,
        })
    }

    /// Adds the images of the other cameras of a rig, if there is one.
    fn with_rig(&self, posed: PosedImages, folder: &Path, ui: &Ui) -> Result<PosedImages, Failure> {
        let Some(path) = &self.rig_cameras else { return Ok(posed) };
        let cameras = read_rig_cameras(path)?;
        let read = posed.remarks().len();
        let posed = pose_rig_images(&posed, &cameras, folder)?;
        ui.info(format_args!(
            "{}: {} cameras, {} images",
            path.display(),
            cameras.len(),
            posed.images().len()
        ));
        warn_of(path, &posed.remarks()[read..], ui);
        Ok(posed)
    }

    /// Writes the images of a bag into the folder of the images, and reads their poses.
    fn read_bag(&self, bag: &Path, names: Option<Vec<String>>, ui: &Ui) -> Result<PosedInput<'_>, Failure> {
        let options = BagOptions { topics: self.topic.clone(), odometry: self.odometry.clone() };
        let frames = frames_of_bag(bag, &self.images, &options, self.python.as_deref(), &Stages::new(ui))?;
        let reused = if frames.is_reused { ", from an earlier run" } else { "" };
        ui.info(format_args!(
            "{}: {} images with poses{reused}, in {}",
            bag.display(),
            frames.count,
            self.images.display()
        ));
        warn_of(bag, &frames.remarks, ui);
        let images = read_posed_input(&frames.posed, &frames.images, ui)?.images;
        let BagFrames { images: folder, down, is_metric, .. } = frames;
        let images = self.with_rig(images, &folder, ui)?;
        Ok(PosedInput { images, folder, down, is_metric, names, args: self })
    }
}

impl PosedInput<'_> {
    /// Says how many images have a mask, and warns of masks that hide nearly all.
    ///
    /// # Errors
    /// No image has one, or one cannot be read.
    pub(super) fn check_masks(&self, ui: &Ui) -> Result<(), Failure> {
        let Some(folder) = &self.args.masks else { return Ok(()) };
        let facts = MaskFacts::of(folder, self.names())?;
        let of = self.names().count();
        ui.info(format_args!("{}: {} of {of} images have a mask", folder.display(), facts.masks));
        if let Some(doubt) = facts.doubt() {
            ui.warn(format_args!("warning: {}: {doubt}", folder.display()));
        }
        Ok(())
    }

    /// Names of the images to use.
    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        let listed = self.names.iter().flatten().map(String::as_str);
        let of_model = self.images.images().iter().filter(|_| self.names.is_none());
        listed.chain(of_model.map(|image| image.name.as_str()))
    }

    pub(super) fn input(&self) -> Input<'_> {
        let input = Input::new(&self.images, &self.folder).on_bad_image(self.args.bad.on_bad_image());
        let input = match &self.args.masks {
            Some(masks) => input.with_masks(masks),
            None => input,
        };
        match &self.names {
            Some(names) => input.with_names(names),
            None => input,
        }
    }
}
