//! What a server answers: the pose, how well it is known, whether to trust it.
//!
//! The message is `veiloc.v1.Answer` (`proto/veiloc/v1/answer.proto`), in one of two versions: the second is filled up
//! to a length that does not tell a trusted pose from a doubtful one. Each version has one form only: what
//! [`Answer::decode`] accepts, [`Answer::encode`] writes back byte for byte in the version it had.

use prost::Message;

use crate::QueryError;
use crate::wire::{self, present};

/// Most bytes an answer may have: 57 numbers, some counts, room for a few doubts in words, and padding.
const MAX_BYTES: usize = 16 * 1024;

/// Bytes around the padding of version 2: its key and a length of two bytes.
const PADDING_HEAD: usize = 3;
/// Least bytes of padding, so that its length always takes two bytes.
const LEAST_PADDING: usize = 128;

/// How an answer is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum AnswerVersion {
    /// Version 1: as long as what it says. A doubtful pose has the longer answer.
    Plain,
    /// Version 2: a whole number of [`Answer::PADDED_BYTES`], one for every answer our server gives.
    #[default]
    Padded,
}

impl AnswerVersion {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Plain, Self::Padded];

    /// As it is written: 1 or 2.
    pub const fn number(self) -> u32 {
        match self {
            Self::Plain => 1,
            Self::Padded => 2,
        }
    }
}

/// How far from 1 the length of a quaternion may be.
const UNIT_TOLERANCE: f64 = 1e-6;

/// Where a sealed query was taken, as the server tells it.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// Hamilton unit quaternion `w x y z`: map coordinates to camera coordinates.
    pub rotation: [f64; 4],
    /// `t` of `x_camera = R x_map + t`, map units.
    pub translation: [f64; 3],
    /// Where the camera is in the map, map units: `−Rᵀ t`.
    pub center: [f64; 3],
    /// Covariance of rotation vector (radians, camera axes) and translation (map units), rows and columns. Infinite
    /// on the diagonal where the matches leave a direction free.
    pub covariance: [[f64; 6]; 6],
    /// Covariance of `center` in the map's axes, map units squared.
    pub center_covariance: [[f64; 3]; 3],
    /// Whether nothing speaks against the pose.
    pub trusted: bool,
    /// What does.
    pub doubts: Vec<AnswerDoubt>,
    /// Natural logarithm of the evidence against chance.
    pub log_evidence: f64,
    /// Log likelihood by which the pose beats the best other one; infinite when no other was found.
    pub margin: f64,
    /// Rows of the query that agree with the pose.
    pub inliers: u32,
    /// Rows of the query that were matched to map points, to one or several.
    pub matches: u32,
    /// Minimal samples drawn.
    pub hypotheses: u32,
    /// Milliseconds of each stage.
    pub times: AnswerTimes,
}

/// Milliseconds the server spent.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AnswerTimes {
    /// Waiting for a worker.
    pub queue_ms: f64,
    /// Finding similar map images.
    pub retrieve_ms: f64,
    /// Matching descriptors.
    pub match_ms: f64,
    /// Estimating the pose.
    pub pose_ms: f64,
}

/// One thing that speaks against a pose.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AnswerDoubt {
    /// For programs.
    pub kind: DoubtKind,
    /// For people.
    pub text: String,
}

/// What a doubt is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DoubtKind {
    /// None of the others.
    Other,
    /// So many agreeing matches could be chance.
    WeakEvidence,
    /// Another pose explains the matches nearly as well.
    Ambiguous,
    /// The agreeing matches leave a direction nearly free.
    LooselyHeld,
    /// Nearly all agreeing lines run through one anchor.
    OneSided,
}

impl DoubtKind {
    /// All of them, each at the index that is its code.
    pub const ALL: [Self; 5] =
        [Self::Other, Self::WeakEvidence, Self::Ambiguous, Self::LooselyHeld, Self::OneSided];

    /// As it is written in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Other => "other",
            Self::WeakEvidence => "weak-evidence",
            Self::Ambiguous => "ambiguous",
            Self::LooselyHeld => "loosely-held",
            Self::OneSided => "one-sided",
        }
    }

    const fn code(self) -> u32 {
        match self {
            Self::Other => 0,
            Self::WeakEvidence => 1,
            Self::Ambiguous => 2,
            Self::LooselyHeld => 3,
            Self::OneSided => 4,
        }
    }
}

#[derive(Clone, PartialEq, Message)]
struct AnswerMessage {
    #[prost(fixed32, optional, tag = "1")]
    version: Option<u32>,
    #[prost(double, repeated, tag = "2")]
    rotation: Vec<f64>,
    #[prost(double, repeated, tag = "3")]
    translation: Vec<f64>,
    #[prost(double, repeated, tag = "4")]
    center: Vec<f64>,
    #[prost(double, repeated, tag = "5")]
    covariance: Vec<f64>,
    #[prost(double, repeated, tag = "6")]
    center_covariance: Vec<f64>,
    #[prost(fixed32, optional, tag = "7")]
    trusted: Option<u32>,
    #[prost(message, repeated, tag = "8")]
    doubts: Vec<DoubtMessage>,
    #[prost(double, optional, tag = "9")]
    log_evidence: Option<f64>,
    #[prost(double, optional, tag = "10")]
    margin: Option<f64>,
    #[prost(fixed32, optional, tag = "11")]
    inliers: Option<u32>,
    #[prost(fixed32, optional, tag = "12")]
    matches: Option<u32>,
    #[prost(fixed32, optional, tag = "13")]
    hypotheses: Option<u32>,
    #[prost(double, repeated, tag = "14")]
    milliseconds: Vec<f64>,
    #[prost(bytes = "vec", optional, tag = "15")]
    padding: Option<Vec<u8>>,
}

