//! What a session changes in how one of its frames is sealed.

use veiloc_query::LayoutTurn;

use crate::grid::AngleGrid;

/// By default nothing: the layout is fixed in the image, and positions are dithered.
#[derive(Default)]
pub(crate) struct FrameRule {
    /// How the layout is turned against the camera.
    pub(crate) turn: LayoutTurn,
    /// Half the width of what is left out along borders of sectors, radians about their axis.
    pub(crate) band: f64,
    /// What angles are told on; without it positions are dithered.
    pub(crate) grid: Option<AngleGrid>,
}
