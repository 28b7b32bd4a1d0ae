//! Options of a session.

use std::fmt;
use std::str::FromStr;

/// What the anchors of a session are tied to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum SessionAnchors {
    /// The image: every frame is sealed for itself, as [`Sealer::seal`](crate::Sealer::seal) does. Two frames of one scene may reveal
    /// keypoints.
    Image,
    /// The world: the anchors stay where the first frame of the session places them.
    #[default]
    World,
    /// The world and gravity: the layout of the first frame is levelled, its `y` axis down and its `z` axis along the
    /// horizontal component of the viewing direction. An anchor at infinity in the direction 90° is then the vertical
    /// in every session.
    Gravity,
}

impl SessionAnchors {
    /// All of them, with their names in text form.
    const WORDS: [(Self, &str); 3] =
        [(Self::Image, "image"), (Self::World, "world"), (Self::Gravity, "gravity")];
}

impl fmt::Display for SessionAnchors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(Self::WORDS.iter().find(|w| w.0 == *self).map_or("", |w| w.1))
    }
}

/// An unknown name for what anchors are tied to.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("anchors cannot be tied to {0:?}; write image, world or gravity")]
pub struct SessionAnchorsError(String);

impl FromStr for SessionAnchors {
    type Err = SessionAnchorsError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let found = Self::WORDS.iter().find(|w| w.1 == text.trim());
        found.map(|w| w.0).ok_or_else(|| SessionAnchorsError(text.to_owned()))
    }
}

/// Options of a session. Devices use [`Self::default`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct SessionOptions {
    /// What the anchors are tied to. Default [`SessionAnchors::World`].
    pub anchors: SessionAnchors,
    /// Keypoints nearer to a sector border than this, degrees about the sectors' axis, are dropped: orientation errors,
    /// detector noise or parallax may carry them across until the next frame. Default 0.5: twice the error of a phone's
    /// gyroscope between frames, and 4 pixels of a camera with a focal length of 500.
    pub band_deg: f64,
    /// Largest correction of a measured orientation by recognized keypoints, degrees. Default 1.5: more than the error
    /// of gyroscopes and odometry within a session, and less than the parallax of a step. Without memory nothing is
    /// corrected.
    pub max_correction_deg: f64,
    /// Width of the cells on which angles are quantized, radians; 0 disables the grid, and angles are dithered anew in
    /// each frame as in [`Sealer::seal`](crate::Sealer::seal), so that those of a static camera scatter. Default 0.002: coarser cells cost
    /// accuracy where images are sharp (decision 0019).
    pub step: f64,
    /// Whether the device stores the sent rows, to send the same row for a keypoint that is seen again (module docs).
    /// Default true; without it, angles of a static camera scatter over neighbouring cells.
    pub memory: bool,
    /// How often the layout may be placed for one scene; `None`, for evaluations, means any number. Scenes are
    /// recognized by the stored landmarks; without memory the whole session counts as one scene. Default 2: an image
    /// and one retry.
    pub max_starts: Option<u32>,
}

impl Default for SessionOptions {
    fn default() -> Self {
        Self {
            anchors: SessionAnchors::World,
            band_deg: 0.5,
            max_correction_deg: 1.5,
            step: 0.002,
            memory: true,
            max_starts: Some(2),
        }
    }
}

impl SessionOptions {
    /// These options with other anchors.
    #[must_use]
    pub const fn with_anchors(mut self, anchors: SessionAnchors) -> Self {
        self.anchors = anchors;
        self
    }

    /// These options with another band, degrees.
    #[must_use]
    pub const fn with_band_deg(mut self, band_deg: f64) -> Self {
        self.band_deg = band_deg;
        self
    }

    /// These options with another cell width, radians; 0 for no grid.
    #[must_use]
    pub const fn with_step(mut self, step: f64) -> Self {
        self.step = step;
        self
    }

    /// These options with or without memory.
    #[must_use]
    pub const fn with_memory(mut self, memory: bool) -> Self {
        self.memory = memory;
        self
    }

    /// These options with another number of starts.
    #[must_use]
    pub const fn with_max_starts(mut self, most: Option<u32>) -> Self {
        self.max_starts = most;
        self
    }
}
