//! What all requests share: maps, callers, the pool, connections, metrics; and whether the service is ready.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, Instant};

use crate::error::ServerError;
use crate::http::Tls;
use crate::maps::{Maps, Reading};
use crate::options::ServerOptions;
use crate::pool::Pool;
use crate::problem;
use crate::queue::Throttle;
use crate::queue::{Connections, Limits};
#[cfg(feature = "opentelemetry")]
use crate::telemetry::Traces;
use crate::telemetry::{Metrics, MetricsOptions, Now, RequestIds};
use crate::tokens::Callers;
use crate::tokens_file::TokensFile;

/// The service without its connections.
pub(crate) struct App {
    pub(crate) options: ServerOptions,
    pub(crate) maps: Maps,
    pub(crate) pool: Pool,
    pub(crate) metrics: Metrics,
    #[cfg(feature = "opentelemetry")]
    pub(crate) traces: Option<Traces>,
    /// Names of requests.
    pub(crate) ids: RequestIds,
    pub(crate) tls: Option<Tls>,
    pub(crate) tokens: Option<TokensFile>,
    pub(crate) connections: Arc<Connections>,
    /// Log lines that anybody can cause.
    pub(crate) quiet: Throttle,
    callers: RwLock<Arc<Callers>>,
    closing: AtomicBool,
    /// Requests answered since it was told to stop.
    answered_since: AtomicU64,
}

/// Whether queries are taken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Readiness {
    /// They are, for all maps but these.
    Ready { broken: Vec<String> },
    /// They are not, and why.
    Not(&'static str),
}

