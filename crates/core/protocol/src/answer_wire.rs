//! Answers as bytes: the message `veiloc.v1.Answer` (`proto/veiloc/v1/answer.proto`).
//!
//! It is padded to a length that does not reveal whether the pose is trusted. The encoding is canonical:
//! [`Answer::encode`] reproduces byte for byte what [`Answer::decode`] accepts.

use prost::Message;

use crate::answer::{AnswerFit, AnswerPose};
use crate::wire::{Format, present};
use crate::{Answer, AnswerDoubt, AnswerTimes, DoubtKind, GravityUse, MapCoordinates, QueryError};

const FORMAT: Format = Format {
    what: "answer",
    // 53 numbers, some counts, space for a few doubt texts, and padding.
    limit: 16 * 1024,
    version: Answer::VERSION,
    remedy: "update the app or the service, whichever is older",
};

/// Bytes around the padding: its key and a length of two bytes.
const PADDING_HEAD: usize = 3;
/// Minimum number of padding bytes, so that its length always takes two bytes.
const MIN_PADDING: usize = 128;

/// How far from 1 the length of a quaternion or of `down` may be.
const UNIT_TOLERANCE: f64 = 1e-6;

#[derive(Clone, PartialEq, Message)]
struct AnswerMessage {
    #[prost(fixed32, optional, tag = "1")]
    version: Option<u32>,
    #[prost(double, repeated, tag = "2")]
    rotation: Vec<f64>,
    #[prost(double, repeated, tag = "3")]
    translation: Vec<f64>,
    #[prost(double, repeated, tag = "4")]
    covariance: Vec<f64>,
    #[prost(message, repeated, tag = "5")]
    doubts: Vec<DoubtMessage>,
    #[prost(double, optional, tag = "6")]
    log_evidence: Option<f64>,
    #[prost(double, optional, tag = "7")]
    margin: Option<f64>,
    #[prost(fixed32, optional, tag = "8")]
    inliers: Option<u32>,
    #[prost(fixed32, optional, tag = "9")]
    matches: Option<u32>,
    #[prost(fixed32, optional, tag = "10")]
    hypotheses: Option<u32>,
    #[prost(double, repeated, tag = "11")]
    milliseconds: Vec<f64>,
    #[prost(fixed32, optional, tag = "12")]
    gravity: Option<u32>,
    #[prost(double, optional, tag = "13")]
    metres_per_unit: Option<f64>,
    #[prost(double, repeated, tag = "14")]
    down: Vec<f64>,
    #[prost(bytes = "vec", optional, tag = "15")]
    padding: Option<Vec<u8>>,
    #[prost(double, optional, tag = "16")]
    noise_px: Option<f64>,
    #[prost(double, optional, tag = "17")]
    focal_scale: Option<f64>,
    #[prost(double, repeated, tag = "18")]
    principal_shift_px: Vec<f64>,
}

#[derive(Clone, PartialEq, Message)]
struct DoubtMessage {
    #[prost(fixed32, optional, tag = "1")]
    kind: Option<u32>,
    #[prost(string, optional, tag = "2")]
    text: Option<String>,
}

impl Answer {
    /// The version of the message.
    pub const VERSION: u32 = 1;

    /// As bytes: one `veiloc.v1.Answer` message.
    pub fn encode(&self) -> Vec<u8> {
        let mut message = self.message();
        let without = message.encoded_len() + PADDING_HEAD;
        let whole = (without + MIN_PADDING).next_multiple_of(Self::PADDED_BYTES);
        message.padding = Some(vec![0; whole - without]);
        message.encode_to_vec()
    }

    /// All fields except the padding.
    fn message(&self) -> AnswerMessage {
        let AnswerTimes { queue_ms, retrieve_ms, match_ms, pose_ms } = self.times;
        let doubt = |d: &AnswerDoubt| DoubtMessage { kind: Some(d.kind.code()), text: Some(d.text.clone()) };
        let of_pose =
            |numbers: fn(&AnswerPose) -> Vec<f64>| self.pose.as_ref().map_or_else(Vec::new, numbers);
        AnswerMessage {
            version: Some(Self::VERSION),
            rotation: of_pose(|pose| pose.rotation.to_vec()),
            translation: of_pose(|pose| pose.translation.to_vec()),
            covariance: of_pose(|pose| pose.covariance.concat()),
            doubts: self.doubts.iter().map(doubt).collect(),
            log_evidence: Some(self.log_evidence),
            margin: Some(self.margin),
            inliers: Some(self.inliers),
            matches: Some(self.matches),
            hypotheses: Some(self.hypotheses),
            milliseconds: vec![queue_ms, retrieve_ms, match_ms, pose_ms],
            gravity: Some(self.gravity.code()),
            metres_per_unit: self.map.metres_per_unit,
            down: self.map.down.map_or_else(Vec::new, |down| down.to_vec()),
            padding: None,
            noise_px: self.fit.map(|fit| fit.noise_px),
            focal_scale: self.fit.map(|fit| fit.focal_scale),
            principal_shift_px: self.fit.map_or_else(Vec::new, |fit| fit.principal_shift_px.to_vec()),
        }
    }

