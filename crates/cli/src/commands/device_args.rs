//! What a device decides, whatever a profile says: the scheme, and how much it sends.

use veiloc_obfuscation::SealOptions;
use veiloc_query::{Profile, Scheme};

use crate::exit::Failure;
use crate::ui::Ui;

/// How an image is sealed.
#[derive(clap::Args)]
pub(crate) struct DeviceArgs {
    /// How keypoints are hidden: dcl, dcl:horizontal, dcl:angle=DEGREES, random-lines, coordinate-permutation, or
    /// points, which sends their positions as they are. The device decides, not the map or the service.
    #[arg(long, default_value = "dcl")]
    scheme: Scheme,
    /// Send at most N keypoints, the strongest, cut to a size class (256, 512, 1024, 2048, 4096); what is not sent is
    /// not leaked, and the pose gets a little less exact (docs/audit.md). Default: as many as the profile asks for,
    /// 2048 at most.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(256..=4096))]
    max_keypoints: Option<u32>,
}

impl DeviceArgs {
    /// What happens to positions.
    pub(crate) const fn scheme(&self) -> Scheme {
        self.scheme
    }

    /// Ready to seal with. Warns when positions are sent, and says when a profile wishes for another scheme.
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
        if let Some(wish) = profile.wish().filter(|wish| wish.scheme != self.scheme) {
            ui.say(format!("the profile asks for the scheme {}; {} is used", wish.scheme, self.scheme));
        }
        Ok(self
            .max_keypoints
            .map_or_else(|| options.clone(), |n| options.clone().with_max_keypoints(n as usize)))
    }
}
