//! `keypoints.jsonl`: the keypoints of images, with or without descriptors, the input of `veiloc attack`.

use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use veiloc_geometry::Pixel;

use crate::error::DatasetError;
use crate::problem_files::json_lines;
use crate::problem_files::seeds::seed_for;

/// The keypoints of one image.
#[derive(Debug, Clone, PartialEq)]
pub struct KeypointImage {
    /// Name of the image.
    pub name: String,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Positions, pixels.
    pub keypoints: Vec<Pixel>,
    /// `[N · dimension]`, row-major, and the dimension; `None` if the file has none.
    pub descriptors: Option<(Vec<u8>, usize)>,
}

#[derive(Deserialize, Serialize)]
struct Line {
    name: String,
    width: u32,
    height: u32,
    keypoints: Vec<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    descriptor_dim: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    descriptors: Option<String>,
}

/// Limits of image side and number of keypoints; larger values are refused.
const LARGEST_SIDE: u32 = 1 << 16;
const MAX_KEYPOINTS: usize = 1 << 17;

/// Reads all images of a `keypoints.jsonl` or `keypoints.jsonl.gz`.
///
/// # Errors
/// [`DatasetError`] naming file and line when a line is invalid: an impossible size, a keypoint that is not finite,
/// or a wrong number of descriptors.
pub fn read_keypoints(path: &Path) -> Result<Vec<KeypointImage>, DatasetError> {
    json_lines::read::<Line>(path)?
        .into_iter()
        .map(|(number, line)| {
            image(line).map_err(|reason| DatasetError::Line { path: path.to_owned(), line: number, reason })
        })
        .collect()
}

fn image(line: Line) -> Result<KeypointImage, String> {
    if !(1..=LARGEST_SIDE).contains(&line.width) || !(1..=LARGEST_SIDE).contains(&line.height) {
        return Err(format!("an image size of {} x {} pixels is not allowed", line.width, line.height));
    }
    if line.keypoints.len() > MAX_KEYPOINTS {
        return Err(format!("{} keypoints exceed the limit of {MAX_KEYPOINTS}", line.keypoints.len()));
    }
    let keypoints: Vec<Pixel> = line.keypoints.iter().map(|k| Pixel::new(k[0], k[1])).collect();
    if let Some(i) = keypoints.iter().position(|p| !p.is_finite()) {
        return Err(format!("keypoints[{i}] is not finite"));
    }
    let descriptors = match (line.descriptors, line.descriptor_dim) {
        (None, _) => None,
        (Some(_), None) => return Err("descriptors are given without descriptor_dim".to_owned()),
        (Some(text), Some(dimension)) => {
            let bytes = STANDARD.decode(text).map_err(|e| format!("descriptors: {e}"))?;
            let expected = dimension.checked_mul(keypoints.len());
            if dimension == 0 || expected != Some(bytes.len()) {
                return Err(format!(
                    "descriptors have {} bytes, which does not match {} keypoints of dimension {dimension}",
                    bytes.len(),
                    keypoints.len()
                ));
            }
            Some((bytes, dimension))
        }
    };
    Ok(KeypointImage { name: line.name, width: line.width, height: line.height, keypoints, descriptors })
}

/// The bytes of a `keypoints.jsonl`, gzipped if `gzip` is set, in the format of [`read_keypoints`].
///
/// # Errors
/// Never in practice: writing to memory does not fail.
pub fn encode_keypoints(images: &[KeypointImage], gzip: bool) -> std::io::Result<Vec<u8>> {
    let lines: Vec<String> = images
        .iter()
        .map(|image| {
            let descriptors = image.descriptors.as_ref();
            Ok(serde_json::to_string(&Line {
                name: image.name.clone(),
                width: image.width,
                height: image.height,
                keypoints: image.keypoints.iter().map(|p| [p.u, p.v]).collect(),
                descriptor_dim: descriptors.map(|d| d.1),
                descriptors: descriptors.map(|d| STANDARD.encode(&d.0)),
            })?)
        })
        .collect::<std::io::Result<_>>()?;
    json_lines::encode(&lines, gzip)
}

/// The paper's Fig. 4: keypoints uniform over 640 x 480 pixels.
pub fn synthetic_image(keypoints: usize, seed: u64) -> KeypointImage {
    let mut rng = ChaCha8Rng::seed_from_u64(seed_for(seed, &["synthetic keypoints"]));
    let (width, height) = (640, 480);
    let mut draw = || Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0));
    let keypoints = (0..keypoints).map(|_| draw()).collect();
    KeypointImage { name: "synthetic".to_owned(), width, height, keypoints, descriptors: None }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = r#"{"name":"a","width":640,"height":480,"keypoints":[[1,2],[3,4.5]],"descriptor_dim":3,"descriptors":"AQIDBAUG"}"#;

    fn read(text: &str) -> Result<Vec<KeypointImage>, DatasetError> {
        let dir = tempfile::tempdir().expect("temporary folder");
        let path = dir.path().join("k.jsonl");
        std::fs::write(&path, text).expect("written");
        read_keypoints(&path)
    }

    #[test]
    fn images_are_read_and_invalid_lines_reported() {
        let image = &read(GOOD).expect("well formed")[0];
        assert_eq!(image.keypoints[1], Pixel::new(3.0, 4.5));
        assert_eq!(image.descriptors, Some((vec![1, 2, 3, 4, 5, 6], 3)));
        for (text, expected) in [
            (GOOD.replace("640", "0"), "not allowed"),
            (GOOD.replace("\"descriptor_dim\":3", "\"descriptor_dim\":2"), "does not match"),
            (GOOD.replace("\"descriptor_dim\":3", "\"descriptor_dim\":0"), "does not match"),
            (GOOD.replace("\"descriptor_dim\":3,", ""), "without descriptor_dim"),
            (GOOD.replace("AQID", "A!ID"), "descriptors"),
            (GOOD.replace("[1,2]", "[1e999,2]"), "out of range"),
            (GOOD.replace("[1,2]", "[1]"), "invalid length"),
        ] {
            let error = read(&format!("{GOOD}\n{text}\n")).expect_err(expected).to_string();
            assert!(error.contains(":2: ") && error.contains(expected), "{error}");
        }
    }
}
