//! The threads that localize, behind a fair queue of bounded length.
//!
//! Localization occupies a processor for tens of milliseconds, so it must not run on the threads that serve
//! connections, and running more jobs than there are processors only delays all of them. A job that does not fit into
//! the queue, or would not finish in time, is refused before any work is spent on it.

use std::num::{NonZeroU64, NonZeroUsize};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use crate::auth::TokenKey;
use crate::queue::clock::Clock;
use crate::queue::{Charge, FairQueue};
use crate::telemetry::panics;

/// A job, independent of the type of its result.
trait Work: Send {
    /// Whether the submitter still waits for the result.
    fn is_awaited(&self) -> bool;
    /// Runs the job and sends its result, unless the submitter is gone; returns whether it ran. `waited`: time in the
    /// queue.
    fn run(self: Box<Self>, waited: Duration) -> bool;
}

struct Task<T, F> {
    reply: oneshot::Sender<T>,
    work: F,
}

impl<T: Send, F: FnOnce(Duration) -> T + Send> Work for Task<T, F> {
    fn is_awaited(&self) -> bool {
        !self.reply.is_closed()
    }

    fn run(self: Box<Self>, waited: Duration) -> bool {
        let begun = self.is_awaited();
        if begun {
            // Sending fails only when the submitter is gone.
            let _ = self.reply.send((self.work)(waited));
        }
        begun
    }
}

struct Job {
    work: Box<dyn Work>,
    accepted: Instant,
    /// Whether it localizes several images together.
    is_session: bool,
}

/// Client, size and time limit of a job.
#[derive(Clone, Copy)]
pub struct JobSpec {
    /// The token of the client; `None` where clients are not distinguished.
    pub client: Option<TokenKey>,
    /// Number of descriptor rows.
    pub rows: usize,
    /// Whether it localizes several images together.
    pub is_session: bool,
    /// Time limit of the result.
    pub limit: Duration,
}

impl JobSpec {
    /// Its size in rows; retrieval and the search for the pose count as 256.
    const fn size(&self) -> u64 {
        self.rows as u64 + 256
    }
}

/// State shared by submitters and worker threads.
struct Shared {
    queue: Mutex<QueueState>,
    /// Notified when a job was queued or the pool was closed.
    changed: Condvar,
    busy: AtomicUsize,
    /// Estimated time of the running jobs, nanoseconds.
    active_ns: AtomicU64,
    clock: Clock,
}

struct QueueState {
    jobs: FairQueue<TokenKey, Job>,
    /// Number of sessions that run.
    sessions: usize,
    /// Maximum of [`Self::sessions`]: one thread is kept free of them if there are several, because a session takes
    /// seconds and a query tens of milliseconds.
    max_sessions: usize,
    closed: bool,
}

impl QueueState {
    fn pop(&mut self) -> Option<(Charge<TokenKey>, Job)> {
        let may_begin = self.sessions < self.max_sessions;
        let popped = self.jobs.pop_if(|job| may_begin || !job.is_session)?;
        self.sessions += usize::from(popped.1.is_session);
        Some(popped)
    }
}

