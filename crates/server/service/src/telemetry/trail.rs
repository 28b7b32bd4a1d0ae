//! What is known of a request on its way: who asks, for which map, and what took how long. Filled by whoever learns it,
//! read once, when the request is answered.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use crate::telemetry::request_id::RequestId;

/// A part of the work on a request.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stage {
    /// `read`, `queue`, `localize`, or a part of the last: `retrieve`, `match`, `pose`.
    pub name: &'static str,
    /// The stage that it is a part of; of the whole request when there is none.
    pub within: Option<&'static str>,
    /// From the beginning of the request.
    pub begun: Duration,
    /// How long it took.
    pub took: Duration,
}

/// What kind of request was answered, and how.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RequestKind<'a> {
    /// The route's template.
    pub route: &'a str,
    /// The status of the answer.
    pub status: u16,
    /// The name of the problem, if it was one.
    pub problem: Option<&'static str>,
}

/// What is known of one request. It has no field for anything of its content.
#[derive(Debug)]
pub struct Trail {
    id: RequestId,
    begun: Instant,
    begun_at: SystemTime,
    token: OnceLock<Arc<str>>,
    map: OnceLock<Arc<str>>,
    stages: Mutex<Vec<Stage>>,
}

impl Trail {
    /// Of a request that begins now.
    pub fn begin(id: RequestId) -> Self {
        Self {
            id,
            begun: Instant::now(),
            begun_at: SystemTime::now(),
            token: OnceLock::new(),
            map: OnceLock::new(),
            stages: Mutex::default(),
        }
    }

    /// Its name.
    pub const fn id(&self) -> RequestId {
        self.id
    }

    /// When it began.
    pub const fn begun_at(&self) -> SystemTime {
        self.begun_at
    }

    /// How long ago that is.
    pub fn elapsed(&self) -> Duration {
        self.begun.elapsed()
    }

    /// Who asks: the name that the operator gave the token. The first that is said holds.
    pub fn asked_by(&self, token: Arc<str>) {
        let _ = self.token.set(token);
    }

    /// Which map it is about, one that is served. The first that is said holds.
    pub fn about(&self, map: Arc<str>) {
        let _ = self.map.set(map);
    }

    /// The name of the token it brought, when that is known.
    pub fn token(&self) -> Option<&str> {
        self.token.get().map(AsRef::as_ref)
    }

    /// The map, when it is one that is served.
    pub fn map(&self) -> Option<&str> {
        self.map.get().map(AsRef::as_ref)
    }

    /// A stage that ended.
    pub fn stage(&self, stage: Stage) {
        self.stages.lock().unwrap_or_else(PoisonError::into_inner).push(stage);
    }

    /// All stages that ended so far.
    pub fn stages(&self) -> Vec<Stage> {
        self.stages.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}
