//! The synthetic scenes: one well-conditioned, and two ill-conditioned ones.

use std::fmt;
use std::str::FromStr;

use veiloc_geometry::Pinhole;
use veiloc_synthetic::problems::PointProblemOptions;

/// What the camera looks at. Images are 640 × 480; depths are in map units.
///
/// | name | field of view | points |
/// |---|---|---|
/// | `deep` | 63° | depths 2 to 12 |
/// | `near-planar` | 63° | within 0.05 of a slanted plane 4 away |
/// | `narrow` | 20° | depths 2 to 6 |
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SyntheticScene {
    /// Much depth.
    Deep,
    /// All points near one plane.
    NearPlanar,
    /// A telephoto lens: rotation and sideways translation look alike.
    Narrow,
}

/// A text that is not the name of a synthetic scene.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a synthetic scene; use one of deep, near-planar and narrow")]
pub struct SceneError(String);

impl SyntheticScene {
    /// Every scene once.
    pub const ALL: [Self; 3] = [Self::Deep, Self::NearPlanar, Self::Narrow];

    /// The name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Deep => "deep",
            Self::NearPlanar => "near-planar",
            Self::Narrow => "narrow",
        }
    }

    /// Problems of this scene, without noise and outliers.
    pub(crate) fn problems(self, matches: usize) -> PointProblemOptions {
        let options = PointProblemOptions::exact(matches);
        match self {
            Self::Deep => options.depth(2.0, 12.0),
            Self::NearPlanar => options.depth(2.0, 6.0).near_planar(0.05),
            Self::Narrow => {
                let focal = 320.0 / 10.0_f64.to_radians().tan();
                let camera =
                    Pinhole { width: 640, height: 480, focal: [focal; 2], principal: [320.0, 240.0] };
                options.depth(2.0, 6.0).camera(camera)
            }
        }
    }
}

impl FromStr for SyntheticScene {
    type Err = SceneError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let known = Self::ALL.into_iter().find(|scene| scene.name() == text.trim());
        known.ok_or_else(|| SceneError(text.to_owned()))
    }
}

impl fmt::Display for SyntheticScene {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::SyntheticScene;

    #[test]
    fn scene_names_round_trip() {
        for scene in SyntheticScene::ALL {
            assert_eq!(scene.to_string().parse(), Ok(scene));
        }
        assert!("flat".parse::<SyntheticScene>().is_err());
    }

    #[test]
    fn narrow_scene_has_20_degree_field_of_view() {
        let camera = SyntheticScene::Narrow.problems(1).camera;
        let edge = camera.unproject(veiloc_geometry::Pixel::new(640.0, 240.0));
        assert!((2.0 * edge.x.atan().to_degrees() - 20.0).abs() < 1e-9);
    }
}
