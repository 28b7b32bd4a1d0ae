//! What workers say of themselves, to all gateways and workers of a map.
//!
//! A worker announces itself periodically, and at once when something changes. Who hears no announcement of it for
//! several periods forgets it: nothing is stored on the bus (decision 0052).

use std::collections::BTreeSet;
use std::fmt;
use std::num::NonZeroU32;
use std::time::Duration;

use bytes::Bytes;
use prost::Message;
use veiloc_map::regions::ObjectId;

use crate::ClusterError;
use crate::frame_version::FrameVersions;
use crate::message::Load;
use crate::placement::Placed;

/// Bounds of the announced period.
const MIN_PERIOD: Duration = Duration::from_millis(10);
const MAX_PERIOD: Duration = Duration::from_secs(60);

/// Id of a running worker or gateway, drawn at its start.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MemberId([u8; 16]);

impl MemberId {
    /// A new id.
    ///
    /// # Errors
    /// [`ClusterError::System`]: the system has no randomness.
    pub fn draw() -> Result<Self, ClusterError> {
        let mut bytes = [0; 16];
        let wrong = |error: getrandom::Error| std::io::Error::other(error.to_string());
        getrandom::fill(&mut bytes)
            .map_err(|error| ClusterError::System { what: "randomness", source: wrong(error) })?;
        Ok(Self(bytes))
    }

    /// From its bytes.
    pub const fn from_bytes(bytes: [u8; 16]) -> Self {
        Self(bytes)
    }

    pub(crate) const fn as_bytes(&self) -> &[u8; 16] {
        &self.0
    }
}

/// 32 hexadecimal digits.
impl fmt::Display for MemberId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for MemberId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "MemberId({self})")
    }
}

/// An announcement of a worker.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Announcement {
    /// The versions of frames that it speaks.
    pub versions: FrameVersions,
    /// The worker.
    pub member: MemberId,
    /// Time until the next announcement.
    pub period: Duration,
    /// Whether it takes no further requests, because it is stopping.
    pub leaving: bool,
    /// Threads that localize, at least one.
    pub threads: u32,
    /// How busy it is.
    pub load: Load,
    /// The regions and indexes that it holds.
    pub objects: BTreeSet<ObjectId>,
    /// How it takes part in the placement of regions; `None`: it holds a fixed share.
    pub placed: Option<Placed>,
}

/// An announcement as far as programs of all versions read it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Announced {
    /// Of a worker with which this program has a version of frames in common.
    Known(Announcement),
    /// Of one with which it has none.
    Foreign {
        /// The versions that it speaks.
        versions: FrameVersions,
        /// The worker.
        member: MemberId,
        /// Time until the next announcement.
        period: Duration,
        /// Whether it is stopping.
        leaving: bool,
    },
}

/// The fields 1 to 4 and 9 never change: so machines of other versions are noticed.
#[derive(Clone, PartialEq, Message)]
struct AnnouncementFrame {
    /// The oldest version that the worker speaks.
    #[prost(fixed32, tag = "1")]
    version: u32,
    #[prost(bytes = "bytes", tag = "2")]
    member: Bytes,
    #[prost(fixed32, tag = "3")]
    period_ms: u32,
    #[prost(fixed32, tag = "4")]
    leaving: u32,
    #[prost(fixed32, tag = "5")]
    threads: u32,
    #[prost(fixed32, tag = "6")]
    jobs: u32,
    #[prost(fixed32, tag = "7")]
    free: u32,
    #[prost(bytes = "bytes", tag = "8")]
    objects: Bytes,
    /// The newest version that the worker speaks; 0 if it is the oldest.
    #[prost(fixed32, tag = "9")]
    newest: u32,
    #[prost(string, tag = "10")]
    name: String,
    /// 0: it holds a fixed share.
    #[prost(fixed32, tag = "11")]
    replicas: u32,
    /// 0: no limit.
    #[prost(fixed32, tag = "12")]
    max_regions: u32,
}

impl Announcement {
    /// As bytes.
    pub fn encode(&self) -> Bytes {
        let frame = AnnouncementFrame {
            version: self.versions.oldest(),
            member: Bytes::copy_from_slice(&self.member.0),
            period_ms: u32::try_from(self.period.as_millis()).unwrap_or(u32::MAX),
            leaving: self.leaving.into(),
            threads: self.threads,
            jobs: self.load.jobs,
            free: self.load.free,
            objects: self.objects.iter().flat_map(|object| *object.as_bytes()).collect::<Vec<u8>>().into(),
            newest: if self.versions.newest() == self.versions.oldest() { 0 } else { self.versions.newest() },
            name: self.placed.as_ref().map(|placed| placed.name.clone()).unwrap_or_default(),
            replicas: self.placed.as_ref().map_or(0, |placed| placed.replicas.get()),
            max_regions: self
                .placed
                .as_ref()
                .and_then(|placed| placed.max_regions)
                .map_or(0, NonZeroU32::get),
        };
        frame.encode_to_vec().into()
    }

