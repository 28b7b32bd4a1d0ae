//! Seals the images that the cameras of one device took at one moment: in one session, with the rig file that joins them.

use std::collections::BTreeSet;

use veiloc_client::Orientation;
use veiloc_features::image_size;
use veiloc_geometry::CameraFromRig;
use veiloc_geometry::nalgebra::Rotation3;
use veiloc_mapping::importers::poses::{RigCamera, read_rig_cameras};
use veiloc_obfuscation::KnownCamera;
use veiloc_protocol::{RigMessage, SessionTag};

use super::Args;
use crate::args::camera::CameraSource;
use crate::args::extraction_error::extraction_error;
use crate::commands::rig_file;
use crate::output::exit::Failure;
use crate::output::items::{InputError, InputErrorKind, Item};

/// The calibrated cameras of a device.
pub(super) struct Rig {
    cameras: Vec<RigCamera>,
    metres_per_unit: f64,
    /// Rotation from the world to the rig.
    from_world: Rotation3<f64>,
}

impl Rig {
    /// Reads the calibration, if there is one.
    pub(super) fn read(args: &Args) -> Result<Option<Self>, Failure> {
        let Some(path) = &args.rig_cameras else { return Ok(None) };
        if args.session.has_session() && !args.session.has_orientation() {
            return Err(Failure::with_help(
                "--session with --rig-cameras needs the orientation of the device",
                "give --orientation, the rotation from the world to the frame of the rig; without --session the images of \
                 this call are a session of their own",
            ));
        }
        let cameras = read_rig_cameras(path)?;
        if cameras.len() > RigMessage::MAX_FRAMES {
            return Err(Failure::with_help(
                format!("{}: {} cameras", path.display(), cameras.len()),
                "a rig of sealed queries has at most 32",
            ));
        }
        let names: BTreeSet<&str> = cameras.iter().map(|camera| camera.name.as_str()).collect();
        if names.len() < cameras.len() {
            return Err(Failure::refused(format!("{}: two cameras have one name", path.display())));
        }
        let given = args.session.camera_orientation(None);
        let rig_from_world = given.cam_from_world().copied().unwrap_or_else(Rotation3::identity);
        Ok(Some(Self { cameras, metres_per_unit: args.metres_per_unit, from_world: rig_from_world }))
    }

    /// The images with their cameras, in the order of the cameras. An image of another size than its camera's has the error.
    pub(super) fn images(&self, items: Vec<Item>, args: &Args) -> Result<Vec<(Item, CameraSource)>, Failure> {
        if items.len() != self.cameras.len() {
            return Err(Failure::with_help(
                format!("{} images of a rig of {} cameras", items.len(), self.cameras.len()),
                "give one image for each camera, in the order of the file of --rig-cameras; seal those of another moment in \
                 another call",
            ));
        }
        let focal = args.device.focal_knowledge();
        let with_camera = |(mut item, rig_camera): (Item, &RigCamera)| {
            let camera = match item.fault {
                Some(_) => CameraSource::Exif,
                None => match image_size(&item.path).map(|size| rig_camera.camera(size)) {
                    Ok(Ok(intrinsics)) => CameraSource::Given(KnownCamera { intrinsics, focal }),
                    Ok(Err(error)) => {
                        item.fault = Some(InputError::new(InputErrorKind::Unfit, error));
                        CameraSource::Exif
                    }
                    Err(error) => {
                        item.fault = Some(extraction_error(&error.into()));
                        CameraSource::Exif
                    }
                },
            };
            (item, camera)
        };
        Ok(items.into_iter().zip(&self.cameras).map(with_camera).collect())
    }

    /// The file of a camera's query.
    pub(super) fn query_name(&self, camera: usize) -> String {
        let name = self.cameras[camera].name.replace(['/', '\\'], "-");
        format!("{name}.vquery")
    }

    /// The orientation of a camera in the world of the session.
    pub(super) fn orientation(&self, camera: usize) -> Orientation {
        let cam_from_world = self.cameras[camera].cam_from_rig.rotation() * self.from_world;
        Orientation::in_world(cam_from_world).unwrap_or_else(Orientation::unknown)
    }

    /// The rig file of the cameras whose images were sealed, each with its session.
    pub(super) fn file(&self, sealed: &[(usize, Option<SessionTag>)]) -> Result<Vec<u8>, Failure> {
        let frame = |(camera, session): &(usize, Option<SessionTag>)| {
            let pose = &self.cameras[*camera].cam_from_rig;
            let in_map_units =
                CameraFromRig::new(*pose.rotation(), pose.translation() / self.metres_per_unit);
            (self.query_name(*camera), in_map_units, *session)
        };
        rig_file::fixed(&sealed.iter().map(frame).collect::<Vec<_>>())
    }
}

/// Metres of a unit of the map.
pub(super) fn metres(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|n| n.is_finite() && *n > 0.0);
    number.ok_or_else(|| "a number above 0 is needed".to_owned())
}
