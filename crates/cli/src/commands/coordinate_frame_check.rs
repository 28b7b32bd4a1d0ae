//! The flag of commands that build a map from given poses, and its use as a remedy.

use veiloc_mapping::OnOtherCoordinateFrame;

/// The remedy for images of another place that are localized in the map.
pub(in crate::commands) const REMEDY_OF_LOOK_ALIKES: &str =
    "if the images are of another place that only looks alike, use --no-coordinate-frame-check";

/// Whether poses are compared with the coordinate frame of the map.
#[derive(Debug, Clone, Copy, clap::Args)]
pub(in crate::commands) struct CoordinateFrameCheckArgs {
    /// Do not compare the poses of images with the coordinate frame of the map. For places that look alike, such as two floors of
    /// a building: images of the one may be localized, wrongly, in the other.
    #[arg(long)]
    no_coordinate_frame_check: bool,
}

impl CoordinateFrameCheckArgs {
    pub(in crate::commands) const fn on_other_coordinate_frame(self) -> OnOtherCoordinateFrame {
        if self.no_coordinate_frame_check {
            OnOtherCoordinateFrame::Accept
        } else {
            OnOtherCoordinateFrame::Refuse
        }
    }
}
