//! What a device decides, whatever a profile says: the scheme, and how much it sends.

use veiloc_obfuscation::SealOptions;
use veiloc_protocol::{CoarseGravity, FocalKnowledge, Profile, Scheme};

use crate::args::camera::{CameraArg, CameraSource};
use crate::args::feature_args::MapFeatureArgs;
use crate::args::global_args::ConsentArgs;
use crate::exit::Failure;
use crate::ui::Ui;

/// How an image is sealed.
#[derive(clap::Args)]
pub(crate) struct DeviceArgs {
    /// How keypoints are hidden: dcl, random-lines, coordinate-permutation, or points, which sends their positions as they
    /// are. The device decides, not the map or the service. dcl is the paper's two halves (dcl:horizontal,
    /// dcl:angle=DEGREES cut them elsewhere); dcl:axis=DEGREES:sectors=COUNT:anchors=X/Y+X/Y joins stripes to anchors of
    /// your own, more exact and with other leaks (research/notes/layouts.md).
    #[arg(long, default_value = "dcl")]
    scheme: Scheme,
    /// Send at most N keypoints, the strongest, cut to a size class (256, 512, 1024, 2048, 4096); what is not sent is
    /// not leaked, and the pose gets a little less exact (docs/results/privacy.md). Default: as many as the profile asks for,
    /// 2048 at most.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(256..=4096))]
    max_keypoints: Option<u32>,
    /// How well the focal length of a camera that is given is known: calibrated, exif or unknown. The server estimates it
    /// too where it is not calibrated. Default: calibrated; of a camera from EXIF exif, of an unknown one unknown.
    #[arg(long, value_name = "WORD")]
    focal_known: Option<FocalKnowledge>,
    /// The direction in which things fall, as an accelerometer felt it when the image was taken, in the axes of the stored
    /// image (x right, y down, z forward; 0,1,0 for an upright one), of any length, and its standard deviation in degrees
    /// (2). It is sent rounded to about a degree, and helps where the map knows which way is down (`map build --down`), most
    /// where little is seen. Default: not sent.
    #[arg(long, value_name = "X,Y,Z[,SD_DEG]", allow_hyphen_values = true)]
    gravity: Option<CoarseGravity>,
    #[command(flatten)]
    features: MapFeatureArgs,
    #[command(flatten)]
    consent: ConsentArgs,
}

impl DeviceArgs {
    /// What happens to positions.
    pub(crate) const fn scheme(&self) -> Scheme {
        self.scheme
    }

    /// Where the camera of an image comes from: what was given, else its EXIF.
    pub(crate) fn camera(&self, given: Option<&CameraArg>) -> Result<CameraSource, Failure> {
        match (given, self.focal_known) {
            (Some(CameraArg::Unknown), Some(focal)) if focal != FocalKnowledge::Unknown => {
                Err(Failure::with_help(
                    format!("--focal-known {focal} says that an unknown camera is known"),
                    "leave it out, or give the camera with --camera",
                ))
            }
            (Some(camera), _) => camera.source(self.known_of_given()),
            (None, _) => Ok(CameraSource::Exif),
        }
    }

    /// How well the focal length of cameras that are given is known.
    pub(crate) fn known_of_given(&self) -> FocalKnowledge {
        self.focal_known.unwrap_or_default()
    }

    /// Whether gravity is told, which is of one image.
    pub(crate) const fn tells_gravity(&self) -> bool {
        self.gravity.is_some()
    }

    /// Which way is down, if it was told.
    pub(crate) const fn gravity(&self) -> Option<CoarseGravity> {
        self.gravity
    }

    /// Ready to seal with. Warns when positions are sent.
    pub(crate) fn options(&self, profile: &Profile, ui: &Ui) -> Result<SealOptions, Failure> {
        let options = match self.scheme {
            Scheme::Points => {
                ui.complain(
                    "WARNING: --scheme points hides nothing: the position of every keypoint is sent, and with the \
                     descriptors the image can be reconstructed from them",
                );
                SealOptions::unprotected_points()
            }
            Scheme::RandomLines | Scheme::CoordinatePermutation | Scheme::Dcl(_) => {
                SealOptions::new(self.scheme)?
            }
        };
        let extractors = self.features.extractors(profile)?.sealing();
        let options = options.with_gravity(self.gravity).with_extractors(extractors);
        let options = self.consent.consented(options, &self.features.models(), profile, ui)?;
        Ok(self
            .max_keypoints
            .map_or_else(|| options.clone(), |n| options.clone().with_max_keypoints(n as usize)))
    }
}
