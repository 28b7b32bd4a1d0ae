//! A small pool of idle threads: starting a thread takes 0.1 ms, a twentieth of the time of a pose estimate.
//!
//! A forked process has no threads of its parent, so each entry records the process that started it.

use std::sync::Mutex;
use std::sync::mpsc::{Sender, channel};

type Work = Box<dyn FnOnce() + Send>;

/// A thread that runs the work sent to it.
struct WorkerThread {
    process: u32,
    send: Sender<Work>,
}

/// Threads without work.
static IDLE: Mutex<Vec<WorkerThread>> = Mutex::new(Vec::new());

/// Most idle threads that the pool holds.
const MAX_IDLE: usize = 4;

/// Runs the work on a pool thread. The work must not unwind.
pub(crate) fn run_on_worker(work: impl FnOnce() + Send + 'static) {
    let process = std::process::id();
    // `try_lock`, never `lock`: in a forked child a lock that a parent thread held is never released.
    let worker = IDLE.try_lock().ok().and_then(|mut idle| {
        // Senders of the parent process are leaked, not dropped: their shared state may be half changed.
        idle.extract_if(.., |worker| worker.process != process).for_each(std::mem::forget);
        idle.pop()
    });
    let worker = worker.unwrap_or_else(|| WorkerThread::new(process));
    let send = worker.send.clone();
    let work_then_idle = Box::new(move || {
        work();
        if let Ok(mut idle) = IDLE.try_lock()
            && idle.len() < MAX_IDLE
        {
            idle.push(worker);
        }
    });
    send.send(work_then_idle).expect("the thread ends only after its last sender is dropped");
}

impl WorkerThread {
    fn new(process: u32) -> Self {
        let (send, receive) = channel::<Work>();
        std::thread::spawn(move || receive.into_iter().for_each(|work| work()));
        Self { process, send }
    }
}
