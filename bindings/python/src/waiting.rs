//! Long calls: without the interpreter's lock, ended by Ctrl-C, and telling how far they are.
//!
//! The work runs on a thread of its own while the caller's waits, because Python hears signals on its main thread alone.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use pyo3::prelude::*;
use veiloc_features::Progress;
use veiloc_pose::Stop;

use crate::errors::{Fault, Result};
use crate::hands::on_another_thread;

/// How often a waiting call listens for Ctrl-C.
const LISTEN: Duration = Duration::from_millis(50);
/// How often a callback hears of steps.
const TELL: Duration = Duration::from_millis(100);

/// What unwinds a work that is stopped while it tells how far it is. Not a panic: no message is printed.
struct Stopped;

/// Does the work, and wishes it to stop when Ctrl-C is pressed.
///
/// # Errors
/// `KeyboardInterrupt`, or what another handler of a signal raised.
pub(crate) fn released<T: Send>(py: Python<'_>, stop: &Stop, work: impl FnOnce() -> T + Send) -> Result<T> {
    let done = py.detach(|| {
        std::thread::scope(|scope| {
            let (tell, hear) = channel();
            scope.spawn(move || tell.send(catch_unwind(AssertUnwindSafe(work))));
            wait(hear, stop)
        })
    });
    outcome(done)
}

/// The same of work that takes little: on a thread that waits for it, as nothing is borrowed.
///
/// # Errors
/// As [`released`].
pub(crate) fn released_at_once<T: Send + 'static>(
    py: Python<'_>,
    stop: &Stop,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T> {
    let (tell, hear) = channel();
    let work = AssertUnwindSafe(work);
    on_another_thread(move || {
        // Whoever asked waits until it is told.
        let _ = tell.send(catch_unwind(work));
    });
    outcome(py.detach(move || wait(hear, stop)))
}

type Done<T> = std::thread::Result<T>;

/// Waits for a work to end, listening for Ctrl-C: what a handler raised, and what came of the work.
fn wait<T>(hear: Receiver<Done<T>>, stop: &Stop) -> (Option<PyErr>, Done<T>) {
    let mut interrupt = None;
    loop {
        match hear.recv_timeout(LISTEN) {
            Ok(done) => return (interrupt, done),
            Err(RecvTimeoutError::Disconnected) => return (interrupt, Err(Box::new("the work is gone"))),
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

/// Does work that has no way to be stopped, such as waiting for a service; after Ctrl-C it is left alone.
///
/// # Errors
/// As [`released`].
pub(crate) fn abandonable<T: Send + 'static>(
    py: Python<'_>,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T> {
    let (tell, hear) = channel();
    let worker = std::thread::spawn(move || {
        // Nobody listens any more when the call was given up.
        let _ = tell.send(work());
    });
    py.detach(move || {
        loop {
            match hear.recv_timeout(LISTEN) {
                Ok(value) => return Ok(value),
                Err(RecvTimeoutError::Timeout) => Python::attach(|py| py.check_signals())?,
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(worker.join().map_or_else(ended, |()| Fault::interrupted()));
                }
            }
        }
    })
}

/// What a worker that did not come to its end ended by.
fn ended(payload: Box<dyn Any + Send>) -> Fault {
    if payload.is::<Stopped>() { Fault::interrupted() } else { resume_unwind(payload) }
}

/// Tells a Python callable `(stage: str, done: int, total: int)` how far a job is, and ends the job where that raises, or
/// where [`Stop`] is set.
pub(crate) struct Told {
    callback: Option<Py<PyAny>>,
    stop: Stop,
    state: Mutex<State>,
}

struct State {
    stage: String,
    done: usize,
    total: usize,
    told: Instant,
    raised: Option<PyErr>,
}

impl Told {
    /// To a callable; else, in a notebook, to a bar; else to nobody.
    pub(crate) fn new(py: Python<'_>, callback: Option<Py<PyAny>>) -> PyResult<Self> {
        let callback = match callback {
            Some(callback) => Some(callback),
            None => py.import("veiloc.notebook")?.call_method0("default_progress")?.extract()?,
        };
        let state = State { stage: String::new(), done: 0, total: 0, told: Instant::now(), raised: None };
        Ok(Self { callback, stop: Stop::default(), state: Mutex::new(state) })
    }

    /// Does the work with this as its progress.
    ///
    /// # Errors
    /// What the callable raised, or as [`released`].
    pub(crate) fn run<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&Self) -> T + Send) -> Result<T> {
        let done = released(py, &self.stop, || work(self));
        match self.state().raised.take() {
            Some(raised) => Err(raised.into()),
            None => done,
        }
    }

    fn state(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes what is known, and tells it where it is time to.
    fn update(&self, change: impl FnOnce(&mut State), always: bool) {
        if self.stop.is_set() {
            resume_unwind(Box::new(Stopped));
        }
        let Some(callback) = &self.callback else { return };
        let news = {
            let mut state = self.state();
            change(&mut state);
            let is_time = always || state.done >= state.total || state.told.elapsed() >= TELL;
            if is_time && !state.stage.is_empty() {
                state.told = Instant::now();
                Some((state.stage.clone(), state.done, state.total))
            } else {
                None
            }
        };
        // Without the lock of the state: the interpreter's lock may be held by who waits for it.
        let Some(news) = news else { return };
        if let Err(raised) = Python::attach(|py| callback.call1(py, news).map(|_| ())) {
            self.state().raised.get_or_insert(raised);
            self.stop.set();
            resume_unwind(Box::new(Stopped));
        }
    }
}

impl Progress for Told {
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
