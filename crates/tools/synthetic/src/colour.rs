//! Colours: reflectance of surfaces and values of images.

use nalgebra::Vector3;

/// Linear reflectance, red, green, blue, 0 to 1.
pub(crate) type Colour = Vector3<f32>;

/// A colour from its channels.
pub(crate) const fn colour(r: f32, g: f32, b: f32) -> Colour {
    Vector3::new(r, g, b)
}
