//! Writes the points of a map as PLY, for viewers of point clouds.
//!
//! Binary, little-endian; for each point its position (map units), mean reprojection error (pixels) and number of
//! observing images. Turk, *The PLY Polygon File Format*, 1994.

use std::fmt::Write as _;
use std::path::Path;

use crate::atomic_file::write_atomic;

use crate::error::MapError;
use crate::model::MapModel;

/// Writes the points of a map in order; the file is replaced atomically.
///
/// # Errors
/// [`MapError::Model`]: the map is inconsistent; [`MapError::Io`].
pub fn write_ply(map: &MapModel, path: &Path) -> Result<(), MapError> {
    map.validate()?;
    write_atomic(path, &encode(map)).map_err(MapError::io(path))
}

fn encode(map: &MapModel) -> Vec<u8> {
    let mut head = String::from("ply\nformat binary_little_endian 1.0\n");
    writeln!(head, "element vertex {}", map.points.len()).expect("a string takes all that is written to it");
    for property in ["double x", "double y", "double z", "float error", "uint images"] {
        head.push_str("property ");
        head.push_str(property);
        head.push('\n');
    }
    head.push_str("end_header\n");
    let mut out = head.into_bytes();
    for point in &map.points {
        out.extend(point.position.coords.iter().flat_map(|x| x.to_le_bytes()));
        out.extend((point.error as f32).to_le_bytes());
        out.extend((point.track.len() as u32).to_le_bytes());
    }
    out
}
