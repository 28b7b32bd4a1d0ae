//! What a session changes in how one of its frames is sealed.

use veiloc_protocol::LayoutTurn;

use crate::grid::AngleGrid;
use crate::schemes::dcl::Told;

/// By default nothing: the layout is fixed in the image, and positions are dithered.
#[derive(Default)]
pub(crate) struct FrameRule {
    /// How the layout is turned against the camera.
    pub(crate) turn: LayoutTurn,
    /// Half the width of what is left out along borders of sectors, radians about their axis.
    pub(crate) band: f64,
    /// What angles are told on; without it positions are dithered.
    pub(crate) grid: Option<AngleGrid>,
    /// By feature of the frame, what was told of it before; all are new when it is empty.
    pub(crate) recalled: Vec<Recalled>,
}

impl FrameRule {
    /// What was told before of a feature.
    pub(crate) fn recalled(&self, feature: usize) -> Recalled {
        self.recalled.get(feature).copied().unwrap_or(Recalled::New)
    }
}

/// What becomes of a keypoint by what was told of it in earlier frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Recalled {
    /// Nothing that still holds was told of it.
    New,
    /// It is where it was, and is told as it was.
    Same(Told),
    /// It was told by a line of another anchor, which its new one would cross: it is left out.
    Crossed,
}