    /// Parses an announcement.
    ///
    /// # Errors
    /// [`ClusterError`] that names the wrong field.
    pub fn decode(bytes: Bytes) -> Result<Announced, ClusterError> {
        let frame = AnnouncementFrame::decode(bytes).map_err(|_| ClusterError::Frame)?;
        let newest = if frame.newest == 0 { frame.version } else { frame.newest };
        let wrong = ClusterError::FrameVersion { found: frame.version };
        let versions = FrameVersions::new(frame.version, newest).ok_or(wrong)?;
        let field = |field| ClusterError::FrameField { field };
        let member: [u8; 16] = frame.member.as_ref().try_into().map_err(|_| field("member"))?;
        let (member, period, leaving) = (MemberId(member), read_period(frame.period_ms)?, frame.leaving != 0);
        if FrameVersions::OWN.common(versions).is_none() {
            return Ok(Announced::Foreign { versions, member, period, leaving });
        }
        if frame.threads == 0 {
            return Err(field("threads"));
        }
        let (objects, rest) = frame.objects.as_chunks::<32>();
        if !rest.is_empty() {
            return Err(field("objects"));
        }
        if frame.name.len() > Placed::MAX_NAME {
            return Err(field("name"));
        }
        let (name, max_regions) = (frame.name, NonZeroU32::new(frame.max_regions));
        let placed = NonZeroU32::new(frame.replicas).map(|replicas| Placed { name, replicas, max_regions });
        Ok(Announced::Known(Self {
            placed,
            versions,
            member,
            period,
            leaving,
            threads: frame.threads,
            load: Load { jobs: frame.jobs, free: frame.free },
            objects: objects.iter().map(|object| ObjectId::from_bytes(*object)).collect(),
        }))
    }
}

/// A period of announcements, in its bounds.
pub(crate) fn read_period(period_ms: u32) -> Result<Duration, ClusterError> {
    let period = Duration::from_millis(period_ms.into());
    let is_valid = (MIN_PERIOD..=MAX_PERIOD).contains(&period);
    is_valid.then_some(period).ok_or(ClusterError::FrameField { field: "period_ms" })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame_version::VERSION;

    fn announcement() -> Announcement {
        Announcement {
            versions: FrameVersions::OWN,
            member: MemberId::from_bytes([7; 16]),
            period: Duration::from_millis(500),
            leaving: false,
            threads: 2,
            load: Load { jobs: 3, free: 29 },
            objects: [ObjectId::of(b"a region"), ObjectId::of(b"an index")].into(),
            placed: None,
        }
    }

    #[test]
    fn announcements_round_trip() {
        for leaving in [false, true] {
            for objects in [BTreeSet::new(), announcement().objects] {
                let (name, replicas) = ("host-1:8082".to_owned(), NonZeroU32::MIN.saturating_add(1));
                let max_regions = leaving.then_some(replicas);
                let placed = (!objects.is_empty()).then_some(Placed { name, replicas, max_regions });
                let sent = Announcement { leaving, objects, placed, ..announcement() };
                let read = Announcement::decode(sent.encode()).expect("read");
                assert_eq!(read, Announced::Known(sent));
            }
        }
    }

    /// This release, the one before it, the next one and the one after that.
    #[test]
    fn announcements_of_other_versions_are_read_or_noticed() {
        for (oldest, newest, is_known) in [
            (VERSION, VERSION + 1, true),
            (VERSION - 1, VERSION, true),
            (VERSION + 1, VERSION + 2, false),
            (VERSION - 1, VERSION - 1, false),
        ] {
            let versions = FrameVersions::new(oldest, newest).expect("a range");
            let sent = Announcement { versions, ..announcement() };
            let read = Announcement::decode(sent.encode()).expect("read");
            let (member, period, leaving) = (sent.member, sent.period, sent.leaving);
            let foreign = Announced::Foreign { versions, member, period, leaving };
            assert_eq!(read, if is_known { Announced::Known(sent) } else { foreign }, "{versions}");
        }
    }

    #[test]
    fn invalid_announcements_name_the_field() {
        let read = |change: &dyn Fn(&mut AnnouncementFrame)| {
            let mut frame = AnnouncementFrame::decode(announcement().encode()).expect("a frame");
            change(&mut frame);
            Announcement::decode(frame.encode_to_vec().into()).expect_err("refused").to_string()
        };
        let field = |field| ClusterError::FrameField { field }.to_string();
        assert_eq!(read(&|f| f.version = 0), ClusterError::FrameVersion { found: 0 }.to_string());
        assert_eq!(read(&|f| f.newest = 1), ClusterError::FrameVersion { found: VERSION }.to_string());
        assert_eq!(read(&|f| f.member = Bytes::from_static(b"short")), field("member"));
        assert_eq!(read(&|f| f.period_ms = 0), field("period_ms"));
        assert_eq!(read(&|f| f.period_ms = u32::MAX), field("period_ms"));
        assert_eq!(read(&|f| f.threads = 0), field("threads"));
        assert_eq!(read(&|f| f.name = "x".repeat(129)), field("name"));
        assert_eq!(read(&|f| f.objects = f.objects.slice(1..)), field("objects"));
        assert!(matches!(
            Announcement::decode(Bytes::from_static(b"\xff\xff garbage")),
            Err(ClusterError::Frame)
        ));
    }
}
