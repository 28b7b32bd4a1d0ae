//! Content anchors: `GET /v1/maps/{map}/anchors`.

use std::sync::Arc;

use crate::alignment::Alignment;
use crate::error::VeilocException;
use crate::pose::{CameraPose, Pose};

/// The content anchors of a map.
#[derive(uniffi::Object)]
pub struct ContentAnchors {
    anchors: veiloc_protocol::ContentAnchors,
}

/// A content anchor in the AR world.
#[derive(Debug, Clone, PartialEq, uniffi::Record)]
pub struct PlacedAnchor {
    /// Its name.
    pub name: String,
    /// Its content, JSON.
    pub content: String,
    /// Its pose, in the axes and units of the framework.
    pub world_from_anchor: Pose,
    /// Its distance from the camera, metres.
    pub distance: f64,
}

#[uniffi::export]
impl ContentAnchors {
    /// Reads content anchors: the body of status 200.
    ///
    /// # Errors
    /// [`VeilocException::Answer`].
    #[uniffi::constructor]
    pub fn new(bytes: Vec<u8>) -> Result<Arc<Self>, VeilocException> {
        let anchors = veiloc_protocol::ContentAnchors::decode(&bytes);
        Ok(Arc::new(Self { anchors: anchors.map_err(|e| VeilocException::Answer(e.to_string()))? }))
    }

    /// All in the AR world, in the axes of the camera's pose, the nearest first; none before the first trusted answer.
    ///
    /// # Errors
    /// [`VeilocException::Argument`] for a pose that is no rotation.
    pub fn place(
        &self,
        alignment: Arc<Alignment>,
        camera_in_world: CameraPose,
    ) -> Result<Vec<PlacedAnchor>, VeilocException> {
        let camera = camera_in_world.cam_from_ar()?;
        let alignment = alignment.locked();
        let placed = |found: &veiloc_ar::PlacedAnchor<'_>| PlacedAnchor {
            name: found.anchor.name.clone(),
            content: found.anchor.content.to_string(),
            world_from_anchor: found.world_from_anchor.into(),
            distance: found.distance,
        };
        let all = alignment.place_anchors(camera_in_world.axes.into(), &self.anchors, &camera);
        Ok(all.iter().map(placed).collect())
    }
}
