//! Known positions from a file: of images, or of points.
//!
//! Fields are separated by commas or white space, `#` begins a comment:
//!
//! ```text
//! walk/a.jpg, 12.50, 3.25, 1.60          the centre of an image's camera, in the new coordinate frame
//! 0.51 -0.20 4.02  12.50 3.25 1.60       a point in the map, and in the new coordinate frame
//! ```

use std::path::Path;

use veiloc_geometry::nalgebra::Vector3;
use veiloc_map::text::read_text;
use veiloc_map::{GravityDirection, MapModel};

use super::known::{KnownPosition, KnownPositions, grid_step};
use crate::error::MappingError;
use crate::importers::lines::Line;
use crate::input::image_names::NameIndex;

/// Reads known positions of a map's images or points. Their `z` axis is up, unless [`KnownPositions::down`] is changed.
/// Names that the map does not have are left out and counted.
///
/// # Errors
/// [`MappingError::PosesLine`] names file and line; [`MappingError::Io`].
pub fn read_positions(path: &Path, model: &MapModel) -> Result<KnownPositions, MappingError> {
    let content = read_text(path).map_err(MappingError::io(path))?;
    let index = NameIndex::new(model.images.iter().map(|image| (image.name.as_str(), image)));
    let (mut positions, mut unknown) = (Vec::new(), Vec::new());
    for (number, line) in (1..).zip(content.lines()) {
        let line = line.split('#').next().unwrap_or_default();
        let has_commas = line.contains(',');
        let words: Vec<&str> = if has_commas {
            line.split(',').map(str::trim).collect()
        } else {
            line.split_whitespace().collect()
        };
        if words.iter().all(|word| word.is_empty()) {
            continue;
        }
        let line = Line { path, number, words };
        let is_point = line.words.len() == 6 && line.words[0].parse::<f64>().is_ok();
        if is_point {
            let in_map = Vector3::from(line.numbers::<3>(0, "a position in the map")?);
            let known = Vector3::from(line.numbers::<3>(3, "a known position")?);
            positions.push(KnownPosition {
                name: format!("line {number}"),
                in_map,
                known,
                has_height: true,
                sd: 0.0,
            });
            continue;
        }
        // A name may contain spaces.
        let at = line.words.len().checked_sub(3).filter(|at| *at > 0);
        let at = at.ok_or_else(|| {
            line.fault("write NAME X Y Z, or X Y Z in the map and X Y Z in the new coordinate frame")
        })?;
        let name = line.words[..at].join(if has_commas { "," } else { " " });
        let known = Vector3::from(line.numbers::<3>(at, "a known position")?);
        match index.get(&name) {
            Some(image) => {
                let in_map = image.cam_from_world.center().coords;
                positions.push(KnownPosition { name, in_map, known, has_height: true, sd: 0.0 });
            }
            None => unknown.push(name),
        }
    }
    let numbers: Vec<f64> = positions.iter().flat_map(|p| p.known.iter().copied()).collect();
    let remarks = unknown.first().map(|first| {
        format!("{}: {} names are not in the map, the first is {first}", path.display(), unknown.len())
    });
    Ok(KnownPositions {
        positions,
        down: Some(GravityDirection::MINUS_Z),
        has_heights: true,
        grid: grid_step(&numbers, &GRIDS),
        is_list: true,
        remarks: remarks.into_iter().collect(),
        ..KnownPositions::default()
    })
}

/// Grids that numbers of a file may be rounded to, new units.
const GRIDS: [f64; 4] = [10.0, 1.0, 0.1, 0.01];