#[derive(Clone, PartialEq, Message)]
struct DoubtMessage {
    #[prost(fixed32, optional, tag = "1")]
    kind: Option<u32>,
    #[prost(string, optional, tag = "2")]
    text: Option<String>,
}

impl Answer {
    /// An answer of version 2 has a whole number of times so many bytes. A trusted one, and one with every doubt there
    /// is, have this length.
    pub const PADDED_BYTES: usize = 4096;

    /// As bytes: one `veiloc.v1.Answer` message.
    pub fn encode(&self, version: AnswerVersion) -> Vec<u8> {
        let mut message = self.message(version);
        if version == AnswerVersion::Padded {
            let without = message.encoded_len() + PADDING_HEAD;
            let whole = (without + LEAST_PADDING).next_multiple_of(Self::PADDED_BYTES);
            message.padding = Some(vec![0; whole - without]);
        }
        message.encode_to_vec()
    }

    fn message(&self, version: AnswerVersion) -> AnswerMessage {
        let AnswerTimes { queue_ms, retrieve_ms, match_ms, pose_ms } = self.times;
        let doubt = |d: &AnswerDoubt| DoubtMessage { kind: Some(d.kind.code()), text: Some(d.text.clone()) };
        AnswerMessage {
            version: Some(version.number()),
            rotation: self.rotation.to_vec(),
            translation: self.translation.to_vec(),
            center: self.center.to_vec(),
            covariance: self.covariance.concat(),
            center_covariance: self.center_covariance.concat(),
            trusted: Some(self.trusted.into()),
            doubts: self.doubts.iter().map(doubt).collect(),
            log_evidence: Some(self.log_evidence),
            margin: Some(self.margin),
            inliers: Some(self.inliers),
            matches: Some(self.matches),
            hypotheses: Some(self.hypotheses),
            milliseconds: vec![queue_ms, retrieve_ms, match_ms, pose_ms],
            padding: None,
        }
    }

    /// From bytes of either version; whatever is accepted encodes, in its version, to the same bytes again.
    ///
    /// # Errors
    /// [`QueryError`] saying which field is wrong.
    pub fn decode(bytes: &[u8]) -> Result<Self, QueryError> {
        let (message, version) = parse(bytes)?;
        let rotation: [f64; 4] = numbers("rotation", &message.rotation, f64::is_finite)?;
        let length = rotation.iter().map(|c| c * c).sum::<f64>().sqrt();
        let is_unit = (length - 1.0).abs() <= UNIT_TOLERANCE;
        if !is_unit {
            return Err(invalid("rotation", "a quaternion of length 1", &format!("length {length}")));
        }
        let covariance: [f64; 36] = numbers("covariance", &message.covariance, |c| !c.is_nan())?;
        let center_covariance: [f64; 9] =
            numbers("center_covariance", &message.center_covariance, |c| !c.is_nan())?;
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
        let answer = Self {
            rotation,
            translation: numbers("translation", &message.translation, f64::is_finite)?,
            center: numbers("center", &message.center, f64::is_finite)?,
            covariance: std::array::from_fn(|i| std::array::from_fn(|j| covariance[6 * i + j])),
            center_covariance: std::array::from_fn(|i| std::array::from_fn(|j| center_covariance[3 * i + j])),
            trusted: match present("trusted", message.trusted)? {
                0 => false,
                1 => true,
                value => return Err(QueryError::Field { field: "trusted", value, allowed: "0 or 1" }),
            },
            doubts: message.doubts.into_iter().map(doubt).collect::<Result<_, _>>()?,
            log_evidence: log_evidence?,
            margin: margin?,
            inliers: present("inliers", message.inliers)?,
            matches: present("matches", message.matches)?,
            hypotheses: present("hypotheses", message.hypotheses)?,
            times: AnswerTimes { queue_ms, retrieve_ms, match_ms, pose_ms },
        };
        if answer.encode(version) != bytes {
            return Err(QueryError::NotCanonical { what: "answer" });
        }
        Ok(answer)
    }
}

/// Bounded size, a protobuf message, a version that is read here.
fn parse(bytes: &[u8]) -> Result<(AnswerMessage, AnswerVersion), QueryError> {
    let what = "answer";
    if bytes.len() > MAX_BYTES {
        return Err(QueryError::TooLong { what, bytes: bytes.len(), limit: MAX_BYTES });
    }
    let message: AnswerMessage = wire::message(what, bytes)?;
    let found = present("version", message.version)?;
    match AnswerVersion::ALL.into_iter().find(|version| version.number() == found) {
        Some(version) => Ok((message, version)),
        None => Err(QueryError::Version { what, found, supported: AnswerVersion::default().number() }),
    }
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

/// Exactly `N` numbers, each as asked.
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