impl App {
    /// Opens all files. Credentials that cannot be used are an error; of maps, when there is none left to serve, no
    /// folder that one could come into, and nobody else who may hold one.
    pub(crate) fn open(options: ServerOptions) -> Result<Self, ServerError> {
        options.check()?;
        let (tokens, callers) = match &options.tokens {
            Some(path) => {
                let (file, callers) =
                    TokensFile::open(path, options.rate, &options.clock, options.stale_tokens)?;
                (Some(file), callers)
            }
            None => (None, Arc::new(Callers::anyone(options.rate, &options.clock))),
        };
        let tls = options.tls.clone().map(Tls::open).transpose()?;
        let pool = Pool::start(options.workers, options.queue, options.clock.clone())
            .map_err(|source| ServerError::System { what: "threads", source })?;
        #[cfg_attr(
            not(feature = "opentelemetry"),
            expect(unused_mut, reason = "traces have a count of their own")
        )]
        let mut metrics = metrics(&options);
        #[cfg(feature = "opentelemetry")]
        let traces = start_traces(&options, &mut metrics)?;
        let ids = RequestIds::start().map_err(|source| ServerError::System { what: "randomness", source })?;
        let app = Self {
            metrics,
            ids,
            #[cfg(feature = "opentelemetry")]
            traces,
            connections: Connections::new(limits(&options)),
            quiet: Throttle::default(),
            maps: Maps::new(
                &options.maps,
                &options.elsewhere,
                options.maps_folder.clone(),
                Reading {
                    memory: options.map_memory,
                    // Without a page nobody sees them.
                    page_points: options.page.as_ref().map_or(0, |_| options.page_points),
                },
            ),
            pool,
            tls,
            tokens,
            callers: RwLock::new(callers),
            closing: AtomicBool::new(false),
            answered_since: AtomicU64::new(0),
            options,
        };
        app.open_maps()?;
        Ok(app)
    }

    fn open_maps(&self) -> Result<(), ServerError> {
        self.maps.look_into_folder()?;
        let mut broken = Vec::new();
        for slot in self.maps.slots() {
            self.metrics.map_begins(slot.name());
            if let Some(Err(source)) = slot.reload(true, Instant::now()) {
                self.metrics.reload_failing("map", slot.name(), true);
                broken.push(ServerError::Map { name: slot.name().to_owned(), source });
            }
        }
        let may_come = self.maps.has_folder() || !self.options.elsewhere.is_empty();
        if !may_come && self.maps.slots().iter().all(|slot| slot.current().is_none()) {
            // There is at least one, or the options would have been refused.
            return Err(broken.into_iter().next().unwrap_or(ServerError::NoMap));
        }
        for error in broken {
            tracing::error!(%error, "this map is not served until its file can be opened");
        }
        Ok(())
    }

    /// Who may ask, as of now.
    pub(crate) fn callers(&self) -> Arc<Callers> {
        self.callers.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(crate) fn set_callers(&self, callers: Arc<Callers>) {
        *self.callers.write().unwrap_or_else(PoisonError::into_inner) = callers;
    }

    /// Whether queries are taken.
    pub(crate) fn readiness(&self) -> Readiness {
        if self.is_closing() {
            return Readiness::Not("stopping");
        }
        if self.callers().is_closed() {
            return Readiness::Not("no valid file of tokens");
        }
        let slots = self.maps.slots();
        let broken: Vec<String> =
            slots.iter().filter(|slot| slot.current().is_none()).map(|slot| slot.name().to_owned()).collect();
        if broken.len() == slots.len() { Readiness::Not("no map") } else { Readiness::Ready { broken } }
    }

    /// Counts and times, as they are now.
    pub(crate) fn metrics_text(&self) -> String {
        self.metrics.text(&Now {
            queued: self.pool.queued(),
            busy: self.pool.busy(),
            connections: self.connections.open(),
            ready: matches!(self.readiness(), Readiness::Ready { .. }),
        })
    }

    /// Waits for the last traces to be sent, no longer than that.
    #[cfg_attr(not(feature = "opentelemetry"), expect(clippy::unused_self, reason = "there are no traces"))]
    pub(crate) fn flush_traces(&self, patience: Duration) {
        #[cfg(feature = "opentelemetry")]
        if let Some(traces) = &self.traces {
            traces.flush(patience);
        }
        #[cfg(not(feature = "opentelemetry"))]
        let _ = patience;
    }

    /// A request was answered; counted once the service is about to end.
    pub(crate) fn answered(&self) {
        if self.is_closing() {
            self.answered_since.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Requests answered since [`Self::close`].
    pub(crate) fn answered_since_closing(&self) -> u64 {
        self.answered_since.load(Ordering::Relaxed)
    }

    /// It is about to end: new connections are taken for a little while only.
    pub(crate) fn close(&self) {
        self.closing.store(true, Ordering::Relaxed);
    }

    /// Whether the service is about to end.
    pub(crate) fn is_closing(&self) -> bool {
        self.closing.load(Ordering::Relaxed)
    }
}

/// What there is to count, at zero.
fn metrics(options: &ServerOptions) -> Metrics {
    Metrics::new(&MetricsOptions {
        workers: options.workers.get(),
        queue: options.queue.get(),
        connections: options.connections.get(),
        version: env!("CARGO_PKG_VERSION"),
        log: options.log.as_ref(),
        gateway: options.gateway.as_ref(),
        requests: &problem::kinds_of_queries(),
    })
}

#[cfg(feature = "opentelemetry")]
fn start_traces(options: &ServerOptions, metrics: &mut Metrics) -> Result<Option<Traces>, ServerError> {
    let start = |url: &String| Traces::start(url, env!("CARGO_PKG_VERSION"));
    let traces = options.otlp.as_ref().map(start).transpose();
    let traces = traces.map_err(|source| ServerError::Collector { source })?;
    if let Some(traces) = &traces {
        metrics.count_spans_of(traces);
    }
    Ok(traces)
}

/// Without tokens there is nobody to reserve anything for.
fn limits(options: &ServerOptions) -> Limits {
    let total = options.connections.get();
    let reserved = match options.tokens {
        Some(_) => options.reserved_connections.unwrap_or(total / 2),
        None => 0,
    };
    Limits { total, per_address: options.connections_per_address.get(), reserved }
}
