//! Data about a request in progress: token, map, and durations of stages. Filled by the handlers, read once when the
//! request is answered.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use crate::telemetry::request_id::{RequestId, SpanId};

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
    /// The trace that the request continues, and its span there.
    parent: OnceLock<(RequestId, SpanId)>,
    begun: Instant,
    begun_at: SystemTime,
    token: OnceLock<Arc<str>>,
    map: OnceLock<Arc<str>>,
    stages: Mutex<Vec<RequestStage>>,
    calls: Mutex<Vec<RemoteCall>>,
    /// Number of begun calls.
    begun_calls: AtomicU64,
}

/// A message to another machine on behalf of a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RemoteCall {
    /// Its span, which is the parent of the spans of the other machine.
    pub span: SpanId,
    /// Id of the other machine.
    pub machine: String,
    /// How it ended.
    pub outcome: &'static str,
    /// Start, from the beginning of the request.
    pub begun: Duration,
    /// Duration.
    pub took: Duration,
}

/// A call in progress; recorded in the context when it is dropped.
#[derive(Debug)]
pub struct OpenCall {
    context: Arc<RequestContext>,
    call: RemoteCall,
}

impl OpenCall {
    /// Its span.
    pub const fn span(&self) -> SpanId {
        self.call.span
    }

    /// Sets how it ended. Without this call, it was given up.
    pub const fn set_outcome(&mut self, outcome: &'static str) {
        self.call.outcome = outcome;
    }
}

impl Drop for OpenCall {
    fn drop(&mut self) {
        let mut call = self.call.clone();
        call.took = self.context.elapsed().saturating_sub(call.begun);
        self.context.calls.lock().unwrap_or_else(PoisonError::into_inner).push(call);
    }
}

/// `00-TRACE-SPAN-FLAGS`.
fn read_traceparent(text: &str) -> Option<(RequestId, SpanId)> {
    let mut words = text.split('-');
    let (version, trace, span) = (words.next()?, words.next()?, words.next()?);
    let mut id = [0; 16];
    hex::decode_to_slice(trace, &mut id).ok().filter(|()| version == "00" && id != [0; 16])?;
    let span = u64::from_str_radix(span, 16).ok().filter(|_| span.len() == 16)?;
    Some((RequestId::from_bytes(id), SpanId::from_number(span)?))
}

/// Number of the first span of a call; those of stages are lower.
const FIRST_CALL: u64 = 1 << 20;

impl RequestContext {
    /// For a request that begins now.
    pub fn begin(id: RequestId) -> Self {
        Self {
            id,
            parent: OnceLock::new(),
            begun: Instant::now(),
            begun_at: SystemTime::now(),
            token: OnceLock::new(),
            map: OnceLock::new(),
            stages: Mutex::default(),
            calls: Mutex::default(),
            begun_calls: AtomicU64::new(0),
        }
    }

    /// Begins a call of this machine.
    pub fn call(self: &Arc<Self>, machine: String) -> OpenCall {
        let number = self.begun_calls.fetch_add(1, Ordering::Relaxed);
        let span = self.id.span(FIRST_CALL + number);
        let (begun, took) = (self.elapsed(), Duration::ZERO);
        let call = RemoteCall { span, machine, outcome: "given-up", begun, took };
        OpenCall { context: self.clone(), call }
    }

    /// All calls that have ended.
    pub fn calls(&self) -> Vec<RemoteCall> {
        self.calls.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Request id: that of the trace that it continues, if it does.
    pub fn id(&self) -> RequestId {
        self.parent.get().map_or(self.id, |(id, _)| *id)
    }

    /// Continues the trace of a gateway, whose `traceparent` (W3C Trace Context) this is. Any other text is ignored.
    pub fn continue_trace(&self, traceparent: &str) {
        if let Some(parent) = read_traceparent(traceparent) {
            let _ = self.parent.set(parent);
        }
    }

    /// The span of the gateway, if the request continues its trace.
    pub(crate) fn parent(&self) -> Option<SpanId> {
        self.parent.get().map(|(_, span)| *span)
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
