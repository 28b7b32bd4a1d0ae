//! State shared by all requests: maps, tokens, pool, connections, metrics; and the readiness of the service.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, Instant};

use crate::auth::tokens::Callers;
use crate::auth::tokens_file::TokensFile;
use crate::error::ServerError;
use crate::http::Tls;
use crate::http::problem;
use crate::maps::{MapReadOptions, Maps};
use crate::options::ServerOptions;
use crate::queue::LogThrottle;
use crate::queue::pool::Pool;
use crate::queue::rates::RatePolicy;
use crate::queue::{ConnectionLimits, Connections};
use crate::telemetry::{GaugeValues, Metrics, MetricsOptions, RequestIds, Traces};

/// The service without its listeners.
pub(crate) struct App {
    pub(crate) options: ServerOptions,
    pub(crate) maps: Maps,
    pub(crate) pool: Pool,
    pub(crate) metrics: Metrics,
    pub(crate) traces: Option<Traces>,
    /// Source of request ids.
    pub(crate) ids: RequestIds,
    pub(crate) tls: Option<Tls>,
    pub(crate) tokens: Option<TokensFile>,
    pub(crate) connections: Arc<Connections>,
    /// Limits log lines that unauthenticated clients can cause.
    pub(crate) log_throttle: LogThrottle,
    callers: RwLock<Arc<Callers>>,
    closing: AtomicBool,
    /// Requests answered since the stop request.
    answered_since: AtomicU64,
}

/// Whether queries are accepted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Readiness {
    /// Accepted, for all maps except these.
    Ready { broken: Vec<String> },
    /// Not accepted, with the reason.
    Not(&'static str),
}

