//! Conditions under which queries are localized.

use std::fmt;
use std::num::NonZeroUsize;
use std::str::FromStr;

use veiloc_obfuscation::{PackUse, UnknownPackUse};

use super::camera_error::CameraError;
use super::degrade::Degradation;
use crate::pipeline::GravityNoise;

/// A condition of queries: `none`, or parts joined by `+`, at most one of each kind.
///
/// | part | effect |
/// |---|---|
/// | [`Degradation`] | the camera records another image: `dark`, `motion`, `half-hidden`, `side-hidden`, `low-resolution` |
/// | `sparse-map` | the map has every tenth image |
/// | `few-keypoints` | the device sends the smallest size class, 256 rows |
/// | `camera:…` | the device assumes a wrong camera ([`CameraError`]), and reports it as calibrated |
/// | `gravity:SD[/ERROR]` | the device measures gravity ([`GravityNoise`]) |
/// | `frames:N` | the query and the images before it, `N` together, are localized as one rig |
/// | `pack:explained`, `pack:matches` | the device has the pack of the map ([`PackUse`]) |
/// | `negatives` | out-of-map images take the place of the scene's queries |
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Condition {
    /// What the camera records.
    pub image: Option<Degradation>,
    /// Whether the map has few images.
    pub sparse_map: bool,
    /// Whether the query has few rows.
    pub few_keypoints: bool,
    /// Error of the camera that the device assumes.
    pub camera: Option<CameraError>,
    /// Measured gravity; a random direction for negatives.
    pub gravity: Option<GravityNoise>,
    /// Number of images that are localized together; `None`: a single image.
    pub frames: Option<NonZeroUsize>,
    /// What the device does with the pack of the map; `None`: it has none.
    pub pack: Option<PackUse>,
    /// Whether out-of-map images are localized.
    pub negatives: bool,
}

/// A text that is not a condition.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConditionError {
    /// A part is unknown.
    #[error(
        "{0:?} is no part of a condition; known are dark, motion, half-hidden, side-hidden, low-resolution, sparse-map, \
         few-keypoints, camera:…, gravity:SD[/ERROR], frames:N, pack:explained, pack:matches and negatives, joined by +, and none"
    )]
    Unknown(String),
    /// The value of a part is invalid.
    #[error("{part:?}: {reason}")]
    Value {
        /// The part.
        part: String,
        /// The problem.
        reason: String,
    },
    /// Two parts exclude each other.
    #[error("{condition:?}: {reason}")]
    Contradiction {
        /// The condition.
        condition: String,
        /// The problem.
        reason: &'static str,
    },
}

impl Condition {
    /// The queries of the list as they are.
    pub const NONE: Self = Self {
        image: None,
        sparse_map: false,
        few_keypoints: false,
        camera: None,
        gravity: None,
        frames: None,
        pack: None,
        negatives: false,
    };

    /// The name in documents; `None` for the queries of the list as they are.
    pub fn name(&self) -> Option<String> {
        (*self != Self::NONE).then(|| self.to_string())
    }

    fn set(&mut self, part: &str) -> Result<(), ConditionError> {
        let (word, value) = part.split_once(':').unwrap_or((part, ""));
        let invalid = |reason: String| ConditionError::Value { part: part.to_owned(), reason };
        let is_repeated = match word {
            "sparse-map" if value.is_empty() => std::mem::replace(&mut self.sparse_map, true),
            "few-keypoints" if value.is_empty() => std::mem::replace(&mut self.few_keypoints, true),
            "negatives" if value.is_empty() => std::mem::replace(&mut self.negatives, true),
            "camera" => self.camera.replace(value.parse().map_err(invalid)?).is_some(),
            "gravity" => self.gravity.replace(value.parse().map_err(invalid)?).is_some(),
            "pack" => {
                let usage = value.parse().map_err(|e: UnknownPackUse| invalid(e.to_string()))?;
                self.pack.replace(usage).is_some()
            }
            "frames" => {
                let frames = value
                    .parse()
                    .map_err(|_| invalid("a number of images, at least 1, is expected".into()))?;
                self.frames.replace(frames).is_some()
            }
            _ => match Degradation::ALL.into_iter().find(|image| image.name() == part) {
                Some(image) => self.image.replace(image).is_some(),
                None => return Err(ConditionError::Unknown(part.to_owned())),
            },
        };
        if is_repeated {
            Err(invalid("a condition has at most one part of each kind".into()))
        } else {
            Ok(())
        }
    }
}

