//! Messages between gateway and workers: small frames around bytes that a device or the service wrote.
//!
//! Both ends are machines of the operator. Lengths, names and numbers are checked nevertheless, and an invalid frame
//! gives a [`ClusterError`] that names the field. Frames are protobuf; `docs/reference/configuration.md` lists the fields.

use crate::ClusterError;
use crate::frame_version::check_version;
use bytes::Bytes;
use prost::Message;
use veiloc_map::regions::ObjectId;
use veiloc_protocol::{Answer, PositionHint};
use veiloc_service::auth::Lane;
use veiloc_service::telemetry::SpanId;
use veiloc_service::{BodyKind, LocalizeFailure, NoPose};

use std::num::NonZeroU64;
use std::time::Duration;

/// Maximum overhead of a frame, bytes.
pub const FRAME_BYTES: usize = 1024;

/// Maximum number of requests that a ping asks about.
pub const MAX_PINGED: usize = 64;

/// Every reply about a query has this length, whatever its content, unless the content is longer.
pub const REPLY_BYTES: usize = 5120;

/// Maximum `retry_after` in a reply, seconds.
const MAX_WAIT: u32 = 60;

/// The name of a request: the one of its log line.
pub type RequestIdBytes = [u8; 16];

/// A request to a worker.
#[derive(Clone, PartialEq)]
pub struct Request {
    /// The version of its frame, which the reply has too: one that both machines speak.
    pub version: u32,
    /// The name of the gateway's request that it is part of.
    pub name: RequestIdBytes,
    /// The region or index to use; a worker that does not hold it refuses ([`RejectReason::NotHeld`]). Of a ping: any.
    pub object: ObjectId,
    /// The client for which it is sent; `None` where clients are not distinguished. The worker's queue is fair between
    /// clients.
    pub lane: Option<Lane>,
    /// Descriptor rows of the query, from which its time is estimated.
    pub rows: u32,
    /// Time allowed for the answer, from the arrival of the request (machines' clocks are not compared).
    pub within: Duration,
    /// The span of this message, if the gateway sends traces: the parent of the worker's. The id of the trace is the name.
    pub span: Option<SpanId>,
    /// The task.
    pub task: Task,
}

/// The task of a request.
#[derive(Clone, PartialEq)]
pub enum Task {
    /// Whether the worker runs, and which of these requests it does not know: it never received them.
    Ping {
        /// Name and object of each, at most [`MAX_PINGED`].
        owed: Vec<(RequestIdBytes, ObjectId)>,
    },
    /// Retrieval in an index: the regions to ask, for the global descriptors of the images.
    Search {
        /// Codes of each, at least one.
        globals: Vec<Bytes>,
    },
    /// A pose, of a region.
    Pose {
        /// What the body is.
        kind: BodyKind,
        /// The body, as the device sent it.
        body: Bytes,
        /// Where the camera roughly is.
        near: Option<PositionHint>,
    },
}

/// Rule L8: nothing of a query reaches a log.
impl std::fmt::Debug for Request {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let task = match self.task {
            Task::Ping { .. } => "ping",
            Task::Search { .. } => "search",
            Task::Pose { .. } => "pose",
        };
        f.debug_struct("Request").field("object", &self.object).field("task", &task).finish_non_exhaustive()
    }
}

/// The reply of a worker.
#[derive(Debug, Clone, PartialEq)]
pub struct Reply {
    /// The version of its frame: that of the request.
    pub version: u32,
    /// The request's name.
    pub name: RequestIdBytes,
    /// The result.
    pub outcome: ReplyOutcome,
    /// Time spent working.
    pub worked: Duration,
    /// Time spent in the queue.
    pub waited: Duration,
    /// The load of the worker when it replied.
    pub load: Load,
}

/// How busy a worker is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Load {
    /// Requests for poses that it works on, or that wait for a thread.
    pub jobs: u32,
    /// Further requests that may wait for a thread.
    pub free: u32,
}

/// The result of a request.
#[derive(Debug, Clone, PartialEq)]
pub enum ReplyOutcome {
    /// The reply to [`Task::Ping`].
    Here {
        /// Numbers of the requests in the ping that the worker does not know, ascending.
        unknown: Vec<u32>,
    },
    /// The regions that hold most of the retrieved images, best first.
    Regions(Vec<Candidate>),
    /// The complete answer.
    Pose(Box<Answer>),
    /// There is no pose, or there will be none; asking another worker that holds the object would give the same.
    Failed(LocalizeFailure),
    /// This worker cannot answer; another worker that holds the object may.
    Rejected(RejectReason),
}

