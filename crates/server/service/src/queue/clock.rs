//! The clock of rate limits and of the estimates of the pool: the clock of the system, or a manual clock in tests.
//!
//! Timeouts of connections and requests are tokio timers and follow the clock of tokio.

use std::fmt;
use std::sync::Arc;
use std::time::Instant;

/// A monotonic clock. Clones share the same clock.
#[derive(Clone)]
pub struct Clock(Arc<dyn Fn() -> Instant + Send + Sync>);

impl Clock {
    /// A clock that returns `now()`; the value must never decrease.
    pub fn new(now: impl Fn() -> Instant + Send + Sync + 'static) -> Self {
        Self(Arc::new(now))
    }

    /// The current time.
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

/// Called on its thread before each localization, so that tests can hold it. Clones share it.
#[derive(Clone)]
pub struct Gate(Arc<dyn Fn() + Send + Sync>);

impl Gate {
    /// A gate through which a localization has passed when `pass()` returns.
    pub fn new(pass: impl Fn() + Send + Sync + 'static) -> Self {
        Self(Arc::new(pass))
    }

    pub(crate) fn pass(&self) {
        (self.0)();
    }
}

impl fmt::Debug for Gate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Gate")
    }
}

/// A clock that changes only when [`Self::advance`] is called.
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
