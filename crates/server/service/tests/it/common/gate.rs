//! Holds localizations, each on its thread, until the test admits them.
#![allow(dead_code, unreachable_pub)] // each user takes its own part

use std::sync::{Arc, Condvar, Mutex};

use veiloc_service::ServerOptions;

use super::eventually;

pub struct Gate {
    permits: Mutex<usize>,
    changed: Condvar,
}

impl Gate {
    /// Holds every localization of these options.
    pub fn install(options: &mut ServerOptions) -> Arc<Self> {
        let gate = Arc::new(Self { permits: Mutex::new(0), changed: Condvar::new() });
        let passed = gate.clone();
        options.gate = Some(veiloc_service::Gate::new(move || {
            let permits = passed.permits.lock().expect("whole");
            *passed.changed.wait_while(permits, |permits| *permits == 0).expect("whole") -= 1;
        }));
        gate
    }

    /// Admits this many localizations, waiting and future ones.
    pub fn admit(&self, count: usize) {
        *self.permits.lock().expect("whole") += count;
        self.changed.notify_all();
    }

    /// Admits all from now on.
    pub fn open(&self) {
        self.admit(usize::MAX / 2);
    }
}

/// Waits until this many workers are busy and this many queries are queued.
pub fn wait_until_load(server: &super::Running, busy: u32, queued: u32) {
    eventually("the expected load", || {
        let is = |series: &str, count: u32| server.metric(series) == Some(f64::from(count));
        is("veiloc_workers_busy", busy) && is("veiloc_queue_length", queued)
    });
}