/// The parts of a condition. A `+` before a digit is a sign, as in `camera:f+3%`.
fn parts(text: &str) -> Vec<String> {
    let mut parts: Vec<String> = Vec::new();
    for piece in text.split('+') {
        match parts.last_mut() {
            Some(last) if piece.starts_with(|c: char| c.is_ascii_digit()) => {
                *last = format!("{last}+{piece}");
            }
            _ => parts.push(piece.to_owned()),
        }
    }
    parts
}

impl FromStr for Condition {
    type Err = ConditionError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let mut condition = Self::NONE;
        if text.trim() == "none" {
            return Ok(condition);
        }
        for part in parts(text.trim()) {
            condition.set(&part)?;
        }
        let refuse = |reason| Err(ConditionError::Contradiction { condition: text.to_owned(), reason });
        match condition {
            Self { negatives: true, frames: Some(_), .. } => refuse("out-of-map images are single images"),
            Self { gravity: Some(_), frames: Some(_), .. } => {
                refuse("images together are localized without gravity")
            }
            Self { negatives: true, gravity: Some(noise), .. } if noise.wrong_by_deg > 0.0 => {
                refuse("the gravity of an out-of-map image is random, so it has no error")
            }
            _ => Ok(condition),
        }
    }
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let flag = |is: bool, word: &str| is.then(|| word.to_owned());
        let parts = [
            flag(self.negatives, "negatives"),
            self.image.map(|image| image.name().to_owned()),
            flag(self.sparse_map, "sparse-map"),
            flag(self.few_keypoints, "few-keypoints"),
            self.camera.map(|camera| format!("camera:{camera}")),
            self.gravity.map(|noise| format!("gravity:{noise}")),
            self.frames.map(|frames| format!("frames:{frames}")),
            self.pack.map(|usage| format!("pack:{}", usage.name())),
        ];
        let parts: Vec<String> = parts.into_iter().flatten().collect();
        f.pad(if parts.is_empty() { "none".to_owned() } else { parts.join("+") }.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conditions_round_trip() {
        for text in [
            "none",
            "dark",
            "motion",
            "half-hidden",
            "side-hidden",
            "low-resolution",
            "sparse-map",
            "few-keypoints",
            "camera:f~10%",
            "camera:cx+5%",
            "camera:fy-10%",
            "camera:k1-0.2",
            "gravity:0.5",
            "gravity:0.5/90",
            "frames:4",
            "negatives",
            "half-hidden+frames:4",
            "negatives+gravity:0.5",
            "pack:explained",
            "half-hidden+frames:2+pack:matches",
            "dark+sparse-map+few-keypoints+camera:f+3%+gravity:1",
        ] {
            let condition: Condition = text.parse().expect(text);
            assert_eq!(condition.to_string(), text);
            assert_eq!(condition.name().is_none(), text == "none");
        }
        let normalized = |text: &str| text.parse::<Condition>().expect(text).to_string();
        assert_eq!(normalized(" gravity:0.50/0+dark "), "dark+gravity:0.5");
        assert_eq!(normalized("camera:f+3.0%+sparse-map"), "sparse-map+camera:f+3%");
    }

    #[test]
    fn invalid_conditions_are_refused() {
        for (text, words) in [
            ("light", "half-hidden"),
            ("", "known are"),
            ("dark+", "known are"),
            ("none+dark", "\"none\" is no part"),
            ("dark:3", "known are"),
            ("sparse-map:4", "known are"),
            ("dark+motion", "at most one"),
            ("frames:1+frames:2", "at most one"),
            ("frames:0", "at least 1"),
            ("gravity:-1", "above 0"),
            ("gravity:0.5,5", "above 0"),
            ("camera:g+3%", "cx"),
            ("camera:f~51%", "50"),
            ("pack:all", "matches or explained"),
            ("negatives+frames:2", "single images"),
            ("frames:2+gravity:1", "without gravity"),
            ("negatives+gravity:1/5", "random"),
        ] {
            let refused = text.parse::<Condition>().expect_err(text).to_string();
            assert!(refused.contains(words), "{text}: {refused}");
        }
    }
}
