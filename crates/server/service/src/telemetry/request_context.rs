//! Data about a request in progress: token, map, and durations of stages. Filled by the handlers, read once when the
//! request is answered.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use crate::telemetry::request_id::RequestId;

/// A stage of the work on a request.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RequestStage {
    /// `read`, `queue`, `localize`, or a part of `localize`: `retrieve`, `match`, `pose`.
    pub name: &'static str,
    /// The parent stage; `None`: the request.
    pub within: Option<&'static str>,
    /// Start, from the beginning of the request.
    pub begun: Duration,
    /// Duration.
    pub took: Duration,
}

/// Route and outcome of an answered request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RequestKind<'a> {
    /// Template of the route.
    pub route: &'a str,
    /// HTTP status.
    pub status: u16,
    /// Name of the problem, if any.
    pub problem: Option<&'static str>,
}

/// Data about one request. It has no field for any content of the query.
#[derive(Debug)]
pub struct RequestContext {
    id: RequestId,
    begun: Instant,
    begun_at: SystemTime,
    token: OnceLock<Arc<str>>,
    map: OnceLock<Arc<str>>,
    stages: Mutex<Vec<RequestStage>>,
}

impl RequestContext {
    /// For a request that begins now.
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

    /// Request id.
    pub const fn id(&self) -> RequestId {
        self.id
    }

    /// Time of its beginning.
    pub const fn begun_at(&self) -> SystemTime {
        self.begun_at
    }

    /// Time since its beginning.
    pub fn elapsed(&self) -> Duration {
        self.begun.elapsed()
    }

    /// Sets the name that the operator gave the token. Only the first call has an effect.
    pub fn set_token(&self, token: Arc<str>) {
        let _ = self.token.set(token);
    }

    /// Sets the map, which must be a served one. Only the first call has an effect.
    pub fn set_map(&self, map: Arc<str>) {
        let _ = self.map.set(map);
    }

    /// Name of the token, if known.
    pub fn token(&self) -> Option<&str> {
        self.token.get().map(AsRef::as_ref)
    }

    /// The map, if it is a served one.
    pub fn map(&self) -> Option<&str> {
        self.map.get().map(AsRef::as_ref)
    }

    /// Records a finished stage.
    pub fn stage(&self, stage: RequestStage) {
        self.stages.lock().unwrap_or_else(PoisonError::into_inner).push(stage);
    }

    /// All finished stages.
    pub fn stages(&self) -> Vec<RequestStage> {
        self.stages.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}