    /// From bytes; an accepted message encodes to the same bytes again.
    ///
    /// # Errors
    /// [`QueryError`] naming the wrong field.
    pub fn decode(bytes: &[u8]) -> Result<Self, QueryError> {
        let message: AnswerMessage = FORMAT.message(bytes)?;
        // Only doubtful poses are withheld.
        let withheld = !message.doubts.is_empty() && message.rotation.is_empty();
        let pose = if withheld { None } else { Some(pose(&message)?) };
        let [queue_ms, retrieve_ms, match_ms, pose_ms] =
            numbers("milliseconds", &message.milliseconds, |c| c.is_finite() && c >= 0.0)?;
        let [log_evidence, margin] = [
            ("log_evidence", present("log_evidence", message.log_evidence)?),
            ("margin", present("margin", message.margin)?),
        ]
        .map(
            |(field, value)| {
                if value.is_nan() { Err(invalid(field, "a number", "NaN")) } else { Ok(value) }
            },
        );
        let (fit, map) = (fit(&message)?, map(&message)?);
        let code = present("gravity", message.gravity)?;
        let gravity = GravityUse::ALL.get(code as usize).copied().ok_or(QueryError::Field {
            field: "gravity",
            value: code,
            allowed: "a number from 0 to 2",
        })?;
        let answer = Self {
            pose,
            doubts: message.doubts.into_iter().map(doubt).collect::<Result<_, _>>()?,
            log_evidence: log_evidence?,
            margin: margin?,
            fit,
            gravity,
            map,
            inliers: present("inliers", message.inliers)?,
            matches: present("matches", message.matches)?,
            hypotheses: present("hypotheses", message.hypotheses)?,
            times: AnswerTimes { queue_ms, retrieve_ms, match_ms, pose_ms },
        };
        if answer.encode() != bytes {
            return Err(QueryError::NotCanonical { what: FORMAT.what });
        }
        Ok(answer)
    }
}

fn pose(message: &AnswerMessage) -> Result<AnswerPose, QueryError> {
    let rotation = unit_vector::<4>("rotation", &message.rotation)?;
    let covariance: [f64; 36] = numbers("covariance", &message.covariance, |c| !c.is_nan())?;
    Ok(AnswerPose {
        rotation,
        translation: numbers("translation", &message.translation, f64::is_finite)?,
        covariance: std::array::from_fn(|i| std::array::from_fn(|j| covariance[6 * i + j])),
    })
}

fn map(message: &AnswerMessage) -> Result<MapCoordinates, QueryError> {
    let metres_per_unit = message.metres_per_unit.map(|metres| above_zero("metres_per_unit", Some(metres)));
    let is_known = !message.down.is_empty();
    Ok(MapCoordinates {
        metres_per_unit: metres_per_unit.transpose()?,
        down: is_known.then(|| unit_vector("down", &message.down)).transpose()?,
    })
}

/// A vector or a quaternion of length 1.
fn unit_vector<const N: usize>(field: &'static str, values: &[f64]) -> Result<[f64; N], QueryError> {
    let vector = numbers(field, values, f64::is_finite)?;
    let length = vector.iter().map(|c| c * c).sum::<f64>().sqrt();
    let is_unit = (length - 1.0).abs() <= UNIT_TOLERANCE;
    is_unit.then_some(vector).ok_or_else(|| invalid(field, "a length of 1", &format!("length {length}")))
}

fn above_zero(field: &'static str, value: Option<f64>) -> Result<f64, QueryError> {
    let value = present(field, value)?;
    let is_valid = value.is_finite() && value > 0.0;
    is_valid.then_some(value).ok_or_else(|| invalid(field, "a number above 0", &value.to_string()))
}

/// All three fields or none.
fn fit(message: &AnswerMessage) -> Result<Option<AnswerFit>, QueryError> {
    let AnswerMessage { noise_px, focal_scale, principal_shift_px, .. } = message;
    if noise_px.is_none() && focal_scale.is_none() && principal_shift_px.is_empty() {
        return Ok(None);
    }
    Ok(Some(AnswerFit {
        noise_px: above_zero("noise_px", *noise_px)?,
        focal_scale: above_zero("focal_scale", *focal_scale)?,
        principal_shift_px: numbers("principal_shift_px", principal_shift_px, f64::is_finite)?,
    }))
}

fn doubt(message: DoubtMessage) -> Result<AnswerDoubt, QueryError> {
    let code = present("doubts.kind", message.kind)?;
    let kind = DoubtKind::ALL.get(code as usize).copied().ok_or(QueryError::Field {
        field: "doubts.kind",
        value: code,
        allowed: "a number from 0 to 4",
    })?;
    Ok(AnswerDoubt { kind, text: present("doubts.text", message.text)? })
}

/// Exactly `N` numbers that satisfy `allowed`.
fn numbers<const N: usize>(
    field: &'static str,
    values: &[f64],
    allowed: impl Fn(f64) -> bool,
) -> Result<[f64; N], QueryError> {
    let array: [f64; N] = values.try_into().map_err(|_| QueryError::Length {
        field,
        expected: N * size_of::<f64>(),
        actual: size_of_val(values),
    })?;
    match array.iter().find(|value| !allowed(**value)) {
        Some(value) => Err(invalid(field, "numbers in range", &value.to_string())),
        None => Ok(array),
    }
}

fn invalid(field: &'static str, expected: &str, actual: &str) -> QueryError {
    QueryError::Mismatch { what: field, expected: expected.to_owned(), actual: actual.to_owned() }
}
