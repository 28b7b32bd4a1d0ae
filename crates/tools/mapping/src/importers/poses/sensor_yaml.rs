//! Calibrated cameras in YAML: `sensor.yaml` of EuRoC (ASL's format) and `camchain.yaml` of Kalibr.
//!
//! Read are keys with a word or with numbers, in brackets or one item a line, and no other YAML. Pixels count from the centre of the
//! first one, so half a pixel is added.
//!
//! | camera | distortion | here |
//! |---|---|---|
//! | `pinhole`, `fu fv pu pv` | `radtan`, `radial-tangential`: `k1 k2 p1 p2` | `OPENCV`, or simpler |
//! | | `equidistant`: `k1 k2 k3 k4` | `OPENCV_FISHEYE` |
//! | | `fov`: `w` | `FOV` |
//! | | `none` | `PINHOLE` |
//! | `eucm`, `alpha beta fu fv pu pv` | `none` | `EUCM` |
//!
//! Kalibr's `omni` (Mei) and `ds` (double sphere) have no equal here.
//!
//! Source: <https://github.com/ethz-asl/kalibr/wiki/yaml-formats> and `supported-models`.

use std::path::Path;

use veiloc_geometry::Intrinsics;
use veiloc_geometry::nalgebra::Matrix4;

use super::cameras::Lens;
use super::posed_input::faulty;
use crate::error::MappingError;

/// The keys of a file, or of one camera in it.
pub(super) struct Sensor<'a> {
    pub(super) path: &'a Path,
    /// The key of the camera, for messages; empty for the whole file.
    pub(super) name: &'a str,
    pub(super) content: &'a str,
}

impl<'a> Sensor<'a> {
    /// The blocks of a file: keys without indentation.
    pub(super) fn blocks(path: &'a Path, content: &'a str) -> Vec<Self> {
        let mut blocks: Vec<Self> = Vec::new();
        let mut at = 0;
        for line in content.split_inclusive('\n') {
            let is_head = !line.starts_with([' ', '\t', '#', '%', '-', '\r', '\n']);
            if let Some((name, _)) = line.split_once(':').filter(|_| is_head) {
                blocks.push(Self { path, name: name.trim(), content: &content[at + name.len() + 1..] });
            }
            at += line.len();
        }
        // Each ends where the next begins.
        let starts: Vec<usize> =
            blocks.iter().map(|b| b.name.as_ptr() as usize - content.as_ptr() as usize).collect();
        for (block, end) in blocks.iter_mut().zip(starts.iter().skip(1)) {
            let start = block.content.as_ptr() as usize - content.as_ptr() as usize;
            block.content = &content[start..*end];
        }
        blocks
    }

    fn fault(&self, reason: impl std::fmt::Display) -> MappingError {
        let separator = if self.name.is_empty() { "" } else { ": " };
        faulty(self.path, format!("{}{separator}{reason}", self.name))
    }

    pub(super) fn has(&self, key: &str) -> bool {
        self.value(key).is_some()
    }

