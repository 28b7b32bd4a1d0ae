//! Cameras of other programs in COLMAP's models.

use std::path::Path;

use veiloc_geometry::Intrinsics;

use super::posed_input::faulty;
use crate::error::MappingError;

/// A camera with Brown's distortion, as OpenCV has it:
/// `x' = x (1 + k₁ r² + k₂ r⁴ + k₃ r⁶) + 2 p₁ x y + p₂ (r² + 2 x²)`, `y'` with `p₁` and `p₂` exchanged.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Brown {
    pub(super) size: (u32, u32),
    pub(super) focal: [f64; 2],
    /// Principal point from the corner, pixels.
    pub(super) principal: [f64; 2],
    /// `k₁` to `k₄`; a fourth term has no model here.
    pub(super) k: [f64; 4],
    pub(super) p: [f64; 2],
}

impl Brown {
    /// The simplest model that has its parameters.
    pub(super) fn intrinsics(&self, path: &Path) -> Result<Intrinsics, MappingError> {
        let Self { size: (w, h), focal: [fx, fy], principal: [cx, cy], k: [k1, k2, k3, k4], p: [p1, p2] } =
            *self;
        if k4 != 0.0 {
            let reason = "a camera has a fourth radial term (k4), which no camera model here has; export with three terms \
                          or undistorted images";
            return Err(faulty(path, reason));
        }
        let one_focal = fx == fy;
        let no_tangential = p1 == 0.0 && p2 == 0.0;
        let (model, params): (&str, Vec<f64>) = match (k3 == 0.0, no_tangential, k2 == 0.0, k1 == 0.0) {
            (false, ..) => ("FULL_OPENCV", vec![fx, fy, cx, cy, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]),
            (_, true, true, true) if one_focal => ("SIMPLE_PINHOLE", vec![fx, cx, cy]),
            (_, true, true, true) => ("PINHOLE", vec![fx, fy, cx, cy]),
            (_, true, true, _) if one_focal => ("SIMPLE_RADIAL", vec![fx, cx, cy, k1]),
            (_, true, ..) if one_focal => ("RADIAL", vec![fx, cx, cy, k1, k2]),
            _ => ("OPENCV", vec![fx, fy, cx, cy, k1, k2, p1, p2]),
        };
        intrinsics(path, model, (w, h), &params)
    }
}

/// A camera of COLMAP, with errors that name the file.
pub(super) fn intrinsics(
    path: &Path,
    model: &str,
    (width, height): (u32, u32),
    params: &[f64],
) -> Result<Intrinsics, MappingError> {
    Intrinsics::new(model, width, height, params).map_err(|e| faulty(path, format!("a camera: {e}")))
}
