//! Which session an image is a frame of, and how the camera was held: the same words wherever images are sealed.

use std::path::PathBuf;
use std::str::FromStr;

use veiloc_client::{ClientError, Orientation, SessionAnchors, SessionFile, SessionOptions};
use veiloc_geometry::nalgebra::{Matrix3, Rotation3};
use veiloc_protocol::CoarseGravity;

use crate::exit::Failure;

/// Several images of one place.
#[derive(clap::Args)]
pub(crate) struct SessionArgs {
    /// The session that the image is a frame of: a file that is made where there is none. Lines of two images of one place cross
    /// in what both show, but for those of one session, whose anchors stay in the world (docs/reference/privacy-rules.md, rule L10). The file
    /// holds where keypoints were and is for this device alone; delete it to end the session.
    #[arg(long, value_name = "FILE")]
    session: Option<PathBuf>,
    /// How the camera was held: the rotation from a frame that stays in the world during the session, any one, to the camera (x
    /// right, y down, z forward, of the image as it is stored), from a gyroscope or odometry; a quaternion, or the nine numbers of
    /// a matrix row by row. Default: not known, and a frame is of the session only when what is seen again says that the camera
    /// rested or turned on the spot.
    #[arg(long, value_name = "QW,QX,QY,QZ", allow_hyphen_values = true, requires = "session")]
    orientation: Option<OrientationArg>,
    /// What the session's anchors are tied to, when it begins: world, gravity (--gravity tells it), or image, which protects
    /// several images of one place as little as no session does. Default: world, or as the session was begun.
    #[arg(long, value_name = "world|gravity|image", requires = "session")]
    anchors: Option<SessionAnchors>,
}

/// A rotation as people write it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct OrientationArg(Orientation);

impl FromStr for OrientationArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let words = text.split([',', ' ', ';']).filter(|word| !word.is_empty());
        let numbers: Result<Vec<f64>, _> = words.map(str::parse).collect();
        let numbers = numbers.map_err(|e| e.to_string())?;
        let held = match *numbers.as_slice() {
            [w, x, y, z] => Orientation::from_quaternion([w, x, y, z])
                .filter(|_| ((w * w + x * x + y * y + z * z).sqrt() - 1.0).abs() < 0.01),
            [..] if numbers.len() == 9 => {
                let matrix = Matrix3::from_row_slice(&numbers);
                let is_rotation = (matrix * matrix.transpose() - Matrix3::identity()).norm() < 0.01
                    && matrix.determinant() > 0.0;
                is_rotation.then(|| Rotation3::from_matrix(&matrix)).and_then(Orientation::in_world)
            }
            _ => return Err(format!("{} numbers; a quaternion has 4, a matrix 9", numbers.len())),
        };
        held.map(Self)
            .ok_or_else(|| "no rotation: a quaternion has length 1, a matrix columns of length 1".to_owned())
    }
}

impl SessionArgs {
    /// The session's file, open; `None` when there is no session.
    pub(crate) fn open(&self) -> Result<Option<SessionFile>, Failure> {
        let Some(path) = &self.session else { return Ok(None) };
        let options = self.anchors.map(|anchors| SessionOptions::default().with_anchors(anchors));
        SessionFile::open(path, options).map(Some).map_err(|error| failure(&error))
    }

    /// How the camera was held, with gravity as the device felt it.
    pub(crate) fn held(&self, gravity: Option<CoarseGravity>) -> Orientation {
        let held = self.orientation.map_or(Orientation::unknown(), |OrientationArg(held)| held);
        gravity.and_then(|gravity| held.with_down(gravity.in_camera())).unwrap_or(held)
    }

    /// Whether an orientation is told, which is of one image.
    pub(crate) const fn tells_orientation(&self) -> bool {
        self.orientation.is_some()
    }
}

/// What is wrong with a session's file, with a remedy.
pub(crate) fn failure(error: &ClientError) -> Failure {
    let help = match error {
        ClientError::SessionBusy { .. } => "wait until the other program has ended",
        ClientError::SessionBytes { .. } => {
            "begin another session with another file, at another place: nobody knows any more what this one told"
        }
        ClientError::SessionOptions { .. } => {
            "leave out --anchors, or begin another session with another file"
        }
        _ => "check that the folder is there, and that the file may be read and written",
    };
    Failure::with_help(error, help)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotations_as_people_write_them() {
        let quarter = "0.70710678,0,0.70710678,0".parse::<OrientationArg>().expect("a quaternion");
        let matrix = "0 0 1; 0 1 0; -1 0 0".parse::<OrientationArg>().expect("a matrix");
        let rotation = |OrientationArg(held): OrientationArg| *held.cam_from_world().expect("a rotation");
        assert!(rotation(quarter).angle_to(&rotation(matrix)) < 1e-6);
        for text in ["", "1,0,0", "1,2,3,4", "0,0,0,0", "1,0,0,nan", "1,x,0,0", "1 0 0 0 1 0 0 0 -1"] {
            assert!(text.parse::<OrientationArg>().is_err(), "{text}");
        }
    }
}
