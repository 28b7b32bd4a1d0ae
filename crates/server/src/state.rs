//! What all requests share: maps, callers, the pool, metrics; and reading their files again.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, PoisonError, RwLock};

use crate::connections::Connections;
use crate::error::ServerError;
use crate::maps::{Maps, Stamp};
use crate::metrics::Metrics;
use crate::options::ServerOptions;
use crate::pool::Pool;
use crate::throttle::Throttle;
use crate::tls::Tls;
use crate::tokens::Callers;

/// The service without its connections.
pub(crate) struct App {
    pub(crate) options: ServerOptions,
    pub(crate) maps: Maps,
    pub(crate) pool: Pool,
    pub(crate) metrics: Metrics,
    pub(crate) tls: Option<Tls>,
    pub(crate) connections: Arc<Connections>,
    /// Log lines that anybody can cause.
    pub(crate) quiet: Throttle,
    callers: RwLock<Arc<Callers>>,
    tokens_seen: RwLock<Option<Stamp>>,
    closing: AtomicBool,
}

impl App {
    /// Opens all files; any that cannot be used is an error.
    pub(crate) fn open(options: ServerOptions) -> Result<Self, ServerError> {
        options.check()?;
        let maps = Maps::open(&options.maps)?;
        let tokens_seen = options.tokens.as_deref().and_then(Stamp::of);
        let callers = match &options.tokens {
            Some(path) => Callers::read(path, options.rate, None)?,
            None => Callers::anyone(options.rate),
        };
        let tls = options.tls.clone().map(Tls::open).transpose()?;
        let pool = Pool::start(options.workers, options.queue)
            .map_err(|source| ServerError::System { what: "threads", source })?;
        Ok(Self {
            metrics: Metrics::new(options.workers.get(), options.queue.get(), options.log.as_ref()),
            connections: Connections::new(options.limits()),
            quiet: Throttle::default(),
            maps,
            pool,
            tls,
            callers: RwLock::new(Arc::new(callers)),
            tokens_seen: RwLock::new(tokens_seen),
            closing: AtomicBool::new(false),
            options,
        })
    }

    /// Who may ask, as of now.
    pub(crate) fn callers(&self) -> Arc<Callers> {
        self.callers.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// No new connections are taken any more.
    pub(crate) fn close(&self) {
        self.closing.store(true, Ordering::Relaxed);
    }

    /// Whether the service is about to end.
    pub(crate) fn is_closing(&self) -> bool {
        self.closing.load(Ordering::Relaxed)
    }

    /// Reads files again: all of them, or those that were replaced since they were last read. What cannot be read is
    /// refused with a line in the log, and what was there before stays.
    pub(crate) fn reload(&self, all: bool) {
        for slot in self.maps.slots().iter().filter(|slot| all || slot.is_stale()) {
            let result = slot.reload();
            self.metrics.reload("map", slot.name(), result.is_ok());
            match result {
                Ok(()) => {
                    let map = &slot.current().map;
                    let (images, points) = (map.image_count(), map.point_count());
                    tracing::info!(map = slot.name(), images, points, "map replaced");
                }
                Err(error) => tracing::error!(map = slot.name(), %error, "map refused, the old one stays"),
            }
        }
        if let Some(path) = self.options.tokens.as_deref().filter(|path| all || self.tokens_are_stale(path)) {
            self.reload_tokens(path);
        }
        if let Some(tls) = self.tls.as_ref().filter(|tls| all || tls.is_stale()) {
            let result = tls.reload();
            self.metrics.reload("certificate", "", result.is_ok());
            match result {
                Ok(()) => tracing::info!("certificate replaced"),
                Err(error) => tracing::error!(%error, "certificate refused, the old one stays"),
            }
        }
    }

    fn tokens_are_stale(&self, path: &Path) -> bool {
        let stamp = Stamp::of(path);
        stamp.is_some() && stamp != *self.tokens_seen.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn reload_tokens(&self, path: &Path) {
        *self.tokens_seen.write().unwrap_or_else(PoisonError::into_inner) = Stamp::of(path);
        let read = Callers::read(path, self.options.rate, Some(&self.callers()));
        self.metrics.reload("tokens", "", read.is_ok());
        match read {
            Ok(callers) => {
                *self.callers.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(callers);
                tracing::info!("tokens replaced");
            }
            Err(error) => tracing::error!(%error, "tokens refused, the old ones stay"),
        }
    }
}
