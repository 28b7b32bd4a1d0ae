//! Traces: one span per request, per stage and per request to a worker, sent to a collector of the operator as OTLP over
//! HTTP.
//!
//! Spans are built only from a [`RequestContext`] when its request is answered, so they cannot contain more than its
//! fields (rule L8). They wait in a queue of bounded length, and a dedicated thread sends them: a slow or absent
//! collector delays no request. Spans that do not fit or cannot be sent are counted (`veiloc_spans_dropped_total`)
//! and not retried.
//!
//! The trace id is the request id. A `traceparent` is used only from a gateway, whose trace a worker continues: that
//! of a client would let a reader of the traces link requests, also with other activity of the client.
//!
//! This is our own code, because the OpenTelemetry crates export all events of all libraries unless they are
//! filtered, and bring a dozen dependencies. The output is a single JSON document (`otlp.rs`).

mod otlp;

use std::fmt;
use std::io;
use std::num::NonZeroUsize;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use prometheus_client::metrics::counter::Counter;
use ureq::Agent;

use crate::telemetry::background_queue::{QueueItem, Sender, queue};
use crate::telemetry::request_context::{RequestContext, RequestKind};
use otlp::{Trace, document};

/// Capacity of the queue: some ten seconds of a busy service.
const WAITING: NonZeroUsize = NonZeroUsize::MIN.saturating_add(2047);

/// Maximum number of traces per message.
const BATCH: usize = 256;

/// How long the first trace of a message waits for more.
const BATCH_DELAY: Duration = Duration::from_secs(1);

/// Time limit of one message.
const SEND_TIMEOUT: Duration = Duration::from_secs(5);

/// The queue of traces; clones share it.
#[derive(Clone)]
pub struct Traces {
    sender: Sender<Box<Trace>>,
    dropped: Counter,
}

impl fmt::Debug for Traces {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Traces").field("dropped", &self.dropped.get()).finish_non_exhaustive()
    }
}

impl Traces {
    /// Starts the thread that sends to the collector at `url`; `/v1/traces` is appended. `service` is the name of this program in
    /// the traces.
    ///
    /// # Errors
    /// The address is not an HTTP address, or the system refused a thread.
    pub fn start(url: &str, service: &'static str, version: &'static str) -> io::Result<Self> {
        let base = url.trim_end_matches('/');
        if !["http://", "https://"].iter().any(|scheme| base.len() > scheme.len() && base.starts_with(scheme))
        {
            return Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                "the address of the collector must begin with http:// or https://, for example http://127.0.0.1:4318",
            ));
        }
        let url = format!("{}/v1/traces", base.strip_suffix("/v1/traces").unwrap_or(base));
        // A proxy from the environment is not meant for the operator's own collector.
        let agent = Agent::config_builder().timeout_global(Some(SEND_TIMEOUT)).proxy(None).build().into();
        let (sender, receiver) = queue(WAITING);
        let dropped = Counter::default();
        let exporter = Exporter { agent, url, service, version, dropped: dropped.clone(), failing: false };
        std::thread::Builder::new().name("traces".to_owned()).spawn(move || exporter.run(&receiver))?;
        Ok(Self { sender, dropped })
    }

    /// Enqueues the trace of an answered request. Never blocks.
    pub fn request(&self, context: &RequestContext, method: &'static str, kind: &RequestKind<'_>) {
        let trace = Trace::of(context, method, kind);
        let count = trace.spans();
        if !self.sender.send(Box::new(trace)) {
            self.dropped.inc_by(count);
        }
    }

    /// Waits until all enqueued traces are sent or dropped, at most `timeout`. Returns whether they were.
    pub fn flush(&self, timeout: Duration) -> bool {
        self.sender.flush(timeout)
    }

    /// The counter of dropped spans for the metrics.
    pub(crate) fn dropped_counter(&self) -> Counter {
        self.dropped.clone()
    }
}

struct Exporter {
    agent: Agent,
    url: String,
    service: &'static str,
    version: &'static str,
    dropped: Counter,
    /// Whether the last message failed; this is logged once.
    failing: bool,
}

impl Exporter {
    fn run(mut self, messages: &Receiver<QueueItem<Box<Trace>>>) {
        let mut batch = Vec::new();
        let mut since = Instant::now();
        loop {
            let wait =
                if batch.is_empty() { BATCH_DELAY } else { BATCH_DELAY.saturating_sub(since.elapsed()) };
            match messages.recv_timeout(wait) {
                Ok(QueueItem::Item(trace)) => {
                    if batch.is_empty() {
                        since = Instant::now();
                    }
                    batch.push(*trace);
                    if batch.len() == BATCH {
                        self.send(&mut batch);
                    }
                }
                Ok(QueueItem::Flush(flushed)) => {
                    self.send(&mut batch);
                    flushed.notify();
                }
                Err(RecvTimeoutError::Timeout) => self.send(&mut batch),
                Err(RecvTimeoutError::Disconnected) => return self.send(&mut batch),
            }
        }
    }

    fn send(&mut self, batch: &mut Vec<Trace>) {
        if batch.is_empty() {
            return;
        }
        // Strings and numbers always serialize.
        let body = serde_json::to_vec(&document(batch, self.service, self.version)).unwrap_or_default();
        let sent = self.agent.post(&self.url).header("content-type", "application/json").send(&body[..]);
        if sent.is_err() {
            self.dropped.inc_by(batch.iter().map(Trace::spans).sum());
        }
        match (sent, self.failing) {
            (Err(error), false) => {
                tracing::warn!(%error, "the collector does not accept traces; they are dropped until it does");
                self.failing = true;
            }
            (Ok(_), true) => {
                tracing::info!("the collector accepts traces again");
                self.failing = false;
            }
            _ => {}
        }
        batch.clear();
    }
}
