//! Reads a list of images with their cameras, for all commands that seal listed images.

use std::path::{Component, Path};

use crate::args::camera::{CameraArg, CameraSource};
use veiloc_obfuscation::KnownCamera;

use crate::commands::device_args::DeviceArgs;
use crate::output::exit::Failure;
use crate::output::items::{self, Item};
use crate::output::lists;

/// Returns the images that a list names in a folder, with their cameras: the camera in the list, otherwise the given
/// one.
///
/// # Errors
/// The list is invalid, a name leads out of the folder, or both the list and the command line give a camera.
pub(crate) fn images_of_list(
    list: &Path,
    folder: &Path,
    device: &DeviceArgs,
    given: Option<&CameraArg>,
) -> Result<Vec<(Item, CameraSource)>, Failure> {
    let camera = device.camera(given)?;
    let (cameras, names): (Vec<CameraSource>, Vec<String>) = lists::read_with_cameras(list)?
        .into_iter()
        .map(|listed| {
            let at = || format!("{}: line {}: {}", list.display(), listed.line, listed.name);
            let inside = |c| matches!(c, Component::Normal(_) | Component::CurDir);
            if !Path::new(&listed.name).components().all(inside) {
                return Err(Failure::with_help(
                    format!("{} leads out of {}", at(), folder.display()),
                    "name images relative to the given folder, without `..`",
                ));
            }
            let camera = match (listed.camera, given) {
                (Some(intrinsics), None) => {
                    CameraSource::Given(KnownCamera { intrinsics, focal: device.focal_knowledge() })
                }
                (None, _) => camera,
                (Some(_), Some(_)) => {
                    return Err(Failure::with_help(
                        format!("{} has its own camera, and --camera is given too", at()),
                        "leave out --camera, or give a list without cameras",
                    ));
                }
            };
            Ok((camera, listed.name))
        })
        .collect::<Result<Vec<_>, Failure>>()?
        .into_iter()
        .unzip();
    Ok(items::files_of_list(folder, names.iter().map(String::as_str)).into_iter().zip(cameras).collect())
}
