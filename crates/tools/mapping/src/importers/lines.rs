//! Text files of numbers, line by line, with errors that name the line.

use std::path::Path;
use std::str::FromStr;

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};

use crate::error::MappingError;

/// The words of a line, with its position for error messages.
#[derive(Debug, Clone)]
pub struct Line<'a> {
    /// The file, for messages.
    pub path: &'a Path,
    /// Line number, from 1.
    pub number: usize,
    /// The words of the line; at least one.
    pub words: Vec<&'a str>,
}

impl<'a> Line<'a> {
    /// All non-empty lines, numbered from 1; words are separated by white space.
    pub fn all(path: &'a Path, text: &'a str) -> impl Iterator<Item = Self> {
        Self::split(path, text, |line| line.split_whitespace().collect())
    }

    /// All lines with fields separated by commas, without comments (`#`); white space around fields is removed.
    pub fn of_commas(path: &'a Path, text: &'a str) -> impl Iterator<Item = Self> {
        Self::of_fields(path, text, ',')
    }

    /// The same with another separator.
    pub(crate) fn of_fields(path: &'a Path, text: &'a str, separator: char) -> impl Iterator<Item = Self> {
        Self::split(path, text, move |line| line.split(separator).map(str::trim).collect())
            .filter(|line| !line.words[0].starts_with('#'))
    }

    fn split(
        path: &'a Path,
        text: &'a str,
        words: impl Fn(&'a str) -> Vec<&'a str>,
    ) -> impl Iterator<Item = Self> {
        let lines = (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty());
        lines.map(move |(number, line)| Self { path, number, words: words(line) })
    }

    /// The place of the line in its file, for messages.
    pub(crate) fn place(&self) -> String {
        format!("line {}", self.number)
    }

    /// An error about this line.
    pub fn fault(&self, reason: impl Into<String>) -> MappingError {
        MappingError::PosesLine { path: self.path.to_owned(), line: self.number, reason: reason.into() }
    }

    /// The word at this index as a number.
    ///
    /// # Errors
    /// [`MappingError::PosesLine`]: the word is missing or no number.
    pub fn number<T: FromStr>(&self, at: usize, what: &str) -> Result<T, MappingError> {
        let word = self.words.get(at).ok_or_else(|| self.fault(format!("{what} is missing")))?;
        word.parse().map_err(|_| self.fault(format!("{what} is {word:?}, which is not a valid number")))
    }

    /// `N` finite numbers from this index on.
    ///
    /// # Errors
    /// [`MappingError::PosesLine`]: one is missing, no number or not finite.
    pub fn numbers<const N: usize>(&self, from: usize, what: &str) -> Result<[f64; N], MappingError> {
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
pub fn pose_at(center: [f64; 3], wxyz: [f64; 4]) -> Option<CameraFromWorld> {
    let rotation: Rotation3<f64> = *CameraFromWorld::from_quaternion(wxyz, [0.0; 3])?.rotation();
    Some(CameraFromWorld::new(rotation, -(rotation * Vector3::from(center))))
}