impl ReplyOutcome {
    /// Its name in metrics and traces.
    pub(crate) const fn name(&self) -> &'static str {
        match self {
            Self::Here { .. } => "here",
            Self::Regions(_) | Self::Pose(_) => "answered",
            Self::Failed(_) => "no-pose",
            Self::Rejected(RejectReason::Busy { .. } | RejectReason::Leaving) => "busy",
            Self::Rejected(RejectReason::InProgress) => "duplicate",
            Self::Rejected(RejectReason::NotHeld | RejectReason::Undecodable) => "rejected",
            Self::Rejected(RejectReason::Broken) => "internal-error",
        }
    }
}

/// A region to ask.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Candidate {
    /// Its number in the manifest.
    pub region: u32,
    /// Number of retrieved images that the region holds.
    pub held: u32,
}

/// Why the gateway should ask another worker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RejectReason {
    /// All threads are busy and the queue is full, or too long for the time there is.
    Busy {
        /// Seconds after which there should be room, 1 to 60.
        retry_after: NonZeroU64,
    },
    /// It is already working on this request.
    InProgress,
    /// It is leaving.
    Leaving,
    /// It holds another object than the request names.
    NotHeld,
    /// It could not read the request.
    Undecodable,
    /// An internal error of the worker, which was logged.
    Broken,
}

#[derive(Clone, PartialEq, Message)]
#[prost(skip_debug)]
struct RequestFrame {
    #[prost(fixed32, tag = "1")]
    version: u32,
    #[prost(bytes = "bytes", tag = "2")]
    name: Bytes,
    #[prost(bytes = "bytes", tag = "3")]
    object: Bytes,
    #[prost(fixed32, tag = "4")]
    within_ms: u32,
    #[prost(fixed32, tag = "5")]
    wanted: u32,
    #[prost(double, repeated, tag = "6")]
    near: Vec<f64>,
    #[prost(bytes = "bytes", repeated, tag = "7")]
    body: Vec<Bytes>,
    #[prost(bytes = "bytes", tag = "8")]
    lane: Bytes,
    #[prost(fixed32, tag = "9")]
    rows: u32,
    #[prost(fixed64, tag = "10")]
    span: u64,
}

#[derive(Clone, PartialEq, Message)]
struct ReplyFrame {
    #[prost(fixed32, tag = "1")]
    version: u32,
    #[prost(bytes = "bytes", tag = "2")]
    name: Bytes,
    #[prost(fixed32, tag = "3")]
    outcome: u32,
    #[prost(fixed32, tag = "4")]
    retry_after: u32,
    #[prost(fixed64, tag = "5")]
    worked_us: u64,
    #[prost(fixed64, tag = "6")]
    waited_us: u64,
    #[prost(bytes = "bytes", tag = "7")]
    answer: Bytes,
    #[prost(fixed32, repeated, tag = "8")]
    regions: Vec<u32>,
    #[prost(fixed32, repeated, tag = "9")]
    held: Vec<u32>,
    #[prost(bytes = "bytes", tag = "10")]
    padding: Bytes,
    #[prost(fixed32, tag = "11")]
    jobs: u32,
    #[prost(fixed32, tag = "12")]
    free: u32,
}

/// Maximum number of regions that an index returns.
pub const MAX_REGIONS: usize = 64;

const PING: u32 = 0;
const SEARCH: u32 = 1;
const QUERY: u32 = 2;
const RIG: u32 = 3;

impl Request {
    /// As bytes.
    pub fn encode(&self) -> Bytes {
        let (wanted, near, body) = match &self.task {
            Task::Ping { owed } => (PING, None, owed.iter().map(owed_bytes).collect()),
            Task::Search { globals } => (SEARCH, None, globals.clone()),
            Task::Pose { kind: BodyKind::Query, body, near } => (QUERY, *near, vec![body.clone()]),
            Task::Pose { kind: BodyKind::Rig, body, near } => (RIG, *near, vec![body.clone()]),
        };
        let near = near.map_or_else(Vec::new, |near| {
            let [x, y, z] = near.center();
            vec![x, y, z, near.sd()]
        });
        let frame = RequestFrame {
            version: self.version,
            name: Bytes::copy_from_slice(&self.name),
            object: Bytes::copy_from_slice(self.object.as_bytes()),
            within_ms: u32::try_from(self.within.as_millis()).unwrap_or(u32::MAX),
            wanted,
            near,
            body,
            lane: self.lane.map_or_else(Bytes::new, |lane| Bytes::copy_from_slice(lane.as_bytes())),
            rows: self.rows,
            span: self.span.map_or(0, SpanId::number),
        };
        frame.encode_to_vec().into()
    }

