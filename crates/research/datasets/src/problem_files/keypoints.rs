//! `keypoints.jsonl`: the keypoints of images, with or without descriptors, the input of `veiloc attack`.

use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use veiloc_descriptor::{DescriptorKind, Descriptors, Encoding};
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
    /// Descriptors `[N]` with their kind; `None` if the file has none.
    pub descriptors: Option<Descriptors>,
}

#[derive(Deserialize, Serialize)]
struct Line {
    name: String,
    width: u32,
    height: u32,
    keypoints: Vec<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    features: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    descriptor_dim: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    descriptor_encoding: Option<EncodingName>,
    #[serde(skip_serializing_if = "Option::is_none")]
    descriptor_norm: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    descriptors: Option<String>,
}

/// An [`Encoding`] in a file.
#[derive(Clone, Copy, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
enum EncodingName {
    Unsigned,
    Signed,
    Coarse,
}

impl From<EncodingName> for Encoding {
    fn from(name: EncodingName) -> Self {
        match name {
            EncodingName::Unsigned => Self::Unsigned,
            EncodingName::Signed => Self::Signed,
            EncodingName::Coarse => Self::Coarse,
        }
    }
}

impl From<Encoding> for EncodingName {
    fn from(encoding: Encoding) -> Self {
        match encoding {
            Encoding::Unsigned => Self::Unsigned,
            Encoding::Signed => Self::Signed,
            Encoding::Coarse => Self::Coarse,
        }
    }
}

/// Limits of image side and number of keypoints; larger values are refused.
const LARGEST_SIDE: u32 = 1 << 16;
const MAX_KEYPOINTS: usize = 1 << 17;

