//! The flag of commands that build a map from given poses, and the remedy for places that look alike.

use veiloc_mapping::OnOtherFrame;

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
