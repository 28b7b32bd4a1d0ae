//! What all requests share: maps, callers, the pool, connections, metrics; and whether the service is ready.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::Instant;

use crate::error::ServerError;
use crate::maps::Maps;
use crate::metrics::Metrics;
use crate::options::ServerOptions;
use crate::pool::Pool;
use crate::tls::Tls;
use crate::tokens::Callers;
use crate::tokens_file::TokensFile;
use veiloc_admission::Throttle;
use veiloc_admission::{Connections, Limits};

/// The service without its connections.
pub(crate) struct App {
    pub(crate) options: ServerOptions,
    pub(crate) maps: Maps,
    pub(crate) pool: Pool,
    pub(crate) metrics: Metrics,
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
    /// Opens all files. Credentials that cannot be used are an error; of maps, when there is none left to serve and no
    /// folder that one could come into.
    pub(crate) fn open(options: ServerOptions) -> Result<Self, ServerError> {
        options.check()?;
        let (tokens, callers) = match &options.tokens {
            Some(path) => {
                let (file, callers) = TokensFile::open(path, options.rate, options.stale_tokens)?;
                (Some(file), callers)
            }
            None => (None, Arc::new(Callers::anyone(options.rate))),
        };
        let tls = options.tls.clone().map(Tls::open).transpose()?;
        let pool = Pool::start(options.workers, options.queue)
            .map_err(|source| ServerError::System { what: "threads", source })?;
        let app = Self {
            metrics: Metrics::new(options.workers.get(), options.queue.get(), options.log.as_ref()),
            connections: Connections::new(limits(&options)),
            quiet: Throttle::default(),
            maps: Maps::new(&options.maps, options.maps_folder.clone(), options.map_memory),
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
            if let Some(Err(source)) = slot.reload(true, Instant::now()) {
                self.metrics.reload_failing("map", slot.name(), true);
                broken.push(ServerError::Map { name: slot.name().to_owned(), source });
            }
        }
        if !self.maps.has_folder() && self.maps.slots().iter().all(|slot| slot.current().is_none()) {
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

/// Without tokens there is nobody to reserve anything for.
fn limits(options: &ServerOptions) -> Limits {
    let total = options.connections.get();
    let reserved = match options.tokens {
        Some(_) => options.reserved_connections.unwrap_or(total / 2),
        None => 0,
    };
    Limits { total, per_address: options.connections_per_address.get(), reserved }
}
