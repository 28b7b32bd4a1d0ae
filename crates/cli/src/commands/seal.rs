//! `veiloc seal`: converts images to sealed queries, as on a device.

pub(crate) mod batch;
mod panorama;
mod rig;

use std::path::{Path, PathBuf};

use veiloc_client::{ClientError, Mask, Orientation, SealError};
use veiloc_features::{FeatureError, Image};
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{Extracted, KnownCamera, Sealer, device_rng};
use veiloc_protocol::{CoarseGravity, FocalKnowledge, Profile, ProfileId, SealedIn, SealedQuery, SessionTag};

use crate::args::camera::{CameraArg, CameraSource};
use crate::args::extraction_error::extraction_error;
use crate::commands::device_args::DeviceArgs;
use crate::commands::mask_args::MaskArgs;
use crate::commands::session_args::{self, OpenSession, SessionArgs};
use crate::output::exit::{Failure, Outcome};
use crate::output::files;
use crate::output::items::{InputError, InputErrorKind, SkipArgs};
use crate::output::targets::OutFileOrFolder;
use crate::output::ui::Ui;

/// Seal images: convert them to queries that hide the keypoint positions.
///
/// A sealed query contains descriptors and lines, never keypoints; a server gets nothing else. From the image file only
/// the pixels are read and, if no camera is given, the focal length in its EXIF data, and the orientation for a warning:
/// the pose is that of the image as it is stored. No time and no location are read. All randomness comes from the
/// operating system's generator, so sealing one image twice gives two different queries; never send both (see
/// docs/reference/privacy-rules.md, rule L7). Seal two images of one scene in one session (--session).
///
/// Images are independent: an image that cannot be sealed does not stop the others.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Images (JPEG, PNG, WebP, HEIC), or folders with all images in them and their sub-folders.
    #[arg(required = true, value_name = "IMAGE|FOLDER")]
    images: Vec<PathBuf>,
    /// Names of the images to seal, one per line, relative to the one given folder; a camera may follow each name
    /// (MODEL W H PARAMS…, as in hloc's query lists) unless --camera gives it.
    #[arg(long, value_name = "FILE")]
    list: Option<PathBuf>,
    /// The camera of all images: COLMAP's model name, width, height (pixels) and parameters, separated by commas or
    /// spaces, for example SIMPLE_RADIAL,1296,1936,2435.4,648,968,-0.034; a COLMAP cameras.txt with one camera; a map
    /// (.vmap) whose images share one camera, for queries of that camera; or `unknown`, which assumes a focal length and
    /// marks it as unknown. Default: the camera in the list, otherwise the
    /// focal length in each image's EXIF data.
    #[arg(long, value_name = "MODEL,W,H,PARAMS…|FILE|unknown")]
    camera: Option<CameraArg>,
    /// The map's profile, as written by `veiloc map profile`.
    #[arg(long, value_name = "FILE")]
    profile: PathBuf,
    /// Id of the profile as the operator publishes it, 32 hexadecimal digits (`veiloc map profile` prints it): nothing
    /// is sealed for another profile, by which a service could recognize this device. Default: any profile.
    #[arg(long, value_name = "HEX")]
    profile_id: Option<ProfileId>,
    #[command(flatten)]
    device: DeviceArgs,
    #[command(flatten)]
    session: SessionArgs,
    /// The images are equirectangular panoramas (twice as wide as high): each becomes a folder with the sealed queries of its
    /// pinhole images, which see all directions but the bottom, and a rig.json for `veiloc localize --rig` and `veiloc query --rig`.
    #[arg(long, conflicts_with_all = ["session", "camera", "list", "gravity"])]
    panorama: bool,
    /// The images are of one moment, one of each camera of a device, in the order of this file: the calibration of the
    /// cameras, as Kalibr (camchain.yaml) or COLMAP (rig_config.json, or the folder of a model with rigs) writes it. They are
    /// sealed in one session, and the output is a folder with a query for each camera and a rig.json for `veiloc query send
    /// --rig` and `veiloc localize --rig`. For several moments, give --session and with --orientation the rotation from the
    /// world to the rig: the first camera of Kalibr, the reference camera of COLMAP.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["panorama", "camera", "list", "gravity", "mask"])]
    rig_cameras: Option<PathBuf>,
    /// Metres of a unit of the map, for calibrations in metres: rig.json is in units of the map.
    #[arg(long, value_name = "METRES", default_value = "1", value_parser = rig::metres, requires = "rig_cameras")]
    metres_per_unit: f64,
    #[command(flatten)]
    mask: MaskArgs,
    /// Folder of masks, one per image: `door/3.jpg.png` for `door/3.jpg`, as in COLMAP. An image without a mask is not
    /// sealed.
    #[arg(long, value_name = "DIR", conflicts_with = "mask")]
    masks: Option<PathBuf>,
    /// Output file; a folder if it is one, ends in `/`, or there are several images; `-` for stdout. Sub-folders of a
    /// given folder are created in it too.
    #[arg(long, short, value_name = "OUT")]
    out: OutFileOrFolder,
    #[command(flatten)]
    skip: SkipArgs,
    /// Print one JSON document with the result of every image to stdout.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args, ui: &Ui) -> Outcome {
    let profile = read_profile(&args.profile)?;
    if let Some(expected) = args.profile_id.filter(|expected| *expected != profile.id()) {
        return Err(Failure::with_help(
            format!("{}: its id is {}, not {expected}", args.profile.display(), profile.id()),
            OTHER_ID,
        ));
    }
    let no_pack = || {
        Err(Failure::with_help(
            "--send needs a pack",
            "give --pack FILE, as written by `veiloc map pack MAP -o FILE`",
        ))
    };
    let sealer = args.device.sealer(&profile, no_pack, ui)?;
    let hiding = args.mask.open()?;
    let session = args.session.open()?;
    batch::run(args, &sealer, &hiding, session, ui)
}

