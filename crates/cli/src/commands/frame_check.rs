//! The flag of commands that build a map from given poses, and its use as a remedy.

use veiloc_mapping::OnOtherFrame;

/// The remedy for images of another place that are localized in the map.
pub(in crate::commands) const REMEDY_OF_LOOK_ALIKES: &str =
    "if the images are of another place that only looks alike, use --no-frame-check";

/// Whether poses are compared with the frame of the map.
#[derive(Debug, Clone, Copy, clap::Args)]
pub(in crate::commands) struct FrameCheckArgs {
    /// Do not compare the poses of images with the frame of the map. For places that look alike, such as two floors of
    /// a building: images of the one may be localized, wrongly, in the other.
    #[arg(long)]
    no_frame_check: bool,
}

impl FrameCheckArgs {
    pub(in crate::commands) const fn on_other_frame(self) -> OnOtherFrame {
        if self.no_frame_check { OnOtherFrame::Accept } else { OnOtherFrame::Refuse }
    }
}