    /// Parses a frame; the sealed query in it is not decoded.
    ///
    /// # Errors
    /// [`ClusterError`] that names the wrong field.
    pub fn decode(bytes: Bytes) -> Result<Self, ClusterError> {
        let frame = RequestFrame::decode(bytes).map_err(|_| ClusterError::Frame)?;
        check_version(frame.version)?;
        let field = |field| ClusterError::FrameField { field };
        let object: [u8; 32] = frame.object.as_ref().try_into().map_err(|_| field("object"))?;
        let near = match frame.near[..] {
            [] => None,
            [x, y, z, sd] => Some(PositionHint::new([x, y, z], sd).map_err(|_| field("near"))?),
            _ => return Err(field("near")),
        };
        let mut body = frame.body;
        let task = match (frame.wanted, body.len()) {
            (PING, 0..=MAX_PINGED) => {
                let owed: Option<Vec<_>> = body.iter().map(read_owed).collect();
                Task::Ping { owed: owed.ok_or(field("body"))? }
            }
            (SEARCH, 1..=32) => Task::Search { globals: body },
            (QUERY | RIG, 1) => {
                let kind = if frame.wanted == QUERY { BodyKind::Query } else { BodyKind::Rig };
                Task::Pose { kind, body: body.swap_remove(0), near }
            }
            (PING | SEARCH | QUERY | RIG, _) => return Err(field("body")),
            _ => return Err(field("wanted")),
        };
        let lane = match frame.lane.len() {
            0 => None,
            _ => Some(Lane::from_bytes(frame.lane.as_ref().try_into().map_err(|_| field("lane"))?)),
        };
        Ok(Self {
            version: frame.version,
            lane,
            rows: frame.rows,
            span: SpanId::from_number(frame.span),
            name: name(&frame.name)?,
            object: ObjectId::from_bytes(object),
            within: Duration::from_millis(frame.within_ms.into()),
            task,
        })
    }
}

impl Reply {
    /// Encodes the reply. All replies about a query have the same length.
    pub fn encode(&self) -> Bytes {
        let code = code_of(&self.outcome);
        let micros = |time: Duration| u64::try_from(time.as_micros()).unwrap_or(u64::MAX);
        let mut frame = ReplyFrame {
            version: self.version,
            name: Bytes::copy_from_slice(&self.name),
            outcome: code,
            worked_us: micros(self.worked),
            waited_us: micros(self.waited),
            jobs: self.load.jobs,
            free: self.load.free,
            ..ReplyFrame::default()
        };
        match &self.outcome {
            ReplyOutcome::Regions(candidates) => {
                frame.regions = candidates.iter().map(|candidate| candidate.region).collect();
                frame.held = candidates.iter().map(|candidate| candidate.held).collect();
            }
            ReplyOutcome::Pose(answer) => frame.answer = answer.encode().into(),
            ReplyOutcome::Failed(
                LocalizeFailure::Busy { retry_after } | LocalizeFailure::Unreached { retry_after },
            )
            | ReplyOutcome::Rejected(RejectReason::Busy { retry_after }) => {
                frame.retry_after = u32::try_from(retry_after.get()).unwrap_or(MAX_WAIT).min(MAX_WAIT);
            }
            ReplyOutcome::Here { unknown } => frame.regions.clone_from(unknown),
            ReplyOutcome::Failed(_) | ReplyOutcome::Rejected(_) => {}
        }
        if !matches!(self.outcome, ReplyOutcome::Here { .. } | ReplyOutcome::Regions(_)) {
            // Tag and length of the padding take three bytes if the frame has 128 to 16384 bytes.
            let left = REPLY_BYTES.saturating_sub(frame.encoded_len() + 3);
            frame.padding = vec![0; left].into();
        }
        frame.encode_to_vec().into()
    }

    /// Parses the reply to the request of this name.
    ///
    /// # Errors
    /// [`ClusterError`] that names the wrong field.
    pub fn decode(bytes: Bytes, expected_name: &RequestIdBytes) -> Result<Self, ClusterError> {
        let frame = ReplyFrame::decode(bytes).map_err(|_| ClusterError::Frame)?;
        check_version(frame.version)?;
        let name = name(&frame.name)?;
        if name != *expected_name {
            return Err(ClusterError::OtherRequest);
        }
        let (worked, waited) =
            (Duration::from_micros(frame.worked_us), Duration::from_micros(frame.waited_us));
        let load = Load { jobs: frame.jobs, free: frame.free };
        let version = frame.version;
        Ok(Self { version, name, outcome: outcome_of(frame)?, worked, waited, load })
    }
}