impl Shared {
    fn queue_state(&self) -> MutexGuard<'_, QueueState> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for the next job; `None` when the pool is closed and empty.
    fn next(&self) -> Option<(Charge<TokenKey>, Job)> {
        let mut state = self.queue_state();
        loop {
            if let Some(next) = state.pop() {
                return Some(next);
            }
            // A session that must wait for another one is notified when that ends.
            if state.closed && state.jobs.is_empty() {
                return None;
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

/// A fixed number of threads and a bounded queue.
pub struct Pool {
    shared: Arc<Shared>,
    threads: Mutex<Vec<JoinHandle<()>>>,
    workers: NonZeroUsize,
}

/// Why a job was rejected.
#[derive(Debug, PartialEq, Eq)]
pub enum Rejected {
    /// The queue is full, or the share of this client is. Retry after this many seconds.
    Full {
        /// Seconds, 1 to 60.
        retry_after: NonZeroU64,
    },
    /// The job would not finish in time. Retry after this many seconds.
    Late {
        /// Seconds, 1 to 60.
        retry_after: NonZeroU64,
    },
    /// The pool is closed.
    Closed,
}

impl Pool {
    /// Starts the worker threads.
    ///
    /// # Errors
    /// The system refused a thread.
    pub fn start(workers: NonZeroUsize, queue: NonZeroUsize, clock: Clock) -> std::io::Result<Self> {
        let shared = Arc::new(Shared {
            queue: Mutex::new(QueueState {
                jobs: FairQueue::new(queue),
                sessions: 0,
                max_sessions: (workers.get() - 1).max(1),
                closed: false,
            }),
            changed: Condvar::new(),
            busy: AtomicUsize::new(0),
            active_ns: AtomicU64::new(0),
            clock,
        });
        let mut threads = Vec::new();
        panics::watch();
        for i in 0..workers.get() {
            let shared = shared.clone();
            let run = move || run_worker(&shared);
            threads.push(std::thread::Builder::new().name(format!("localize-{i}")).spawn(run)?);
        }
        Ok(Self { shared, threads: Mutex::new(threads), workers })
    }

    /// Queues a job. The receiver gets its result; a receive error means that the job panicked ([`panics`] logged
    /// where).
    ///
    /// A job whose receiver was dropped before it started (the client left, or time ran out) is skipped, and its
    /// queue slot is freed when another job would otherwise be rejected.
    ///
    /// # Errors
    /// [`Rejected`]: the queue is full, time is too short, or the pool is closed.
    pub fn submit<T: Send + 'static>(
        &self,
        spec: JobSpec,
        work: impl FnOnce(Duration) -> T + Send + 'static,
    ) -> Result<oneshot::Receiver<T>, Rejected> {
        let (reply, result) = oneshot::channel();
        let work = Box::new(Task { reply, work });
        let mut state = self.shared.queue_state();
        if state.closed {
            return Err(Rejected::Closed);
        }
        if let Err(refused) = self.check_room(&state, spec) {
            // Free the slots of abandoned jobs. This scans the whole queue, so it is done only when needed.
            let before = state.jobs.len();
            state.jobs.retain(|job| job.work.is_awaited());
            if state.jobs.len() == before {
                return Err(refused);
            }
            self.check_room(&state, spec)?;
        }
        state.jobs.push(
            spec.client,
            spec.size(),
            Job { work, accepted: self.shared.clock.now(), is_session: spec.is_session },
        );
        drop(state);
        // All: the one that is woken may not begin a session.
        self.shared.changed.notify_all();
        Ok(result)
    }

    /// Checks that the queue has room and that the job would finish in time.
    fn check_room(&self, state: &QueueState, spec: JobSpec) -> Result<(), Rejected> {
        // By all threads, including half of the running jobs.
        let active = Duration::from_nanos(self.shared.active_ns.load(Ordering::Relaxed) / 2);
        let ahead = (state.jobs.ahead(spec.client, spec.size()) + active) / self.workers.get() as u32;
        if !state.jobs.has_room(spec.client) {
            return Err(Rejected::Full { retry_after: seconds(ahead) });
        }
        match ahead.checked_sub(spec.limit) {
            Some(late) => Err(Rejected::Late { retry_after: seconds(late) }),
            None => Ok(()),
        }
    }

    /// Number of queued jobs.
    pub fn queued(&self) -> usize {
        self.shared.queue_state().jobs.len()
    }

    /// Number of running jobs.
    pub fn busy(&self) -> usize {
        self.shared.busy.load(Ordering::Acquire)
    }

    /// Rejects further jobs; accepted jobs are finished.
    pub fn close(&self) {
        self.shared.queue_state().closed = true;
        self.shared.changed.notify_all();
    }

    /// As [`Self::close`], and blocks until all accepted jobs are finished.
    pub fn finish(&self) {
        self.close();
        let threads = std::mem::take(&mut *self.threads.lock().unwrap_or_else(PoisonError::into_inner));
        for thread in threads {
            // Panics of jobs are caught in `run_worker`.
            let _ = thread.join();
        }
    }
}

/// Whole seconds, clamped to 1 to 60.
fn seconds(wait: Duration) -> NonZeroU64 {
    let seconds = wait.as_secs() + u64::from(wait.subsec_nanos() > 0);
    NonZeroU64::new(seconds.clamp(1, 60)).unwrap_or(NonZeroU64::MIN)
}

fn run_worker(shared: &Shared) {
    panics::mark_service_thread();
    // Parallel parts of a localization run on this thread: in a common pool the small jobs of one client would wait for the
    // large ones of another, and be charged for it. If the pool cannot be made, the common one is used.
    let _own = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build();
    while let Some((charge, Job { work, accepted, is_session })) = shared.next() {
        let estimate = u64::try_from(charge.estimate().as_nanos()).unwrap_or(u64::MAX);
        shared.busy.fetch_add(1, Ordering::Relaxed);
        shared.active_ns.fetch_add(estimate, Ordering::Relaxed);
        let started = shared.clock.now();
        // On a panic the reply sender is dropped, which notifies the submitter. The hook has logged the location; the
        // message is discarded here, because it may contain parts of a query.
        let begun = catch_unwind(AssertUnwindSafe(|| work.run(started.duration_since(accepted))));
        shared.active_ns.fetch_sub(estimate, Ordering::Relaxed);
        // A skipped job took no time.
        let took = begun.unwrap_or(true).then(|| shared.clock.now().saturating_duration_since(started));
        let mut state = shared.queue_state();
        state.jobs.record(&charge, took);
        state.sessions -= usize::from(is_session);
        drop(state);
        if is_session {
            shared.changed.notify_all();
        }
        // Last, so that a thread seen as free has already recorded its duration.
        shared.busy.fetch_sub(1, Ordering::Release);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;

    use super::*;
    use crate::queue::clock::ManualClock;

    fn pool(workers: usize, queue: usize) -> Pool {
        pool_by(&Clock::default(), workers, queue)
    }

    fn pool_by(clock: &Clock, workers: usize, queue: usize) -> Pool {
        let number = |n| NonZeroUsize::new(n).expect("not zero");
        Pool::start(number(workers), number(queue), clock.clone()).expect("threads")
    }

    /// A job without a client, of size 1000.
    const SPEC: JobSpec =
        JobSpec { client: None, rows: 744, is_session: false, limit: Duration::from_secs(3600) };

    /// Occupies a thread until the returned barrier is released.
    fn occupy(pool: &Pool) -> (Arc<Barrier>, oneshot::Receiver<()>) {
        occupy_by(pool, SPEC)
    }

    fn occupy_by(pool: &Pool, spec: JobSpec) -> (Arc<Barrier>, oneshot::Receiver<()>) {
        let (started, go) = (Arc::new(Barrier::new(2)), Arc::new(Barrier::new(2)));
        let inside = (started.clone(), go.clone());
        let result = pool.submit(spec, move |_| {
            inside.0.wait();
            inside.1.wait();
        });
        started.wait();
        (go, result.expect("room"))
    }

    #[test]
    fn full_queue_rejects_and_accepted_jobs_finish() {
        let pool = pool(1, 2);
        let (go, first) = occupy(&pool);
        let second = pool.submit(SPEC, |_| 2).expect("room for one");
        let third = pool.submit(SPEC, |_| 3).expect("room for two");
        assert_eq!((pool.queued(), pool.busy()), (2, 1));
        assert!(
            matches!(pool.submit(SPEC, |_| 4), Err(Rejected::Full { retry_after }) if retry_after.get() == 1)
        );
        assert_eq!(pool.queued(), 2, "rejected jobs do not count");
        go.wait();
        pool.finish();
        first.blocking_recv().expect("finished");
        assert_eq!(second.blocking_recv(), Ok(2));
        assert_eq!(third.blocking_recv(), Ok(3));
        assert_eq!((pool.queued(), pool.busy()), (0, 0));
        assert_eq!(pool.submit(SPEC, |_| 5).err(), Some(Rejected::Closed));
    }

    /// Of several threads one is kept free of sessions; all accepted sessions are done in the end.
    #[test]
    fn sessions_leave_a_thread_to_queries() {
        let pool = pool(2, 8);
        let session = JobSpec { is_session: true, ..SPEC };
        let (go, first) = occupy_by(&pool, session);
        let begun = Arc::new(AtomicUsize::new(0));
        let count = begun.clone();
        let second = pool.submit(session, move |_| count.fetch_add(1, Ordering::SeqCst)).expect("room");
        // It came later, and its thread would have to wait for a session if both threads had one.
        let count = begun.clone();
        let query = pool.submit(SPEC, move |_| count.load(Ordering::SeqCst)).expect("room");
        assert_eq!(query.blocking_recv(), Ok(0), "the second session waits for the first");
        pool.close();
        go.wait();
        pool.finish();
        first.blocking_recv().expect("finished");
        assert_eq!(second.blocking_recv(), Ok(0));
    }

    #[test]
    fn abandoned_jobs_are_skipped() {
        let pool = pool(1, 4);
        let (go, _first) = occupy(&pool);
        let begun = Arc::new(AtomicUsize::new(0));
        for is_awaited in [false, true, false] {
            let begun = begun.clone();
            let result = pool.submit(SPEC, move |_| begun.fetch_add(1, Ordering::Relaxed)).expect("room");
            if is_awaited {
                std::mem::forget(result);
            }
        }
        go.wait();
        pool.finish();
        assert_eq!(begun.load(Ordering::Relaxed), 1);
    }

    #[test]
    fn abandoned_jobs_free_their_slots() {
        let pool = pool(1, 2);
        let (go, _first) = occupy(&pool);
        let left = pool.submit(SPEC, |_| 1).expect("room");
        let awaited = pool.submit(SPEC, |_| 2).expect("room");
        assert!(matches!(pool.submit(SPEC, |_| 3), Err(Rejected::Full { .. })), "both results are awaited");
        drop(left);
        let third = pool.submit(SPEC, |_| 3).expect("the slot of the abandoned job");
        assert_eq!(pool.queued(), 2);
        assert!(matches!(pool.submit(SPEC, |_| 4), Err(Rejected::Full { .. })));
        go.wait();
        pool.finish();
        assert_eq!((awaited.blocking_recv(), third.blocking_recv()), (Ok(2), Ok(3)));
    }

    /// Runs a job that takes this long by the clock.
    fn work(pool: &Pool, clock: &ManualClock, took: Duration) {
        let clock = clock.clone();
        let result = pool.submit(SPEC, move |_| clock.advance(took)).expect("room");
        result.blocking_recv().expect("finished");
        // The result arrives before the thread records the duration.
        while pool.busy() > 0 {
            std::thread::yield_now();
        }
    }

    /// Clients that disconnect under overload must not make the service underestimate the waiting time.
    #[test]
    fn abandoned_work_does_not_shorten_the_estimate() {
        let clock = ManualClock::new();
        let pool = pool_by(&clock.clock(), 1, 30);
        work(&pool, &clock, Duration::from_secs(2));
        let (go, first) = occupy(&pool);
        for _ in 0..25 {
            drop(pool.submit(SPEC, |_| ()).expect("room"));
        }
        clock.advance(Duration::from_secs(2));
        go.wait();
        first.blocking_recv().expect("finished");
        // This job is popped after the abandoned ones.
        work(&pool, &clock, Duration::from_secs(2));
        assert_eq!(pool.shared.queue_state().jobs.estimate(None, 1000), Duration::from_secs(2));
        pool.finish();
    }

    #[test]
    fn estimate_follows_recent_durations() {
        let clock = ManualClock::new();
        let pool = pool_by(&clock.clock(), 1, 30);
        for (took, mean_ns) in [(400, 400_000), (400, 400_000), (0, 350_000), (0, 306_250)] {
            work(&pool, &clock, Duration::from_millis(took));
            let estimate = pool.shared.queue_state().jobs.estimate(None, 1);
            assert!(estimate.abs_diff(Duration::from_nanos(mean_ns)).as_nanos() <= 1, "after {took} ms");
        }
        pool.finish();
    }

    #[test]
    fn rejections_have_retry_after() {
        let clock = ManualClock::new();
        let pool = pool_by(&clock.clock(), 1, 30);
        work(&pool, &clock, Duration::from_secs(1));
        let (go, _first) = occupy(&pool);
        // 1 s for each queued job, and half of one for the running job.
        let urgent = JobSpec {
            client: Some(TokenKey::of_digest([1; 32])),
            limit: Duration::from_millis(2400),
            ..SPEC
        };
        let mut waiting: Vec<_> =
            (0..2).map(|_| pool.submit(urgent, |_| ()).expect("0.5 s and 1.5 s are in time")).collect();
        let late = pool.submit(urgent, |_| ()).err();
        assert!(matches!(late, Some(Rejected::Late { retry_after }) if retry_after.get() == 1), "{late:?}");
        let patient = JobSpec { limit: Duration::from_secs(3600), ..urgent };
        waiting.push(pool.submit(patient, |_| ()).expect("an hour is enough"));
        while let Ok(result) = pool.submit(patient, |_| ()) {
            waiting.push(result);
        }
        // A single lane may hold half of the queue.
        assert_eq!(waiting.len(), 15);
        let full = pool.submit(patient, |_| ()).err();
        assert!(matches!(full, Some(Rejected::Full { retry_after }) if retry_after.get() == 16), "{full:?}");
        drop(waiting);
        go.wait();
        pool.finish();
    }

    #[test]
    fn panic_is_reported_and_thread_survives() {
        let pool = pool(1, 4);
        let broken = pool.submit(SPEC, |_| -> u32 { std::panic::panic_any("broken") }).expect("room");
        assert!(broken.blocking_recv().is_err());
        assert_eq!(pool.submit(SPEC, |_| 1).expect("room").blocking_recv(), Ok(1), "the thread goes on");
        pool.finish();
    }
}
