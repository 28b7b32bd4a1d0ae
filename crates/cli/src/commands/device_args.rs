//! Options that the device decides and a profile cannot override: the obfuscation scheme, and how much is sent.

use veiloc_obfuscation::{DeviceLimits, SealOptions, Sealer};
use veiloc_protocol::{CoarseGravity, FocalKnowledge, Profile, Scheme};

use crate::args::camera::{CameraArg, CameraSource};
use crate::args::feature_args::MapFeatureArgs;
use crate::args::global_args::ConsentArgs;
use crate::output::exit::Failure;
use crate::output::ui::Ui;

/// How an image is sealed.
#[derive(clap::Args)]
pub(crate) struct DeviceArgs {
    /// Obfuscation scheme: dcl, random-lines, coordinate-permutation, or points, which sends keypoint positions in the
    /// clear. The device decides, not the map or the service. dcl has slanted strips; dcl:paper has the paper's two
    /// halves (dcl:horizontal and dcl:angle=DEGREES change the border between them), and
    /// dcl:axis=DEGREES:sectors=COUNT:anchors=X/Y+X/Y assigns strips to anchors of your choice, with another accuracy
    /// and other leaks (docs/results/privacy.md).
    #[arg(long, default_value = "dcl")]
    scheme: Scheme,
    /// Send at most N keypoints, the strongest, rounded down to a size class (256, 512, 1024, 2048, 4096); keypoints
    /// that are not sent leak nothing, and the pose gets slightly less accurate (docs/results/privacy.md). Default: as many as
    /// the profile requests, at most 2048.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(256..=4096))]
    max_keypoints: Option<u32>,
    /// Scale images down to at most this longest side, pixels, whatever the profile requests: smaller images give coarser
    /// positions. The largest of 64, 144, 240, 360, 480, 640, 1024, 1600 and 2048 below this number and the profile's
    /// is used. Default: 2048.
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(64..=8192))]
    max_image_side: Option<u32>,
    /// Knowledge of the focal length of a given camera: calibrated, exif or unknown. The server also estimates a focal
    /// length that is not calibrated. Default: calibrated for a given camera, exif for a camera from EXIF, unknown for
    /// an unknown one.
    #[arg(long, value_name = "WORD")]
    focal_known: Option<FocalKnowledge>,
    /// Direction of gravity (down), measured by an accelerometer when the image was taken, in the axes of the stored
    /// image (x right, y down, z forward; 0,1,0 for an upright camera), of any length, and its standard deviation in
    /// degrees (default 2). It is sent rounded to about a degree, and helps if the map knows the direction of gravity
    /// (`map build --down`), most if few points are visible. Default: not sent.
    #[arg(long, value_name = "X,Y,Z[,SD_DEG]", allow_hyphen_values = true)]
    gravity: Option<CoarseGravity>,
    #[command(flatten)]
    features: MapFeatureArgs,
    #[command(flatten)]
    consent: ConsentArgs,
}

impl DeviceArgs {
    /// Returns the obfuscation scheme.
    pub(crate) const fn scheme(&self) -> Scheme {
        self.scheme
    }

    /// Returns the source of an image's camera: the given camera, otherwise EXIF.
    pub(crate) fn camera(&self, given: Option<&CameraArg>) -> Result<CameraSource, Failure> {
        match (given, self.focal_known) {
            (Some(CameraArg::Unknown), Some(focal)) if focal != FocalKnowledge::Unknown => {
                Err(Failure::with_help(
                    format!("--focal-known {focal} contradicts an unknown camera"),
                    "leave it out, or give the camera with --camera",
                ))
            }
            (Some(camera), _) => camera.source(self.focal_knowledge()),
            (None, _) => Ok(CameraSource::Exif),
        }
    }

    /// Returns the knowledge of the focal length of given cameras.
    pub(crate) fn focal_knowledge(&self) -> FocalKnowledge {
        self.focal_known.unwrap_or_default()
    }

    /// Returns whether gravity is given, which is valid for one image only.
    pub(crate) const fn has_gravity(&self) -> bool {
        self.gravity.is_some()
    }

    /// Returns the direction of gravity, if given.
    pub(crate) const fn gravity(&self) -> Option<CoarseGravity> {
        self.gravity
    }

    /// Returns the sealer for a map. Warns if keypoint positions are sent.
    pub(crate) fn sealer(&self, profile: &Profile, ui: &Ui) -> Result<Sealer, Failure> {
        let options = match self.scheme {
            Scheme::Points => {
                ui.warn(
                    "WARNING: --scheme points hides nothing: the position of every keypoint is sent, and \
                     the image can be reconstructed from positions and descriptors",
                );
                SealOptions::unprotected_points()
            }
            Scheme::RandomLines | Scheme::CoordinatePermutation | Scheme::Dcl(_) => {
                SealOptions::new(self.scheme)?
            }
        };
        let extractors = self.features.extractors(profile)?.sealing();
        let mut limits = DeviceLimits::default();
        limits.max_image_side = self.max_image_side.unwrap_or(limits.max_image_side);
        let options = options.with_extractors(extractors).with_limits(limits);
        let options = match self.max_keypoints {
            Some(most) => options.with_max_keypoints(most as usize),
            None => options,
        };
        self.consent.sealer(options, &self.features.models(), profile, ui)
    }
}