/// The remedy for another profile or pack than the given one.
pub(crate) const OTHER_ID: &str = "compare it with the id that the operator publishes now; one that only this \
                                        device gets identifies it";

/// Name of the file that joins the queries of a rig.
const RIG: &str = "rig.json";

/// The remedy for an image whose EXIF data does not give the focal length.
pub(crate) const GIVE_CAMERA: &str = "give its camera with --camera MODEL,W,H,PARAMS…, or --camera MAP.vmap for that of a \
                                      map's images, or --camera unknown to have the focal length estimated";

/// One sealed image.
pub(crate) struct Sealed {
    /// Knowledge of its focal length.
    focal: FocalKnowledge,
    /// Its camera.
    pub(crate) camera: Intrinsics,
    /// The sealed query.
    pub(crate) bytes: Vec<u8>,
    /// Number of keypoints in the image.
    found: usize,
    /// Rows sent.
    sent: usize,
    /// The session in which it was sealed.
    session: Option<SessionTag>,
}

/// Orientation and gravity of the camera when it took an image.
#[derive(Clone, Copy, Default)]
pub(crate) struct Attitude {
    pub(crate) orientation: Orientation,
    pub(crate) gravity: Option<CoarseGravity>,
}

/// Extracts the features of an image, without what the mask hides.
pub(crate) fn extract(
    sealer: &Sealer,
    path: &Path,
    camera: KnownCamera,
    mask: Option<&Mask>,
    attitude: Attitude,
) -> Result<Extracted, SealError> {
    extract_image(sealer, Image::open(path)?, camera, mask, attitude)
}

/// As [`extract`], for an image in memory.
fn extract_image(
    sealer: &Sealer,
    image: Image,
    camera: KnownCamera,
    mask: Option<&Mask>,
    attitude: Attitude,
) -> Result<Extracted, SealError> {
    let image = match mask {
        Some(mask) => image.without(mask)?,
        None => image,
    };
    let extracted = sealer.extract(image, camera)?;
    Ok(extracted.with_orientation(attitude.orientation).with_gravity(attitude.gravity))
}

/// Seals the features of an image, in a session if there is one.
pub(crate) fn seal(
    sealer: &Sealer,
    extracted: Extracted,
    session: Option<&mut OpenSession>,
) -> Result<SealedQuery, ClientError> {
    match session {
        Some(session) => session.seal(sealer, extracted),
        None => Ok(sealer.seal(extracted, &mut device_rng()?)?),
    }
}

/// Seals one image as on a device. A problem of the image is returned as its error; a session that cannot be stored
/// ends the command.
pub(crate) fn seal_one(
    path: &Path,
    camera: CameraSource,
    sealer: &Sealer,
    mask: Option<&Mask>,
    attitude: Attitude,
    session: Option<&mut OpenSession>,
) -> Result<Result<Sealed, InputError>, Failure> {
    let known = match camera.of(path) {
        Ok(known) => known,
        Err(FeatureError::NoFocal { path, reason }) => {
            return Ok(Err(InputError::new(
                InputErrorKind::Unfit,
                format_args!("{}: {reason}; {GIVE_CAMERA}", path.display()),
            )));
        }
        Err(e) => return Ok(Err(InputError::new(InputErrorKind::Damaged, e))),
    };
    let extracted = match extract(sealer, path, known, mask, attitude) {
        Ok(extracted) => extracted,
        Err(error) => return Ok(Err(extraction_error(&error))),
    };
    let found = extracted.features().keypoints.len();
    match seal(sealer, extracted, session) {
        Ok(query) => {
            let (bytes, sent) = (query.encode(), query.len());
            let session = match query.sealed_in() {
                SealedIn::Session(session) => Some(session),
                SealedIn::Alone | SealedIn::Unknown => None,
            };
            Ok(Ok(Sealed { focal: known.focal, camera: known.intrinsics, bytes, found, sent, session }))
        }
        Err(ClientError::Seal(error)) => Ok(Err(InputError::new(InputErrorKind::Unfit, error))),
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