/// Reads all images of a `keypoints.jsonl` or `keypoints.jsonl.gz`.
///
/// # Errors
/// [`DatasetError`] naming file and line when a line is invalid: an impossible size, a keypoint that is not finite,
/// a wrong number of descriptors, or descriptors of another kind than those before it.
pub fn read_keypoints(path: &Path) -> Result<Vec<KeypointImage>, DatasetError> {
    let mut kind: Option<DescriptorKind> = None;
    json_lines::read::<Line>(path)?
        .into_iter()
        .map(|(number, line)| {
            let refused = |reason| DatasetError::Line { path: path.to_owned(), line: number, reason };
            let image = image(line).map_err(refused)?;
            if let Some(own) = image.descriptors.as_ref().map(Descriptors::kind) {
                let first = *kind.get_or_insert(own);
                if own != first {
                    return Err(refused(format!(
                        "the descriptors are {own:?}, but those of the lines before are {first:?}"
                    )));
                }
            }
            Ok(image)
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
    let descriptors = match &line.descriptors {
        None => None,
        Some(text) => {
            let kind = kind(&line)?;
            let bytes = STANDARD.decode(text).map_err(|e| format!("descriptors: {e}"))?;
            if bytes.len() != kind.dim() * keypoints.len() {
                return Err(format!(
                    "descriptors have {} bytes, which does not match {} keypoints of dimension {}",
                    bytes.len(),
                    keypoints.len(),
                    kind.dim()
                ));
            }
            Some(Descriptors::new(kind, bytes).map_err(|e| format!("descriptors: {e}"))?)
        }
    };
    Ok(KeypointImage { name: line.name, width: line.width, height: line.height, keypoints, descriptors })
}

/// The kind of a line's descriptors; RootSIFT when the line does not name it.
fn kind(line: &Line) -> Result<DescriptorKind, String> {
    let dim = line.descriptor_dim.ok_or("descriptors are given without descriptor_dim")?;
    let sift = DescriptorKind::ROOT_SIFT;
    let name = match &line.features {
        Some(name) => name.as_str(),
        None if dim == sift.dim() => sift.name(),
        None => {
            return Err(format!(
                "descriptors of dimension {dim} are not {sift}; name their kind in features, as `veiloc eval keypoints` does"
            ));
        }
    };
    let (encoding, norm) = match (line.descriptor_encoding, line.descriptor_norm) {
        (Some(encoding), Some(norm)) => (encoding.into(), norm),
        (None, None) if name == sift.name() => (sift.encoding(), sift.norm()),
        _ => return Err(format!("descriptors of kind {name} need descriptor_encoding and descriptor_norm")),
    };
    DescriptorKind::new(name, dim, encoding, norm).map_err(|e| format!("the kind of the descriptors: {e}"))
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
            let kind = descriptors.map(Descriptors::kind);
            Ok(serde_json::to_string(&Line {
                name: image.name.clone(),
                width: image.width,
                height: image.height,
                keypoints: image.keypoints.iter().map(|p| [p.u, p.v]).collect(),
                features: kind.map(|k| k.name().to_owned()),
                descriptor_dim: kind.map(DescriptorKind::dim),
                descriptor_encoding: kind.map(|k| k.encoding().into()),
                descriptor_norm: kind.map(DescriptorKind::norm),
                descriptors: descriptors.map(|d| STANDARD.encode(d.as_bytes())),
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

    const GOOD: &str = r#"{"name":"a","width":640,"height":480,"keypoints":[[1,2],[3,4.5]],"features":"own","descriptor_dim":3,"descriptor_encoding":"signed","descriptor_norm":100,"descriptors":"AQIDBAUG"}"#;

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
        let kind = DescriptorKind::new("own", 3, Encoding::Signed, 100).expect("a kind");
        let descriptors = Descriptors::new(kind, vec![1, 2, 3, 4, 5, 6]).expect("two rows");
        assert_eq!(image.descriptors, Some(descriptors));
        for (text, expected) in [
            (GOOD.replace("640", "0"), "not allowed"),
            (GOOD.replace("\"descriptor_dim\":3", "\"descriptor_dim\":2"), "does not match"),
            (GOOD.replace("\"descriptor_dim\":3", "\"descriptor_dim\":0"), "dim"),
            (GOOD.replace("\"descriptor_dim\":3,", ""), "without descriptor_dim"),
            (GOOD.replace("AQID", "A!ID"), "descriptors"),
            (GOOD.replace("[1,2]", "[1e999,2]"), "out of range"),
            (GOOD.replace("[1,2]", "[1]"), "invalid length"),
            (GOOD.replace("\"features\":\"own\",", ""), "name their kind in features"),
            (GOOD.replace("\"descriptor_norm\":100,", ""), "need descriptor_encoding and descriptor_norm"),
            (GOOD.replace("signed", "other"), "unknown variant"),
            (GOOD.replace("\"own\"", "\"sift\""), "the kind of the descriptors"),
        ] {
            let error = read(&format!("{GOOD}\n{text}\n")).expect_err(expected).to_string();
            assert!(error.contains(":2: ") && error.contains(expected), "{error}");
        }
    }

    #[test]
    fn a_file_holds_descriptors_of_one_kind() {
        for text in [
            GOOD.replace("\"own\"", "\"other\""),
            GOOD.replace("100", "101"),
            GOOD.replace("signed", "unsigned"),
        ] {
            let error = read(&format!("{GOOD}\n{text}\n")).expect_err("two kinds").to_string();
            assert!(error.contains(":2: ") && error.contains("those of the lines before are own"), "{error}");
        }
        let without = r#"{"name":"b","width":640,"height":480,"keypoints":[[1,2]]}"#;
        assert_eq!(read(&format!("{without}\n{GOOD}\n{without}\n")).expect("one kind").len(), 3);
    }

    /// Files of other programs: only RootSIFT may be left unnamed.
    #[test]
    fn unnamed_descriptors_are_root_sift() {
        let line = |dim: usize| {
            let bytes = STANDARD.encode(vec![7; dim]);
            format!(
                r#"{{"name":"a","width":9,"height":9,"keypoints":[[1,2]],"descriptor_dim":{dim},"descriptors":"{bytes}"}}"#
            )
        };
        let image = read(&line(128)).expect("RootSIFT").remove(0);
        assert_eq!(image.descriptors.map(|d| d.kind()), Some(DescriptorKind::ROOT_SIFT));
        assert!(read(&line(64)).expect_err("unnamed").to_string().contains("features"));
    }
}