    /// What stands from a key to the next one, without comments, brackets, commas and the dashes of items.
    fn value(&self, key: &str) -> Option<Vec<&'a str>> {
        let is_key = |line: &str| {
            let (head, rest) = line.split_once(':')?;
            let is_name = !head.is_empty() && head.chars().all(|c| c.is_alphanumeric() || c == '_');
            is_name.then_some((head.to_owned(), rest.len()))
        };
        let mut lines = self.content.lines();
        let first = loop {
            let line = lines.next()?;
            if let Some((_, rest)) = is_key(line.trim_start()).filter(|(name, _)| name == key) {
                break &line[line.len() - rest..];
            }
        };
        let more = lines.take_while(|line| is_key(line.trim_start()).is_none());
        let words = std::iter::once(first).chain(more).flat_map(|line| {
            let line = line.split('#').next().unwrap_or_default();
            line.split(|c: char| c.is_whitespace() || "[],".contains(c))
                .filter(|word| !word.is_empty() && *word != "-")
        });
        Some(words.collect())
    }

    fn word(&self, key: &str) -> Result<&'a str, MappingError> {
        let value = self.value(key).ok_or_else(|| self.fault(format_args!("{key} is missing")))?;
        match *value {
            [word] => Ok(word.trim_matches(['"', '\''])),
            _ => Err(self.fault(format_args!("{key} is no word"))),
        }
    }

    pub(super) fn array<const N: usize>(&self, key: &str) -> Result<[f64; N], MappingError> {
        let words = self.value(key).ok_or_else(|| self.fault(format_args!("{key} is missing")))?;
        let numbers: Option<Vec<f64>> =
            words.iter().map(|word| word.parse().ok().filter(|n: &f64| n.is_finite())).collect();
        numbers
            .and_then(|numbers| numbers.try_into().ok())
            .ok_or_else(|| self.fault(format_args!("{key} is no array of {N} numbers")))
    }

    pub(super) fn matrix(&self, key: &str) -> Result<Matrix4<f64>, MappingError> {
        Ok(Matrix4::from_row_slice(&self.array::<16>(key)?))
    }

    /// The camera. `coefficients`: the key of those of the distortion.
    pub(super) fn intrinsics(&self, coefficients: &str) -> Result<Intrinsics, MappingError> {
        let [w, h] = self.array("resolution")?;
        let size = (w as u32, h as u32);
        let unread = |what: &str, model: &str, read: &str| {
            self.fault(format_args!("{what} is {model:?}, which has no equal here; {read}"))
        };
        let camera = if self.has("camera_model") { self.word("camera_model")? } else { "pinhole" };
        let distortion = self.word("distortion_model")?;
        let direct = |model: &str, params: &[f64]| {
            Intrinsics::new(model, size.0, size.1, params).map_err(|e| self.fault(e))
        };
        match camera {
            "pinhole" => {}
            "eucm" if distortion == "none" => {
                let [alpha, beta, fx, fy, cx, cy] = self.array("intrinsics")?;
                return direct("EUCM", &[fx, fy, cx + 0.5, cy + 0.5, alpha, beta]);
            }
            "eucm" => return Err(unread("distortion_model of eucm", distortion, "none is read")),
            other => return Err(unread("camera_model", other, "calibrate the camera as pinhole or eucm")),
        }
        let [fx, fy, cx, cy] = self.array("intrinsics")?;
        let principal = [cx + 0.5, cy + 0.5];
        let (is_fisheye, k, p) = match distortion {
            "radial-tangential" | "radtan" => {
                let [k1, k2, p1, p2] = self.array(coefficients)?;
                (false, [k1, k2, 0.0, 0.0], [p1, p2, 0.0, 0.0])
            }
            "equidistant" => (true, self.array(coefficients)?, [0.0; 4]),
            "none" => (false, [0.0; 4], [0.0; 4]),
            "fov" => {
                let [omega] = self.array(coefficients)?;
                return direct("FOV", &[fx, fy, principal[0], principal[1], omega]);
            }
            other => {
                let read = "radtan (radial-tangential), equidistant, fov and none are read";
                return Err(unread("distortion_model", other, read));
            }
        };
        Lens { size, focal: [fx, fy], principal, k, p, skew: 0.0, is_fisheye }.intrinsics(self.path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera of Kalibr with these lines.
    fn read(lines: &str) -> Result<Intrinsics, String> {
        let content = format!("cam0:\n  resolution: [752, 480]\n{lines}");
        let blocks = Sensor::blocks(Path::new("a.yaml"), &content);
        blocks[0].intrinsics("distortion_coeffs").map_err(|error| error.to_string())
    }

    #[test]
    fn models_of_kalibr_have_their_equals() {
        let pinhole = "  camera_model: pinhole\n  intrinsics: [458.0, 457.0, 367.0, 248.0]\n";
        let eucm =
            "  camera_model: eucm\n  intrinsics: [0.6, 1.1, 458, 457, 367, 248]\n  distortion_coeffs: []\n";
        for (lines, expected) in [
            (
                format!("{pinhole}  distortion_model: radtan\n  distortion_coeffs: [-0.28, 0.07, 0.0002, 1e-05]\n"),
                "OPENCV,752,480,458,457,367.5,248.5,-0.28,0.07,0.0002,0.00001",
            ),
            (
                format!("{pinhole}  distortion_model: equidistant\n  distortion_coeffs: [0.1, 0.2, 0.3, 0.4]\n"),
                "OPENCV_FISHEYE,752,480,458,457,367.5,248.5,0.1,0.2,0.3,0.4",
            ),
            (
                format!("{pinhole}  distortion_model: fov\n  distortion_coeffs: [0.9]\n"),
                "FOV,752,480,458,457,367.5,248.5,0.9",
            ),
            (
                format!("{pinhole}  distortion_model: none\n  distortion_coeffs: []\n"),
                "PINHOLE,752,480,458,457,367.5,248.5",
            ),
            (
                format!("{eucm}  distortion_model: none\n"),
                "EUCM,752,480,458,457,367.5,248.5,0.6,1.1",
            ),
            // As others write lists.
            (
                "  intrinsics:\n  - 458\n  - 457.0 # of x and y\n  - 367\n  -  248\n  distortion_model: \"none\"\n".to_owned(),
                "PINHOLE,752,480,458,457,367.5,248.5",
            ),
        ] {
            let expected: Intrinsics = expected.parse().expect("valid");
            assert_eq!(read(&lines), Ok(expected), "{lines}");
        }
    }

    #[test]
    fn models_without_an_equal_are_named() {
        let of = |camera: &str, distortion: &str, numbers: &str| {
            read(&format!(
                "  camera_model: {camera}\n  distortion_model: {distortion}\n  intrinsics: [{numbers}]\n  distortion_coeffs: [0, 0]\n"
            ))
            .expect_err("refused")
        };
        for (error, part) in [
            (of("omni", "radtan", "1.2, 458, 457, 367, 248"), "cam0: camera_model is \"omni\""),
            (of("ds", "none", "-0.2, 0.6, 458, 457, 367, 248"), "cam0: camera_model is \"ds\""),
            (of("eucm", "radtan", "0.6, 1, 458, 457, 367, 248"), "distortion_model of eucm is \"radtan\""),
            (of("pinhole", "thinprism", "458, 457, 367, 248"), "distortion_model is \"thinprism\""),
            (of("pinhole", "radtan", "458, 457, 367, 248"), "distortion_coeffs is no array of 4 numbers"),
            (of("pinhole", "none", "458, 457, 367"), "intrinsics is no array of 4 numbers"),
            (of("eucm", "none", "0.6, -1, 458, 457, 367, 248"), "cam0: "),
        ] {
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn blocks_of_a_file_are_separate() {
        let content =
            "%YAML:1.0\n# chain\ncam0:\n  a: 1\n\ncam1:   # second\r\n  b: [2,\r\n   3]\ncam10: {}\n";
        let blocks = Sensor::blocks(Path::new("a"), content);
        let names: Vec<&str> = blocks.iter().map(|block| block.name).collect();
        assert_eq!(names, ["cam0", "cam1", "cam10"]);
        assert!(blocks[0].has("a") && !blocks[0].has("b") && !blocks[1].has("a"));
        assert_eq!(blocks[1].array::<2>("b").expect("numbers"), [2.0, 3.0]);
    }
}
