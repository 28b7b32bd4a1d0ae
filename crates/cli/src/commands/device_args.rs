//! Options that the device decides and a profile cannot override: the obfuscation scheme, and how much is sent.

use std::path::{Path, PathBuf};

use veiloc_obfuscation::{DeviceLimits, KnownPlace, PackUse, SealOptions, Sealer};
use veiloc_protocol::{CoarseGravity, FocalKnowledge, Pack, PackId, Profile, Scheme};

use crate::args::camera::{CameraArg, CameraSource};
use crate::args::feature_args::MapFeatureArgs;
use crate::args::global_args::ConsentArgs;
use crate::commands::seal::OTHER_ID;
use crate::output::exit::Failure;
use crate::output::files;
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
    /// The pack of the place, as written by `veiloc map pack`: nothing is sent that the place does not explain
    /// (docs/guide/pack.md). Default: none, or with --send that of the map or service.
    #[arg(long, value_name = "FILE")]
    pack: Option<PathBuf>,
    /// Id of the pack as the operator publishes it, 32 hexadecimal digits (`veiloc map pack` prints it): nothing is
    /// sealed with another one. Default: any pack.
    #[arg(long, value_name = "HEX")]
    pack_id: Option<PackId>,
    /// What is sent: `matches`, the points that keypoints match in the pack, and no descriptor; `explained`, the descriptors
    /// that the pack explains; `all` descriptors, without a pack. Default: `matches` with --pack, otherwise `all`.
    #[arg(long, value_name = "WHAT")]
    send: Option<Sent>,
    #[command(flatten)]
    features: MapFeatureArgs,
    #[command(flatten)]
    consent: ConsentArgs,
}

/// A pack, and what is sent with it, for attacks on what a device sends.
#[derive(clap::Args)]
pub(crate) struct PackArgs {
    /// The pack of the place, as written by `veiloc map pack`: attack only what a device with it sends. Keypoints that it
    /// sends as matches have the descriptors of their points in the pack. Default: none.
    #[arg(long, value_name = "FILE")]
    pack: Option<PathBuf>,
    /// What the device sends with the pack: matches or explained.
    #[arg(long, requires = "pack", default_value = "matches", value_name = "WHAT")]
    send: PackUse,
}

impl PackArgs {
    /// Returns the pack, prepared, and what is sent with it.
    pub(crate) fn place(&self) -> Result<Option<(KnownPlace, PackUse)>, Failure> {
        let prepared = |path: &PathBuf| Ok((KnownPlace::new(read_pack(path)?)?, self.send));
        self.pack.as_ref().map(prepared).transpose()
    }
}

/// What is sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Sent {
    /// All descriptors.
    All,
    /// Descriptors that the pack explains.
    Explained,
    /// Points of the pack, and no descriptor.
    Matches,
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

    /// Returns the pack, prepared, and what is sent with it; `of_map` gives the one of the map.
    fn place(
        &self,
        of_map: impl FnOnce() -> Result<Pack, Failure>,
    ) -> Result<Option<(KnownPlace, PackUse)>, Failure> {
        let usage = match (self.send, &self.pack) {
            (None | Some(Sent::All), None) => return Ok(None),
            (Some(Sent::All), Some(_)) => {
                return Err(Failure::with_help(
                    "--send all contradicts --pack",
                    "leave one of them out: with a pack, only what it explains is sent",
                ));
            }
            (Some(Sent::Explained), _) => PackUse::Explained,
            (Some(Sent::Matches) | None, _) => PackUse::Matches,
        };
        let pack = match &self.pack {
            Some(path) => read_pack(path)?,
            None => of_map()?,
        };
        if let Some(expected) = self.pack_id.filter(|expected| *expected != pack.id()) {
            return Err(Failure::with_help(
                format!("the id of the pack is {}, not {expected}", pack.id()),
                OTHER_ID,
            ));
        }
        Ok(Some((KnownPlace::new(pack)?, usage)))
    }

    /// Returns the sealer for a map, whose pack `of_map` gives. Warns if keypoint positions are sent.
    pub(crate) fn sealer(
        &self,
        profile: &Profile,
        of_map: impl FnOnce() -> Result<Pack, Failure>,
        ui: &Ui,
    ) -> Result<Sealer, Failure> {
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
        let options = match self.place(of_map)? {
            Some((place, usage)) => options.with_place(place, usage),
            None => options,
        };
        self.consent.sealer(options, &self.features.models(), profile, ui)
    }
}

/// Reads a pack file.
pub(crate) fn read_pack(path: &Path) -> Result<Pack, Failure> {
    Pack::decode(&files::read(path)?).map_err(|e| {
        Failure::with_help(
            format!("{}: {e}", path.display()),
            "write the pack again with `veiloc map pack MAP -o FILE`, or fetch it from the service",
        )
    })
}
