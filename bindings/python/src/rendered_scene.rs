//! A rendered scene with ground-truth poses, for experiments without data.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use image::{ImageFormat, RgbImage};
use pyo3::prelude::*;
use veiloc_geometry::{CameraFromWorld, Intrinsics, Panorama, RigFromWorld};
use veiloc_pose::Stop;
use veiloc_synthetic::{PathOptions, RenderOptions, RenderedRoom};

use crate::blocking::interruptible;
use crate::errors::{BindingError, Result};
use crate::pose::CameraPose;

/// The camera of all images; it is small so that examples are fast.
const CAMERA: &str = "SIMPLE_RADIAL,400,300,330,200,150,-0.02";

/// Images for the map or for queries: name, camera, ground-truth pose.
type Views = Vec<(String, String, CameraPose)>;

/// Renders images of a synthetic room into a folder.
///
/// Args:
///     folder: folder for the images; it must exist.
///     mapped, queries: number of images for the map (at most 30) and for queries (at most 9).
///     seed: seed of the room; equal seeds give equal rooms.
///     panorama_width: render equirectangular panoramas of this width, even and at least 256; the camera is then
///         `EQUIRECTANGULAR,W,H`, and the pose that of the panorama's frame (x right, y down, z to its middle). Default: images of a
///         pinhole camera.
///
/// Returns:
///     Two lists of (name, camera, CameraPose) for `Map.build`: images for the map, and images for queries. Units are
///     metres.
///
/// Raises:
///     Error: an image cannot be written.
///     InputError: `mapped` or `queries` is too large, or `panorama_width` is none.
#[pyfunction]
#[pyo3(signature = (folder, *, mapped=10, queries=3, seed=11, panorama_width=None))]
pub(crate) fn render_room(
    py: Python<'_>,
    folder: PathBuf,
    mapped: usize,
    queries: usize,
    seed: u64,
    panorama_width: Option<u32>,
) -> Result<(Views, Views)> {
    let (most_mapped, most_queries) = (30, 9);
    if mapped > most_mapped || queries > most_queries {
        return Err(BindingError::input(format_args!(
            "mapped: at most {most_mapped} images; queries: at most {most_queries}"
        )));
    }
    let camera: Intrinsics = CAMERA.parse()?;
    let panorama = panorama_width.map(|width| {
        Panorama::new(width, width / 2)
            .ok_or_else(|| BindingError::input("panorama_width: an even number of at least 256"))
    });
    let panorama = panorama.transpose()?;
    let camera_text = panorama.map_or_else(
        || CAMERA.to_owned(),
        |panorama| format!("EQUIRECTANGULAR,{},{}", panorama.width(), panorama.height()),
    );
    interruptible(py, &Stop::default(), || {
        let scene = RenderedRoom::generate(seed);
        let path = scene.camera_path(&PathOptions::with_counts(most_mapped, most_queries));
        let views = |kind: &str, first: u64, poses: &[CameraFromWorld]| -> Result<Views> {
            let one = |(seed, pose): (u64, &CameraFromWorld)| {
                let name = format!("{kind}-{seed:02}.png");
                let options = RenderOptions::with_seed(seed);
                match panorama {
                    Some(panorama) => {
                        let rig_from_world = RigFromWorld::new(*pose.rotation(), *pose.translation());
                        write(
                            &folder.join(&name),
                            &scene.render_panorama(&rig_from_world, panorama, &options),
                        )?;
                    }
                    None => write(&folder.join(&name), scene.render(pose, &camera, &options).rgb())?,
                }
                Ok((name, camera_text.clone(), CameraPose(*pose)))
            };
            (first..).zip(poses).map(one).collect()
        };
        Ok((views("map", 1, &path.mapping[..mapped])?, views("query", 100, &path.queries[..queries])?))
    })?
}

fn write(path: &Path, image: &RgbImage) -> Result<()> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, ImageFormat::Png).map_err(BindingError::other)?;
    let refused = |why| BindingError::other(format_args!("{}: {why}", path.display()));
    veiloc_map::atomic_file::write_atomic(path, bytes.get_ref()).map_err(refused)
}
