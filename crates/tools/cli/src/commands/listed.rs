//! Images of a list, each with its camera: the same words wherever listed images are sealed.

use std::path::{Component, Path};

use crate::args::camera::{CameraArg, CameraSource};
use veiloc_obfuscation::KnownCamera;

use crate::commands::device_args::DeviceArgs;
use crate::exit::Failure;
use crate::items::{self, Item};
use crate::lists;

/// The images that a list names in a folder, with their cameras: of the list, else the one that is given for all.
///
/// # Errors
/// A list that is none; a name that leads out of the folder; a camera in the list and another for all.
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
                    "name images relative to the folder given, without `..`",
                ));
            }
            let camera = match (listed.camera, given) {
                (Some(intrinsics), None) => {
                    CameraSource::Given(KnownCamera { intrinsics, focal: device.known_of_given() })
                }
                (None, _) => camera,
                (Some(_), Some(_)) => {
                    return Err(Failure::with_help(
                        format!("{} has a camera of its own, and --camera is given too", at()),
                        "leave out --camera, or give a list of names only",
                    ));
                }
            };
            Ok((camera, listed.name))
        })
        .collect::<Result<Vec<_>, Failure>>()?
        .into_iter()
        .unzip();
    Ok(items::listed(folder, names.iter().map(String::as_str)).into_iter().zip(cameras).collect())
}
