//! `veiloc seal`: images to sealed queries, as a device does it.

mod batch;

use std::path::{Path, PathBuf};

use veiloc_client::{ClientError, Mask, Orientation, SealedImage, SessionFile, seal_image, seal_masked};
use veiloc_features::FeatureError;
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::SealOptions;
use veiloc_protocol::{FocalKnowledge, Profile};

use crate::args::camera::{CameraArg, CameraSource};
use crate::args::faults::fault_of;
use crate::commands::device_args::DeviceArgs;
use crate::commands::mask_args::MaskArgs;
use crate::commands::session_args::{self, SessionArgs};
use crate::exit::{Failure, Outcome};
use crate::files;
use crate::items::{Fault, FaultKind, SkipArgs};
use crate::ui::Ui;

/// Turn images into sealed queries.
///
/// A sealed query holds descriptors and lines, never keypoints; it is all a server gets. Nothing of the file but its
/// pixels is read, and, where no camera is given, the focal length in its EXIF: no time, no place. Everything random comes from the operating system's generator, so
/// sealing one image twice gives two different queries; never send both (see docs/reference/privacy-rules.md, rule L7). Two images of one place
/// belong in one session (--session).
///
/// Every image is answered for itself: one that cannot be sealed does not stop the others.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Images, JPEG or PNG, and folders: of a folder all images in it and in its sub-folders.
    #[arg(required = true, value_name = "IMAGE|FOLDER")]
    images: Vec<PathBuf>,
    /// Names of the images to seal, one a line, relative to the one folder given; behind each name its camera
    /// (MODEL W H PARAMS…, as in hloc's query lists), or nothing when --camera says it.
    #[arg(long, value_name = "FILE")]
    list: Option<PathBuf>,
    /// The camera of all images: COLMAP's model name, width, height (pixels) and parameters, with commas or spaces
    /// between, for example SIMPLE_RADIAL,1296,1936,2435.4,648,968,-0.034; or a COLMAP cameras.txt
    /// with one camera; or `unknown`, which guesses the focal length and says so. Default: what the list says, else the
    /// focal length that each image's EXIF tells.
    #[arg(long, value_name = "MODEL,W,H,PARAMS…|FILE|unknown")]
    camera: Option<CameraArg>,
    /// The map's profile, as `veiloc map profile` writes it.
    #[arg(long, value_name = "FILE")]
    profile: PathBuf,
    #[command(flatten)]
    device: DeviceArgs,
    #[command(flatten)]
    session: SessionArgs,
    #[command(flatten)]
    mask: MaskArgs,
    /// Folder of masks, one for every image: of `door/3.jpg` in `door/3.jpg.png`, as COLMAP has them. An image without a mask is not
    /// sealed.
    #[arg(long, value_name = "DIR", conflicts_with = "mask")]
    masks: Option<PathBuf>,
    /// File to write; a folder when it is one, ends in `/`, or there are several images; `-` for stdout. Sub-folders
    /// of a folder given are made in it too.
    #[arg(long, short, value_name = "OUT")]
    out: PathBuf,
    #[command(flatten)]
    skip: SkipArgs,
    /// Print one JSON document to stdout, with what became of every image.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args, ui: &Ui) -> Outcome {
    let profile = read_profile(&args.profile)?;
    let options = args.device.options(&profile, ui)?;
    let hiding = args.mask.open()?;
    let mut session = args.session.open()?;
    batch::run(args, &profile, &options, &hiding, session.as_mut(), ui)
}

/// One image sealed.
pub(crate) struct Sealed {
    /// How well its focal length is known.
    focal: FocalKnowledge,
    /// Its camera.
    pub(crate) camera: Intrinsics,
    /// What a device sends.
    pub(crate) bytes: Vec<u8>,
    /// Keypoints found in the image.
    found: usize,
    /// Rows sent.
    sent: usize,
}

/// The session that images are frames of, and how the camera was held.
pub(crate) struct InSession<'a> {
    file: &'a mut SessionFile,
    held: Orientation,
}

/// Seals one image, all a device does with it. What is wrong with the image is a fault of it; a session that cannot be kept ends
/// the command.
pub(crate) fn seal_one(
    path: &Path,
    camera: CameraSource,
    profile: &Profile,
    options: &SealOptions,
    mask: Option<&Mask>,
    session: Option<InSession<'_>>,
) -> Result<Result<Sealed, Fault>, Failure> {
    let known = match camera.of(path) {
        Ok(known) => known,
        Err(e @ FeatureError::NoFocal { .. }) => {
            return Ok(Err(Fault::new(FaultKind::Unfit, format_args!("{e} (--camera, --camera unknown)"))));
        }
        Err(e) => return Ok(Err(Fault::new(FaultKind::Damaged, e))),
    };
    let options = options.clone().with_focal(known.focal);
    let camera = &known.intrinsics;
    let sealed = match (session, mask) {
        (Some(InSession { file, held }), Some(mask)) => {
            file.seal_masked(path, mask, camera, profile, &options, &held)
        }
        (Some(InSession { file, held }), None) => file.seal_image(path, camera, profile, &options, &held),
        (None, Some(mask)) => seal_masked(path, mask, camera, profile, &options),
        (None, None) => seal_image(path, camera, profile, &options),
    };
    match sealed {
        Ok(SealedImage { query, keypoints }) => {
            let (bytes, sent) = (query.encode(), query.len());
            Ok(Ok(Sealed { focal: known.focal, camera: *camera, bytes, found: keypoints, sent }))
        }
        Err(ClientError::Extract(error)) => Ok(Err(fault_of(&error))),
        Err(ClientError::Seal { source, .. }) => Ok(Err(Fault::new(FaultKind::Unfit, source))),
        Err(error) => Err(session_args::failure(&error)),
    }
}

/// Reads a profile file.
pub(crate) fn read_profile(path: &Path) -> Result<Profile, Failure> {
    Profile::decode(&files::read(path)?).map_err(|e| {
        Failure::with_help(
            format!("{}: {e}", path.display()),
            "export the profile again with `veiloc map profile MAP -o FILE`",
        )
    })
}
