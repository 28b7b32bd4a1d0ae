//! Traces: what became of each request and what took how long, sent to a collector of the operator's as OTLP over HTTP.
//!
//! Spans are made of a [`Trail`] when its request is answered, and of nothing else, so they cannot hold more than that
//! has fields for (rule L8). They wait in a queue of fixed length and are sent by a thread of their own: a collector that is
//! slow or gone holds up no request, what does not fit or cannot be sent is counted
//! (`veiloc_spans_dropped_total`) and not tried again.
//!
//! The id of a trace is the name of its request. One that a client brings (`traceparent`) is not taken over: it would let
//! whoever reads the traces put requests together, and with what the client did elsewhere.
//!
//! Written here, and not by the crates of OpenTelemetry, because theirs carry all events of all libraries to the collector
//! unless they are kept from it, and a dozen dependencies; what is sent here is one document of JSON (`otlp.rs`).

mod otlp;

use std::fmt;
use std::io;
use std::num::NonZeroUsize;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use prometheus_client::metrics::counter::Counter;
use ureq::Agent;

use crate::telemetry::trail::{RequestKind, Trail};
use crate::telemetry::waiting::{Sender, Waiting, queue};
use otlp::{Trace, document};

/// Traces that may wait to be sent: some ten seconds of a busy service.
const WAITING: NonZeroUsize = NonZeroUsize::MIN.saturating_add(2047);

/// Most traces of one message to the collector.
const BATCH: usize = 256;

/// How long the first trace of a message waits for others.
const GATHER: Duration = Duration::from_secs(1);

/// How long the collector may take for a message.
const PATIENCE: Duration = Duration::from_secs(5);

/// Where traces are handed over.
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
    /// Starts the thread that sends to the collector at `url`: its address, to which `/v1/traces` is added.
    ///
    /// # Errors
    /// An address that is none of HTTP, and the system's when there is no thread to be had.
    pub fn start(url: &str, version: &'static str) -> io::Result<Self> {
        let base = url.trim_end_matches('/');
        if !["http://", "https://"].iter().any(|scheme| base.len() > scheme.len() && base.starts_with(scheme))
        {
            return Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                "the collector's address begins with http:// or https://, like http://127.0.0.1:4318",
            ));
        }
        let url = format!("{}/v1/traces", base.strip_suffix("/v1/traces").unwrap_or(base));
        // A proxy of the environment is meant for other roads than that to the operator's own collector.
        let agent = Agent::config_builder().timeout_global(Some(PATIENCE)).proxy(None).build().into();
        let (sender, receiver) = queue(WAITING);
        let dropped = Counter::default();
        let exporter = Exporter { agent, url, version, dropped: dropped.clone(), failing: false };
        std::thread::Builder::new().name("traces".to_owned()).spawn(move || exporter.run(&receiver))?;
        Ok(Self { sender, dropped })
    }

    /// Hands over the trace of a request that was answered. Never blocks.
    pub fn request(&self, trail: &Trail, method: &'static str, kind: &RequestKind<'_>) {
        let trace = Trace::of(trail, method, kind);
        let spans = trace.spans();
        if !self.sender.hand_over(Box::new(trace)) {
            self.dropped.inc_by(spans);
        }
    }

    /// Waits until everything handed over so far is sent or given up, no longer than `patience`. Whether it was.
    pub fn flush(&self, patience: Duration) -> bool {
        self.sender.flush(patience)
    }

    /// Spans that were not sent, as the metrics show it.
    pub(crate) fn dropped_counter(&self) -> Counter {
        self.dropped.clone()
    }
}

struct Exporter {
    agent: Agent,
    url: String,
    version: &'static str,
    dropped: Counter,
    /// Whether the last message was not taken, which is told once.
    failing: bool,
}

impl Exporter {
    fn run(mut self, messages: &Receiver<Waiting<Box<Trace>>>) {
        let mut batch = Vec::new();
        let mut since = Instant::now();
        loop {
            let wait = if batch.is_empty() { GATHER } else { GATHER.saturating_sub(since.elapsed()) };
            match messages.recv_timeout(wait) {
                Ok(Waiting::Item(trace)) => {
                    if batch.is_empty() {
                        since = Instant::now();
                    }
                    batch.push(*trace);
                    if batch.len() == BATCH {
                        self.send(&mut batch);
                    }
                }
                Ok(Waiting::Flush(flushed)) => {
                    self.send(&mut batch);
                    flushed.tell();
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
        let body = serde_json::to_vec(&document(batch, self.version)).unwrap_or_default();
        let sent = self.agent.post(&self.url).header("content-type", "application/json").send(&body[..]);
        if sent.is_err() {
            self.dropped.inc_by(batch.iter().map(Trace::spans).sum());
        }
        match (sent, self.failing) {
            (Err(error), false) => {
                tracing::warn!(%error, "the collector does not take traces; they are dropped until it does");
                self.failing = true;
            }
            (Ok(_), true) => {
                tracing::info!("the collector takes traces again");
                self.failing = false;
            }
            _ => {}
        }
        batch.clear();
    }
}