/// Name and object of a request that a ping asks about.
fn owed_bytes((name, object): &(RequestIdBytes, ObjectId)) -> Bytes {
    [&name[..], object.as_bytes()].concat().into()
}

fn read_owed(bytes: &Bytes) -> Option<(RequestIdBytes, ObjectId)> {
    let (name, object) = bytes.split_at_checked(16)?;
    Some((name.try_into().ok()?, ObjectId::from_bytes(object.try_into().ok()?)))
}

fn name(bytes: &Bytes) -> Result<RequestIdBytes, ClusterError> {
    bytes.as_ref().try_into().map_err(|_| ClusterError::FrameField { field: "name" })
}

const HERE: u32 = 0;
const REGIONS: u32 = 1;
const POSE: u32 = 2;

/// Every outcome has one number, which never changes.
const fn code_of(outcome: &ReplyOutcome) -> u32 {
    match outcome {
        ReplyOutcome::Here { .. } => HERE,
        ReplyOutcome::Regions(_) => REGIONS,
        ReplyOutcome::Pose(_) => POSE,
        ReplyOutcome::Failed(why) => match why {
            LocalizeFailure::WrongProfile => 16,
            LocalizeFailure::EmptyMap => 17,
            LocalizeFailure::NoPose(NoPose::Unsupported) => 18,
            LocalizeFailure::NoPose(NoPose::OneSided) => 19,
            LocalizeFailure::NoPose(NoPose::TooFew) => 20,
            LocalizeFailure::Stopped => 21,
            LocalizeFailure::Busy { .. } => 22,
            LocalizeFailure::Unreached { .. } => 23,
            LocalizeFailure::TimedOut => 24,
            LocalizeFailure::Broken => 25,
        },
        ReplyOutcome::Rejected(why) => match why {
            RejectReason::Busy { .. } => 32,
            RejectReason::InProgress => 33,
            RejectReason::Leaving => 34,
            RejectReason::NotHeld => 35,
            RejectReason::Undecodable => 36,
            RejectReason::Broken => 37,
        },
    }
}

fn outcome_of(frame: ReplyFrame) -> Result<ReplyOutcome, ClusterError> {
    let field = |field| ClusterError::FrameField { field };
    let retry_after = || {
        let seconds = NonZeroU64::new(frame.retry_after.into()).filter(|n| n.get() <= MAX_WAIT.into());
        seconds.ok_or(field("retry_after"))
    };
    Ok(match frame.outcome {
        HERE => {
            if frame.regions.len() > MAX_PINGED {
                return Err(field("regions"));
            }
            ReplyOutcome::Here { unknown: frame.regions }
        }
        REGIONS => {
            if frame.regions.len() != frame.held.len() || frame.regions.len() > MAX_REGIONS {
                return Err(field("regions"));
            }
            let both = frame.regions.iter().zip(&frame.held);
            ReplyOutcome::Regions(
                both.map(|(region, held)| Candidate { region: *region, held: *held }).collect(),
            )
        }
        POSE => ReplyOutcome::Pose(Box::new(Answer::decode(&frame.answer).map_err(|_| field("answer"))?)),
        16 => ReplyOutcome::Failed(LocalizeFailure::WrongProfile),
        17 => ReplyOutcome::Failed(LocalizeFailure::EmptyMap),
        18 => ReplyOutcome::Failed(LocalizeFailure::NoPose(NoPose::Unsupported)),
        19 => ReplyOutcome::Failed(LocalizeFailure::NoPose(NoPose::OneSided)),
        20 => ReplyOutcome::Failed(LocalizeFailure::NoPose(NoPose::TooFew)),
        21 => ReplyOutcome::Failed(LocalizeFailure::Stopped),
        22 => ReplyOutcome::Failed(LocalizeFailure::Busy { retry_after: retry_after()? }),
        23 => ReplyOutcome::Failed(LocalizeFailure::Unreached { retry_after: retry_after()? }),
        24 => ReplyOutcome::Failed(LocalizeFailure::TimedOut),
        25 => ReplyOutcome::Failed(LocalizeFailure::Broken),
        32 => ReplyOutcome::Rejected(RejectReason::Busy { retry_after: retry_after()? }),
        33 => ReplyOutcome::Rejected(RejectReason::InProgress),
        34 => ReplyOutcome::Rejected(RejectReason::Leaving),
        35 => ReplyOutcome::Rejected(RejectReason::NotHeld),
        36 => ReplyOutcome::Rejected(RejectReason::Undecodable),
        37 => ReplyOutcome::Rejected(RejectReason::Broken),
        _ => return Err(field("outcome")),
    })
}

#[cfg(test)]
mod tests;
