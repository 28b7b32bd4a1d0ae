//! How a session is set up.

use std::fmt;
use std::str::FromStr;

/// What the anchors of a session are tied to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum SessionAnchors {
    /// The image: every frame for itself, as [`crate::seal`] does. Two frames of one place may give keypoints away.
    Image,
    /// The world: they stay where the first frame of the session has them.
    #[default]
    World,
    /// The world and gravity: the layout of the first frame is levelled first, its `y` axis down and its `z` axis where the camera
    /// looks, as far as that is level. An anchor at infinity in the direction 90° is then the vertical in every session.
    Gravity,
}

impl SessionAnchors {
    /// All of them, with the word that people write.
    const WORDS: [(Self, &str); 3] =
        [(Self::Image, "image"), (Self::World, "world"), (Self::Gravity, "gravity")];
}

impl fmt::Display for SessionAnchors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(Self::WORDS.iter().find(|w| w.0 == *self).map_or("", |w| w.1))
    }
}

/// A word that says nothing of what anchors are tied to.
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

/// How a session is set up. [`Self::default`] is what devices use.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct SessionOptions {
    /// What the anchors are tied to. Default [`SessionAnchors::World`].
    pub anchors: SessionAnchors,
    /// Keypoints nearer to a border of sectors than this, degrees about the sectors' axis, are left out, for they may cross it
    /// until the next frame: by the error of the orientation, by the detector's noise, by parallax. Default 0.5: that is twice what
    /// a phone's gyroscope errs by between frames, and 4 pixels of a camera with a focal length of 500.
    pub band_deg: f64,
    /// How far what is seen again may set an orientation right, degrees. Default 1.5: more than gyroscopes and odometry err by within a
    /// session, and less than the parallax of a step. Without memory nothing is set right.
    pub most_correction_deg: f64,
    /// Width of the cells that angles are told on, radians; 0 tells them as [`crate::seal`] does, dithered anew in each frame, so
    /// that those of a resting camera scatter. Default 0.002: coarser ones cost
    /// accuracy where images are sharp (decision 0019).
    pub step: f64,
    /// Whether the device remembers what it told of which keypoint, to tell it the same way again (module docs). Default true; without
    /// it angles of a resting camera scatter over neighbouring cells.
    pub memory: bool,
    /// How often the layout may be put somewhere new at one place; `None` for evaluations: any number. Places are told apart by what
    /// is remembered; without memory the whole session is one. Default 2, an image and one retry.
    pub most_starts: Option<u32>,
}

impl Default for SessionOptions {
    fn default() -> Self {
        Self {
            anchors: SessionAnchors::World,
            band_deg: 0.5,
            most_correction_deg: 1.5,
            step: 0.002,
            memory: true,
            most_starts: Some(2),
        }
    }
}

impl SessionOptions {
    /// The same with anchors tied to something else.
    #[must_use]
    pub const fn with_anchors(mut self, anchors: SessionAnchors) -> Self {
        self.anchors = anchors;
        self
    }

    /// The same with another band, degrees.
    #[must_use]
    pub const fn with_band_deg(mut self, band_deg: f64) -> Self {
        self.band_deg = band_deg;
        self
    }

    /// The same with orientations set right within another angle, degrees.
    #[must_use]
    pub const fn with_most_correction_deg(mut self, most: f64) -> Self {
        self.most_correction_deg = most;
        self
    }

    /// The same with other cells, radians; 0 for none.
    #[must_use]
    pub const fn with_step(mut self, step: f64) -> Self {
        self.step = step;
        self
    }

    /// The same with or without memory.
    #[must_use]
    pub const fn with_memory(mut self, memory: bool) -> Self {
        self.memory = memory;
        self
    }

    /// The same with another number of starts.
    #[must_use]
    pub const fn with_most_starts(mut self, most: Option<u32>) -> Self {
        self.most_starts = most;
        self
    }
}
