//! `veiloc seal`: images to sealed queries, as a device does it.

mod batch;

use std::path::{Path, PathBuf};

use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{ExtractError, device_rng, extract, seal_at_most};
use veiloc_query::{Profile, Scheme};

use crate::camera::CameraArg;
use crate::exit::{Failure, Outcome};
use crate::files;
use crate::items::{Fault, FaultKind, SkipArgs};
use crate::ui::Ui;

/// Turn images into sealed queries.
///
/// A sealed query holds descriptors and lines, never keypoints; it is all a server gets. Nothing of the file but its
/// pixels is read: no EXIF, no time, no place. Everything random comes from the operating system's generator, so
/// sealing one image twice gives two different queries; never send both (see docs/privacy.md, rule L7).
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
    /// with one camera. Default: what the list says.
    #[arg(long, value_name = "MODEL,W,H,PARAMS…|FILE", required_unless_present = "list")]
    camera: Option<CameraArg>,
    /// The map's profile, as `veiloc map profile` writes it.
    #[arg(long, value_name = "FILE")]
    profile: PathBuf,
    /// How keypoints are hidden: dcl, dcl:horizontal, dcl:angle=DEGREES, random-lines, coordinate-permutation, or
    /// points (no protection). Default: what the profile asks for.
    #[arg(long)]
    scheme: Option<Scheme>,
    #[command(flatten)]
    amount: AmountArgs,
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

/// How much a device sends, of its own will.
#[derive(clap::Args)]
pub(crate) struct AmountArgs {
    /// Send at most N keypoints, the strongest, cut to a size class (256, 512, 1024, 2048); what is not sent is not
    /// leaked, and the pose gets a little less exact (docs/audit.md). Default: as many as the profile asks for.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(256..=4096))]
    max_keypoints: Option<u32>,
}

impl AmountArgs {
    /// Most keypoints to send.
    pub(crate) fn most(&self) -> usize {
        self.max_keypoints.map_or(usize::MAX, |n| n as usize)
    }
}

pub(crate) fn run(args: &Args, ui: &Ui) -> Outcome {
    let mut profile = read_profile(&args.profile)?;
    if let Some(scheme) = args.scheme {
        profile = profile.with_scheme(scheme);
    }
    batch::run(args, &profile, ui)
}

/// One image sealed.
struct Sealed {
    bytes: Vec<u8>,
    /// Keypoints found in the image.
    found: usize,
    /// Rows sent.
    sent: usize,
}

/// Seals one image, all a device does with it.
fn seal_one(path: &Path, camera: &Intrinsics, profile: &Profile, most: usize) -> Result<Sealed, Fault> {
    let (features, camera) = extract(path, camera, profile).map_err(|e| {
        let kind = match e {
            ExtractError::ImageSize { .. } => FaultKind::Unfit,
            _ => FaultKind::Damaged,
        };
        Fault::new(kind, e)
    })?;
    let found = features.keypoints.len();
    let mut rng = device_rng().map_err(|e| Fault::new(FaultKind::Unfit, e))?;
    let query = seal_at_most(features, &camera, profile, most, &mut rng)
        .map_err(|e| Fault::new(FaultKind::Unfit, e))?;
    Ok(Sealed { bytes: query.encode(), found, sent: query.len() })
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
