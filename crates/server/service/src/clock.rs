//! The clock that allowances and the pool's estimates are read from: the system's, or one that a test turns by hand.
//!
//! Limits of connections and requests are timers of tokio and go by tokio's clock.

use std::fmt;
use std::sync::Arc;
use std::time::Instant;

/// Tells the time. Clones are the same clock.
#[derive(Clone)]
pub struct Clock(Arc<dyn Fn() -> Instant + Send + Sync>);

impl Clock {
    /// A clock that shows what `now` says; it must never go back.
    pub fn new(now: impl Fn() -> Instant + Send + Sync + 'static) -> Self {
        Self(Arc::new(now))
    }

    /// What it shows.
    pub fn now(&self) -> Instant {
        (self.0)()
    }
}

/// The system's monotonic clock.
impl Default for Clock {
    fn default() -> Self {
        Self::new(Instant::now)
    }
}

impl fmt::Debug for Clock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Clock")
    }
}

/// For rate limiters.
impl governor::clock::Clock for Clock {
    type Instant = Instant;

    fn now(&self) -> Instant {
        Self::now(self)
    }
}

/// A clock that stands still until it is advanced.
#[cfg(test)]
#[derive(Clone)]
pub(crate) struct ManualClock(Arc<std::sync::Mutex<Instant>>);

#[cfg(test)]
impl ManualClock {
    pub(crate) fn new() -> Self {
        Self(Arc::new(std::sync::Mutex::new(Instant::now())))
    }

    pub(crate) fn clock(&self) -> Clock {
        let shown = self.0.clone();
        Clock::new(move || *shown.lock().expect("not poisoned"))
    }

    pub(crate) fn advance(&self, time: std::time::Duration) {
        *self.0.lock().expect("not poisoned") += time;
    }
}