impl App {
    /// Opens all files. Invalid credentials are an error. A map that cannot be opened is an error only if no other
    /// map is left, no maps folder is configured, and there is no remote map.
    pub(crate) fn open(options: ServerOptions) -> Result<Self, ServerError> {
        options.check()?;
        let rates = RatePolicy { rate: options.rate, clock: options.clock.clone() };
        let (tokens, callers) = match &options.tokens {
            Some(path) => {
                let (file, callers) = TokensFile::open(path, rates, options.tokens_max_stale)?;
                (Some(file), callers)
            }
            None => (None, Arc::new(Callers::unrestricted(&rates))),
        };
        let tls = options.tls.clone().map(Tls::open).transpose()?;
        let pool = Pool::start(options.threads, options.queue, options.clock.clone())
            .map_err(|source| ServerError::System { what: "threads", source })?;
        let mut metrics = metrics(&options);
        let traces = start_traces(&options, &mut metrics)?;
        let ids = RequestIds::start().map_err(|source| ServerError::System { what: "randomness", source })?;
        let app = Self {
            metrics,
            ids,
            traces,
            connections: Connections::new(limits(&options)),
            log_throttle: LogThrottle::default(),
            maps: Maps::new(
                &options.maps,
                &options.remote_maps,
                options.maps_folder.clone(),
                MapReadOptions {
                    memory: options.map_memory,
                    // Not needed without a page.
                    page_points: options.page.as_ref().map_or(0, |_| options.page_points),
                    packs: options.packs,
                },
                &options.geo_references,
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
        self.maps.scan_folder()?;
        let mut broken = Vec::new();
        for slot in self.maps.slots() {
            self.metrics.register_map(slot.name());
            match slot.reload(true, Instant::now()) {
                None | Some(Ok(_)) => {}
                Some(Err(source)) => {
                    self.metrics.reload_failing("map", slot.name(), true);
                    broken.push(ServerError::Map { name: slot.name().to_owned(), source });
                }
            }
        }
        let may_come =
            self.maps.has_folder() || !self.options.remote_maps.is_empty() || self.options.regions.is_some();
        if !may_come && self.maps.slots().iter().all(|slot| slot.current().is_none()) {
            // `check` guarantees at least one map.
            return Err(broken.into_iter().next().unwrap_or(ServerError::NoMap));
        }
        for error in broken {
            tracing::error!(%error, "this map is not served until its file can be opened");
        }
        Ok(())
    }

    /// The tokens that are valid now.
    pub(crate) fn callers(&self) -> Arc<Callers> {
        self.callers.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(crate) fn set_callers(&self, callers: Arc<Callers>) {
        *self.callers.write().unwrap_or_else(PoisonError::into_inner) = callers;
    }

    /// Whether queries are accepted.
    pub(crate) fn readiness(&self) -> Readiness {
        if self.is_closing() {
            return Readiness::Not("stopping");
        }
        if self.callers().is_closed() {
            return Readiness::Not("no valid file of tokens");
        }
        let slots = self.maps.slots();
        let broken: Vec<String> =
            slots.iter().filter(|slot| !slot.is_complete()).map(|slot| slot.name().to_owned()).collect();
        let serves_regions = slots.is_empty() && self.options.regions.is_some();
        if serves_regions || broken.len() < slots.len() {
            Readiness::Ready { broken }
        } else if slots.iter().any(|slot| slot.current().is_some()) {
            Readiness::Not("no worker answers")
        } else {
            Readiness::Not("no map")
        }
    }

    /// The metrics in the text format of Prometheus.
    pub(crate) fn metrics_text(&self) -> String {
        self.metrics.text(&GaugeValues {
            queued: self.pool.queued(),
            busy: self.pool.busy(),
            connections: self.connections.open(),
            ready: matches!(self.readiness(), Readiness::Ready { .. }),
        })
    }

    /// Waits until the last traces are sent, at most `timeout`.
    pub(crate) fn flush_traces(&self, timeout: Duration) {
        if let Some(traces) = &self.traces {
            traces.flush(timeout);
        }
    }

    /// Counts an answered request during shutdown.
    pub(crate) fn answered(&self) {
        if self.is_closing() {
            self.answered_since.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Requests answered since [`Self::close`].
    pub(crate) fn answered_since_closing(&self) -> u64 {
        self.answered_since.load(Ordering::Relaxed)
    }

    /// Begins the shutdown.
    pub(crate) fn close(&self) {
        self.closing.store(true, Ordering::Relaxed);
    }

    /// Whether traces are sent to a collector.
    pub(crate) const fn sends_traces(&self) -> bool {
        self.traces.is_some()
    }

    /// Whether the shutdown has begun.
    pub(crate) fn is_closing(&self) -> bool {
        self.closing.load(Ordering::Relaxed)
    }
}

/// All metrics, at zero.
fn metrics(options: &ServerOptions) -> Metrics {
    Metrics::new(&MetricsOptions {
        workers: options.threads.get(),
        queue: options.queue.get(),
        connections: options.connections.get(),
        version: env!("CARGO_PKG_VERSION"),
        log: options.log.as_ref(),
        gateway: options.gateway.as_ref(),
        regions: options.regions.as_ref().map(|regions| &regions.counts),
        requests: &problem::query_outcomes(),
    })
}

fn start_traces(options: &ServerOptions, metrics: &mut Metrics) -> Result<Option<Traces>, ServerError> {
    let start = |url: &String| Traces::start(url, "veiloc", env!("CARGO_PKG_VERSION"));
    let traces = options.otlp.as_ref().map(start).transpose();
    let traces = traces.map_err(|source| ServerError::Collector { source })?;
    if let Some(traces) = &traces {
        metrics.count_spans_of(traces);
    }
    Ok(traces)
}

/// Without tokens no client can authenticate, so no connection is reserved.
fn limits(options: &ServerOptions) -> ConnectionLimits {
    let total = options.connections.get();
    let reserved = match options.tokens {
        Some(_) => options.reserved_connections.unwrap_or(total / 2),
        None => 0,
    };
    ConnectionLimits { total, per_address: options.connections_per_address.get(), reserved }
}
