//! `veiloc localize --queries LIST --images DIR`: seals the images here, as on a device, before they are localized.

use std::path::PathBuf;

use crate::args::camera::{CameraArg, CameraSource, warn_of_turned};
use clap::Arg;
use veiloc_geometry::Intrinsics;
use veiloc_map::MapFile;
use veiloc_obfuscation::Sealer;
use veiloc_protocol::SealedQuery;

use crate::commands::device_args::DeviceArgs;
use crate::commands::image_list::images_of_list;
use crate::commands::seal::{Attitude, seal_one};
use crate::output::exit::Failure;
use crate::output::items::{InputError, InputErrorKind, Item};
use crate::output::ui::Ui;

/// Images instead of sealed queries.
#[derive(clap::Args)]
pub(super) struct ImageArgs {
    /// Images instead of sealed queries: their names, one per line, relative to --images; a camera may follow each name
    /// (MODEL W H PARAMS…, as in hloc's query lists) unless --camera or EXIF gives it. Each image is sealed as by
    /// `veiloc seal`, with the options below, and the sealed query is localized. Default: the given sealed queries.
    #[arg(
        long = "queries",
        value_name = "LIST",
        conflicts_with_all = ["queries", "rig"],
        requires = "folder"
    )]
    list: Option<PathBuf>,
    /// Folder of the images that --queries names.
    #[arg(long = "images", value_name = "DIR", requires = "list")]
    folder: Option<PathBuf>,
    /// The camera of all images of the list, as in `veiloc seal`. Default: the camera in the list, otherwise the focal
    /// length in each image's EXIF data.
    #[arg(long, value_name = "MODEL,W,H,PARAMS…|FILE|unknown", requires = "list")]
    camera: Option<CameraArg>,
    #[command(flatten)]
    device: DeviceArgs,
}

/// Makes an option of sealing require --queries: it has no effect on sealed queries.
pub(super) fn tie_to_list(arg: Arg) -> Arg {
    const OF_SEALING: [&str; 9] = [
        "scheme",
        "max_keypoints",
        "focal_known",
        "gravity",
        "features",
        "model_file",
        "features_file",
        "engine",
        "image_global",
    ];
    if OF_SEALING.contains(&arg.get_id().as_str()) {
        arg.requires("list").help_heading("Options of --queries")
    } else {
        arg
    }
}

/// The images of a list, with everything needed to seal them.
pub(super) struct Sealing {
    images: Vec<(Item, CameraSource)>,
    sealer: Sealer,
    attitude: Attitude,
}

impl ImageArgs {
    /// Reads the images of the list, if one is given.
    ///
    /// # Errors
    /// As `veiloc seal --list`.
    pub(super) fn read(&self, map: &MapFile, ui: &Ui) -> Result<Option<Sealing>, Failure> {
        let (Some(list), Some(folder)) = (&self.list, &self.folder) else { return Ok(None) };
        if !folder.is_dir() {
            return Err(Failure::with_help(
                format!("--images {} is not a folder", folder.display()),
                "give the folder that the names of the list are relative to",
            ));
        }
        let images = images_of_list(list, folder, &self.device, self.camera.as_ref())?;
        if images.len() > 1 && self.device.has_gravity() {
            return Err(Failure::with_help(
                "--gravity is for one image, and the list names several",
                "seal each image with `veiloc seal`, with the direction measured when it was taken",
            ));
        }
        warn_of_turned(images.iter().map(|(item, camera)| (item.path.as_path(), *camera)), ui);
        let sealer = self.device.sealer(
            map.profile(),
            || map.pack().map(|(pack, _)| pack).map_err(Failure::refused),
            ui,
        )?;
        let attitude = Attitude { gravity: self.device.gravity(), ..Attitude::default() };
        Ok(Some(Sealing { images, sealer, attitude }))
    }
}

impl Sealing {
    /// Returns the images, in the order of the list.
    pub(super) fn items(&self) -> Vec<Item> {
        self.images.iter().map(|(item, _)| item.clone()).collect()
    }

    /// Returns the sealed query of an image, decoded from its bytes, and the image's camera; or the error of this
    /// image.
    ///
    /// # Errors
    /// Errors that do not belong to one image.
    pub(super) fn seal(
        &self,
        index: usize,
    ) -> Result<Result<(SealedQuery, Intrinsics), InputError>, Failure> {
        let (item, camera) = &self.images[index];
        if let Some(fault) = &item.fault {
            return Ok(Err(fault.clone()));
        }
        let sealed = seal_one(&item.path, *camera, &self.sealer, None, self.attitude, None)?;
        Ok(sealed.and_then(|sealed| {
            let query = SealedQuery::decode(&sealed.bytes)
                .map_err(|e| InputError::new(InputErrorKind::Damaged, e))?;
            Ok((query, sealed.camera))
        }))
    }
}
