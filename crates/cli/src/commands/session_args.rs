//! Session of an image and orientation of the camera, for all commands that seal images.

use std::path::PathBuf;
use std::str::FromStr;

use veiloc_client::{
    ClientError, Extracted, Orientation, SealedQuery, Sealer, Session, SessionAnchors, SessionFile,
    SessionOptions, device_rng,
};
use veiloc_geometry::nalgebra::{Matrix3, Rotation3};
use veiloc_protocol::CoarseGravity;

use crate::output::exit::Failure;

/// Several images of one scene.
#[derive(clap::Args)]
pub(crate) struct SessionArgs {
    /// Session file of the image; created if it does not exist. Lines of two images of one scene intersect at the
    /// common points, unless the images belong to one session, whose anchors are fixed in the world (docs/reference/privacy-rules.md,
    /// rule L10). The file contains keypoint positions and must stay on this device; delete it to end the session.
    #[arg(long, value_name = "FILE")]
    session: Option<PathBuf>,
    /// Orientation of the camera, from a gyroscope or odometry: the rotation from any frame that is fixed in the world
    /// during the session to the camera (x right, y down, z forward, of the image as it is stored); a quaternion, or
    /// the nine elements of a matrix row by row. Default: not known; a frame then belongs to the session only if its
    /// matches show that the camera was at rest or only rotated.
    #[arg(long, value_name = "QW,QX,QY,QZ", allow_hyphen_values = true, requires = "session")]
    orientation: Option<OrientationArg>,
    /// Frame that the session's anchors are fixed to, chosen at its begin: world, gravity (needs --gravity), or image,
    /// which protects several images of one scene as little as no session does. Default: world, or the existing
    /// session's choice.
    #[arg(long, value_name = "world|gravity|image", requires = "session")]
    anchors: Option<SessionAnchors>,
}

/// A rotation on the command line.
#[derive(Debug, Clone, Copy, PartialEq)]
struct OrientationArg(Orientation);

impl FromStr for OrientationArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let words = text.split([',', ' ', ';']).filter(|word| !word.is_empty());
        let numbers: Result<Vec<f64>, _> = words.map(str::parse).collect();
        let numbers = numbers.map_err(|e| e.to_string())?;
        let orientation = match *numbers.as_slice() {
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
        orientation.map(Self).ok_or_else(|| {
            "not a rotation: a quaternion has length 1, a matrix columns of length 1".to_owned()
        })
    }
}

/// A session, in its file or of this call alone.
pub(crate) enum OpenSession {
    File(SessionFile),
    OfCall(Session),
}

impl OpenSession {
    /// Begins a session of this call.
    pub(crate) fn of_call() -> Result<Self, Failure> {
        let mut rng = device_rng().map_err(Failure::refused)?;
        Ok(Self::OfCall(Session::new(SessionOptions::default(), &mut rng)))
    }

    /// Seals the next image.
    pub(crate) fn seal(&mut self, sealer: &Sealer, extracted: Extracted) -> Result<SealedQuery, ClientError> {
        match self {
            Self::File(file) => file.seal(sealer, extracted),
            Self::OfCall(session) => Ok(sealer.in_session(session).seal(extracted, &mut device_rng()?)?),
        }
    }
}

impl SessionArgs {
    /// Opens the session file; `None` if there is no session.
    pub(crate) fn open(&self) -> Result<Option<OpenSession>, Failure> {
        let Some(path) = &self.session else { return Ok(None) };
        let options = self.anchors.map(|anchors| SessionOptions::default().with_anchors(anchors));
        let file = SessionFile::open(path, options).map_err(|error| failure(&error))?;
        Ok(Some(OpenSession::File(file)))
    }

    /// Returns whether a session is given.
    pub(crate) const fn has_session(&self) -> bool {
        self.session.is_some()
    }

    /// Returns the orientation of the camera, with the measured gravity.
    pub(crate) fn camera_orientation(&self, gravity: Option<CoarseGravity>) -> Orientation {
        let orientation =
            self.orientation.map_or(Orientation::unknown(), |OrientationArg(orientation)| orientation);
        gravity.and_then(|gravity| orientation.with_down(gravity.in_camera())).unwrap_or(orientation)
    }

    /// Returns whether an orientation is given, which is valid for one image only.
    pub(crate) const fn has_orientation(&self) -> bool {
        self.orientation.is_some()
    }
}

/// Adds a remedy to an error of the session file.
pub(crate) fn failure(error: &ClientError) -> Failure {
    let help = match error {
        ClientError::SessionBusy { .. } => "wait until the other program has ended",
        ClientError::SessionBytes { .. } => {
            "begin another session with another file, at another position: what this session has sent is \
             no longer known"
        }
        ClientError::SessionOptions { .. } => {
            "leave out --anchors, or begin another session with another file"
        }
        _ => "check that the folder exists, and that the file is readable and writable",
    };
    Failure::with_help(error, help)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotations_are_parsed_from_text() {
        let quarter = "0.70710678,0,0.70710678,0".parse::<OrientationArg>().expect("a quaternion");
        let matrix = "0 0 1; 0 1 0; -1 0 0".parse::<OrientationArg>().expect("a matrix");
        let rotation =
            |OrientationArg(orientation): OrientationArg| *orientation.cam_from_world().expect("a rotation");
        assert!(rotation(quarter).angle_to(&rotation(matrix)) < 1e-6);
        for text in ["", "1,0,0", "1,2,3,4", "0,0,0,0", "1,0,0,nan", "1,x,0,0", "1 0 0 0 1 0 0 0 -1"] {
            assert!(text.parse::<OrientationArg>().is_err(), "{text}");
        }
    }
}
