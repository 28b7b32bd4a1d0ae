//! Text lists of data sets, line by line, with errors that name the line.

use std::path::Path;
use std::str::FromStr;

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Quaternion, UnitQuaternion, Vector3};
use veiloc_map::text::text_of;

use crate::error::DatasetError;

/// Reads a text file of the data set; the error for a missing file says what it is and where to get it.
pub(crate) fn read_text(path: &Path, what: &'static str, remedy: &str) -> Result<String, DatasetError> {
    match std::fs::read(path) {
        Ok(bytes) => text_of(bytes).map_err(|_| DatasetError::Unusable {
            path: path.to_owned(),
            reason: "is not text; get the file again".to_owned(),
        }),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            Err(DatasetError::Missing { path: path.to_owned(), what, remedy: remedy.to_owned() })
        }
        Err(e) => Err(DatasetError::io(path)(e)),
    }
}

/// The words of a line, with its position for error messages.
pub(crate) struct Line<'a> {
    pub(crate) path: &'a Path,
    pub(crate) number: usize,
    pub(crate) words: Vec<&'a str>,
}

impl<'a> Line<'a> {
    /// All non-empty lines, numbered from 1.
    pub(crate) fn all(path: &'a Path, text: &'a str) -> impl Iterator<Item = Self> {
        let line = move |(number, line): (usize, &'a str)| Self {
            path,
            number,
            words: line.split_whitespace().collect(),
        };
        (1..).zip(text.lines()).map(line).filter(|line| !line.words.is_empty())
    }

    /// An error about this line.
    pub(crate) fn fault(&self, reason: impl Into<String>) -> DatasetError {
        DatasetError::line(self.path, self.number, reason)
    }

    /// The word at this index as a number.
    pub(crate) fn number<T: FromStr>(&self, at: usize, what: &str) -> Result<T, DatasetError> {
        let word = self.words.get(at).ok_or_else(|| self.fault(format!("{what} is missing")))?;
        word.parse().map_err(|_| self.fault(format!("{what} is {word:?}, which is not a valid number")))
    }

    /// `N` finite numbers from this index on.
    pub(crate) fn numbers<const N: usize>(&self, from: usize, what: &str) -> Result<[f64; N], DatasetError> {
        let mut numbers = [0.0; N];
        for (k, number) in numbers.iter_mut().enumerate() {
            *number = self.number(from + k, what)?;
        }
        if numbers.iter().any(|n: &f64| !n.is_finite()) {
            return Err(self.fault(format!("{what} is not finite")));
        }
        Ok(numbers)
    }
}

/// The pose of a camera with this centre and a quaternion `w x y z` that rotates the world into the camera.
pub(crate) fn pose_at(center: [f64; 3], wxyz: [f64; 4]) -> Option<CameraFromWorld> {
    let q = Quaternion::new(wxyz[0], wxyz[1], wxyz[2], wxyz[3]);
    if !q.norm().is_finite() || q.norm() < 1e-12 {
        return None;
    }
    let rotation = UnitQuaternion::from_quaternion(q).to_rotation_matrix();
    Some(CameraFromWorld::new(rotation, -(rotation * Vector3::from(center))))
}
