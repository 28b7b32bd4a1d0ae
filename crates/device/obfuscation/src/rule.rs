//! How a session changes the sealing of one of its frames.

use veiloc_protocol::{CanonicalCamera, LayoutTurn};

use crate::grid::AngleGrid;
use crate::schemes::dcl::AnchorAngle;

/// By default nothing changes: the layout is fixed in the image, and positions are dithered.
#[derive(Default)]
pub(crate) struct FrameRule {
    /// The camera of the session; that of the image's own device where there is none.
    pub(crate) camera: Option<CanonicalCamera>,
    /// Rotation of the layout relative to the camera.
    pub(crate) turn: LayoutTurn,
    /// Half the width of the band along sector borders whose keypoints are dropped, radians about the sectors' axis.
    pub(crate) band: f64,
    /// The grid on which angles are quantized; without one, positions are dithered.
    pub(crate) grid: Option<AngleGrid>,
    /// By feature of the frame, the row that was sent for it earlier; empty when all features are new.
    pub(crate) history: Vec<RowHistory>,
}

impl FrameRule {
    /// The row that was sent earlier for a feature.
    pub(crate) fn history(&self, feature: usize) -> RowHistory {
        self.history.get(feature).copied().unwrap_or(RowHistory::New)
    }
}

/// Whether and how a keypoint was sent in earlier frames, which decides how it is sent now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum RowHistory {
    /// No earlier row of it is still valid.
    New,
    /// It is at the same direction: the same row is sent again.
    Repeat(AnchorAngle),
    /// It was sent with another anchor, and the line of its new anchor would cross that one: it is dropped.
    OtherAnchor,
}
