//! Long calls: they release the interpreter's lock, end on Ctrl-C, and report their progress.
//!
//! The work runs on a second thread while the caller's thread waits, because Python handles signals on its main thread
//! only.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use pyo3::prelude::*;
use veiloc_features::Progress;
use veiloc_pose::Stop;

use crate::errors::{BindingError, Result};
use crate::worker_threads::run_on_worker;

/// Interval at which a waiting call checks for Ctrl-C.
const SIGNAL_POLL: Duration = Duration::from_millis(50);
/// Least time between two calls of a progress callback.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(100);

/// Payload that unwinds stopped work out of a progress report. It is no panic, so no message is printed.
struct Stopped;

/// Runs the work, and sets `stop` when Ctrl-C is pressed.
///
/// # Errors
/// `KeyboardInterrupt`, or the exception of another signal handler.
pub(crate) fn interruptible<T: Send>(
    py: Python<'_>,
    stop: &Stop,
    work: impl FnOnce() -> T + Send,
) -> Result<T> {
    let done = py.detach(|| {
        std::thread::scope(|scope| {
            let (send, receive) = channel();
            scope.spawn(move || send.send(catch_unwind(AssertUnwindSafe(work))));
            wait(receive, stop)
        })
    });
    outcome(done)
}

/// As [`interruptible`], for short work: it borrows nothing, so it can run on a pool thread that is already started.
///
/// # Errors
/// As [`interruptible`].
pub(crate) fn interruptible_on_worker<T: Send + 'static>(
    py: Python<'_>,
    stop: &Stop,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T> {
    let (send, receive) = channel();
    let work = AssertUnwindSafe(work);
    run_on_worker(move || {
        // The receiver below waits for this result.
        let _ = send.send(catch_unwind(work));
    });
    outcome(py.detach(move || wait(receive, stop)))
}

type Done<T> = std::thread::Result<T>;

/// Waits for the work to end and checks for Ctrl-C meanwhile; returns a signal handler's exception and the result.
fn wait<T>(receive: Receiver<Done<T>>, stop: &Stop) -> (Option<PyErr>, Done<T>) {
    let mut interrupt = None;
    loop {
        match receive.recv_timeout(SIGNAL_POLL) {
            Ok(done) => return (interrupt, done),
            Err(RecvTimeoutError::Disconnected) => {
                return (interrupt, Err(Box::new("the worker thread ended")));
            }
            Err(RecvTimeoutError::Timeout) => {
                if interrupt.is_none()
                    && let Err(raised) = Python::attach(|py| py.check_signals())
                {
                    stop.set();
                    interrupt = Some(raised);
                }
            }
        }
    }
}

fn outcome<T>(done: (Option<PyErr>, Done<T>)) -> Result<T> {
    match done {
        (Some(raised), _) => Err(raised.into()),
        (None, Ok(value)) => Ok(value),
        (None, Err(payload)) => Err(ended(payload)),
    }
}

/// Runs work that cannot be stopped, such as a request to a service; Ctrl-C returns to the caller and leaves it
/// running.
///
/// # Errors
/// As [`interruptible`].
pub(crate) fn abandonable<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T> {
    let (send, receive) = channel();
    let worker = std::thread::spawn(move || {
        // After Ctrl-C the receiver is gone, and the result is dropped.
        let _ = send.send(work());
    });
    py.detach(move || {
        loop {
            match receive.recv_timeout(SIGNAL_POLL) {
                Ok(value) => return Ok(value),
                Err(RecvTimeoutError::Timeout) => Python::attach(|py| py.check_signals())?,
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(worker.join().map_or_else(ended, |()| BindingError::interrupted()));
                }
            }
        }
    })
}

/// The error of work that unwound: an interrupt, or the panic itself.
fn ended(payload: Box<dyn Any + Send>) -> BindingError {
    if payload.is::<Stopped>() { BindingError::interrupted() } else { resume_unwind(payload) }
}

/// Reports progress to a Python callable `(stage: str, done: int, total: int)`. The job ends when the callable raises
/// or [`Stop`] is set.
pub(crate) struct ProgressCallback {
    callback: Option<Py<PyAny>>,
    stop: Stop,
    state: Mutex<State>,
}

struct State {
    stage: String,
    done: usize,
    total: usize,
    last_report: Instant,
    raised: Option<PyErr>,
}

impl ProgressCallback {
    /// Reports to `callback`; without one, to a progress bar in a notebook; otherwise nothing is reported.
    pub(crate) fn new(py: Python<'_>, callback: Option<Py<PyAny>>) -> PyResult<Self> {
        let callback = match callback {
            Some(callback) => Some(callback),
            None => py.import("veiloc.notebook")?.call_method0("default_progress")?.extract()?,
        };
        let state =
            State { stage: String::new(), done: 0, total: 0, last_report: Instant::now(), raised: None };
        Ok(Self { callback, stop: Stop::default(), state: Mutex::new(state) })
    }

    /// Runs the work with this as its progress.
    ///
    /// # Errors
    /// The callable's exception, or as [`interruptible`].
    pub(crate) fn run<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&Self) -> T + Send) -> Result<T> {
        let done = interruptible(py, &self.stop, || work(self));
        match self.state().raised.take() {
            Some(raised) => Err(raised.into()),
            None => done,
        }
    }

    fn state(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the state, and reports it if a report is due.
    fn update(&self, change: impl FnOnce(&mut State), always: bool) {
        if self.stop.is_set() {
            resume_unwind(Box::new(Stopped));
        }
        let Some(callback) = &self.callback else { return };
        let report = {
            let mut state = self.state();
            change(&mut state);
            let is_due =
                always || state.done >= state.total || state.last_report.elapsed() >= PROGRESS_INTERVAL;
            if is_due && !state.stage.is_empty() {
                state.last_report = Instant::now();
                Some((state.stage.clone(), state.done, state.total))
            } else {
                None
            }
        };
        // The state's lock is released here: the thread that holds the interpreter's lock may wait for it.
        let Some(report) = report else { return };
        if let Err(raised) = Python::attach(|py| callback.call1(py, report).map(|_| ())) {
            self.state().raised.get_or_insert(raised);
            self.stop.set();
            resume_unwind(Box::new(Stopped));
        }
    }
}

impl Progress for ProgressCallback {
    fn start(&self, stage: &str, total: usize) {
        let begin = |state: &mut State| {
            stage.clone_into(&mut state.stage);
            (state.done, state.total) = (0, total);
        };
        self.update(begin, true);
    }

    fn advance(&self, steps: usize) {
        self.update(|state| state.done += steps, false);
    }

    fn finish(&self) {
        self.update(|state| state.done = state.total, true);
    }
}
