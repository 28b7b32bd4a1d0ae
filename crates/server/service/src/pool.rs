//! The threads that localize, behind a fair queue of fixed length.
//!
//! Localization keeps a processor busy for tens of milliseconds, so it must not run where connections are served, and
//! more of it at a time than there are processors only makes everybody wait longer. Dedicated threads and a bounded
//! queue say both: what does not fit, or would not be done in time, is refused before anything is spent on it.

use std::num::{NonZeroU64, NonZeroUsize};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use crate::auth::TokenKey;
use crate::clock::Clock;
use crate::panics;
use crate::queue::FairQueue;

/// One piece of work, whatever its result is.
trait Work: Send {
    /// Whether somebody still waits for its result.
    fn is_waited_for(&self) -> bool;
    /// Gets the time it waited, sends its result itself, and tells whether it was begun at all.
    fn run(self: Box<Self>, waited: Duration) -> bool;
}

struct Task<T, F> {
    reply: oneshot::Sender<T>,
    work: F,
}

impl<T: Send, F: FnOnce(Duration) -> T + Send> Work for Task<T, F> {
    fn is_waited_for(&self) -> bool {
        !self.reply.is_closed()
    }

    fn run(self: Box<Self>, waited: Duration) -> bool {
        let begun = self.is_waited_for();
        if begun {
            // Nobody waits any longer when this fails.
            let _ = self.reply.send((self.work)(waited));
        }
        begun
    }
}

struct Job {
    work: Box<dyn Work>,
    accepted: Instant,
}

/// Who asks for work, and how much.
#[derive(Clone, Copy)]
pub struct Order {
    /// `None` where nobody is told apart.
    pub who: Option<TokenKey>,
    /// What it costs, in rows of a query.
    pub rows: usize,
    /// When its result is worth nothing any more.
    pub limit: Duration,
}

impl Order {
    /// Retrieval and the search cost as much as some rows, however few there are.
    const fn cost(&self) -> u64 {
        self.rows as u64 + 256
    }
}

/// What the pool's users and its threads share.
struct Shared {
    queue: Mutex<Waiting>,
    /// Work came, or the pool was closed.
    changed: Condvar,
    busy: AtomicUsize,
    /// What is being worked on costs so much.
    in_work: AtomicU64,
    /// Nanoseconds of work that was begun over its cost, a running mean; 0 before the first.
    mean_ns: AtomicU64,
    clock: Clock,
}

struct Waiting {
    jobs: FairQueue<TokenKey, Job>,
    closed: bool,
}

impl Shared {
    fn waiting(&self) -> MutexGuard<'_, Waiting> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn job_took(&self, time: Duration, cost: u64) {
        let took = (u64::try_from(time.as_nanos()).unwrap_or(u64::MAX) / cost.max(1)).max(1);
        let next =
            |mean: u64| if mean == 0 { took } else { (mean.saturating_mul(7).saturating_add(took)) / 8 };
        // Never refuses: the closure always has a next value.
        let _ = self.mean_ns.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |mean| Some(next(mean)));
    }

    /// The next job, once there is one; `None` when the pool is closed and empty.
    fn next(&self) -> Option<(u64, Job)> {
        let mut waiting = self.waiting();
        loop {
            if let Some(next) = waiting.jobs.pop() {
                return Some(next);
            }
            if waiting.closed {
                return None;
            }
            waiting = self.changed.wait(waiting).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

/// A fixed number of threads and a bounded queue.
pub struct Pool {
    shared: Arc<Shared>,
    threads: Mutex<Vec<JoinHandle<()>>>,
    workers: NonZeroUsize,
}

/// Why work was not taken.
#[derive(Debug, PartialEq, Eq)]
pub enum Refused {
    /// There is no room in the queue, or no more for this one; there should be after this many seconds.
    Full {
        /// Seconds, 1 to 60.
        retry_after: NonZeroU64,
    },
    /// It would not be done in time; after so many seconds it should.
    Late {
        /// Seconds, 1 to 60.
        retry_after: NonZeroU64,
    },
    /// The pool is closed.
    Closed,
}

impl Pool {
    /// Starts the threads.
    ///
    /// # Errors
    /// The system has no threads to give.
    pub fn start(workers: NonZeroUsize, queue: NonZeroUsize, clock: Clock) -> std::io::Result<Self> {
        let shared = Arc::new(Shared {
            queue: Mutex::new(Waiting { jobs: FairQueue::new(queue), closed: false }),
            changed: Condvar::new(),
            busy: AtomicUsize::new(0),
            in_work: AtomicU64::new(0),
            mean_ns: AtomicU64::new(0),
            clock,
        });
        let mut threads = Vec::new();
        panics::watch();
        for i in 0..workers.get() {
            let shared = shared.clone();
            let run = move || work_until_closed(&shared);
            threads.push(std::thread::Builder::new().name(format!("localize-{i}")).spawn(run)?);
        }
        Ok(Self { shared, threads: Mutex::new(threads), workers })
    }

    /// Queues work. The receiver gets its result; an error there means that the work panicked, at the place that
    /// [`panics`] logged.
    ///
    /// Work whose receiver is gone by the time a thread is free (the client left, or time ran out) is not begun, and gives up
    /// its place to who else would be refused.
    ///
    /// # Errors
    /// [`Refused`]: there is no room, no time, or the pool is closed.
    pub fn submit<T: Send + 'static>(
        &self,
        order: Order,
        work: impl FnOnce(Duration) -> T + Send + 'static,
    ) -> Result<oneshot::Receiver<T>, Refused> {
        let (reply, result) = oneshot::channel();
        let work = Box::new(Task { reply, work });
        let mut waiting = self.shared.waiting();
        if waiting.closed {
            return Err(Refused::Closed);
        }
        if let Err(refused) = self.takes(&waiting, order) {
            // Those who left meanwhile make room; looked for only now, for it looks at all that wait.
            let before = waiting.jobs.len();
            waiting.jobs.retain(|job| job.work.is_waited_for());
            if waiting.jobs.len() == before {
                return Err(refused);
            }
            self.takes(&waiting, order)?;
        }
        waiting.jobs.push(order.who, order.cost(), Job { work, accepted: self.shared.clock.now() });
        drop(waiting);
        self.shared.changed.notify_one();
        Ok(result)
    }

    /// Whether there is room for this and it would be done in time.
    fn takes(&self, waiting: &Waiting, order: Order) -> Result<(), Refused> {
        let ahead = self.time_of(waiting.jobs.ahead(order.who, order.cost()));
        if !waiting.jobs.has_room(order.who) {
            return Err(Refused::Full { retry_after: seconds(ahead) });
        }
        match ahead.checked_sub(order.limit) {
            Some(late) => Err(Refused::Late { retry_after: seconds(late) }),
            None => Ok(()),
        }
    }

    /// The time that work of this cost takes at the pace of late, with all threads and what they have in hand; zero as
    /// long as nobody knows.
    fn time_of(&self, cost: u64) -> Duration {
        let in_work = self.shared.in_work.load(Ordering::Relaxed) / 2;
        let all = self.shared.mean_ns.load(Ordering::Relaxed).saturating_mul(cost.saturating_add(in_work));
        Duration::from_nanos(all / self.workers.get() as u64)
    }

    /// How many wait.
    pub fn queued(&self) -> usize {
        self.shared.waiting().jobs.len()
    }

    /// How many are being worked on.
    pub fn busy(&self) -> usize {
        self.shared.busy.load(Ordering::Acquire)
    }

    /// Takes nothing more; what was taken is finished.
    pub fn close(&self) {
        self.shared.waiting().closed = true;
        self.shared.changed.notify_all();
    }

    /// The same, and blocks until it is finished.
    pub fn finish(&self) {
        self.close();
        let threads = std::mem::take(&mut *self.threads.lock().unwrap_or_else(PoisonError::into_inner));
        for thread in threads {
            // Work that panics is caught where it runs.
            let _ = thread.join();
        }
    }
}

/// Whole seconds to wait, from one to a minute.
fn seconds(wait: Duration) -> NonZeroU64 {
    let seconds = wait.as_secs() + u64::from(wait.subsec_nanos() > 0);
    NonZeroU64::new(seconds.clamp(1, 60)).unwrap_or(NonZeroU64::MIN)
}

fn work_until_closed(shared: &Shared) {
    panics::mark();
    while let Some((cost, Job { work, accepted })) = shared.next() {
        shared.busy.fetch_add(1, Ordering::Relaxed);
        shared.in_work.fetch_add(cost, Ordering::Relaxed);
        let started = shared.clock.now();
        // Its reply is dropped with it, which is how the one who waits learns of it. The hook has logged the place; what
        // the panic said is thrown away here, because it may hold something of a query.
        let begun = catch_unwind(AssertUnwindSafe(|| work.run(started.duration_since(accepted))));
        shared.in_work.fetch_sub(cost, Ordering::Relaxed);
        // Work that nobody waited for took no time, and says nothing about how long work takes.
        if begun.unwrap_or(true) {
            shared.job_took(shared.clock.now().saturating_duration_since(started), cost);
        }
        // Last: whoever sees a free thread sees what its work took.
        shared.busy.fetch_sub(1, Ordering::Release);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;

    use super::*;
    use crate::clock::ManualClock;

    fn pool(workers: usize, queue: usize) -> Pool {
        pool_by(&Clock::default(), workers, queue)
    }

    fn pool_by(clock: &Clock, workers: usize, queue: usize) -> Pool {
        let number = |n| NonZeroUsize::new(n).expect("not zero");
        Pool::start(number(workers), number(queue), clock.clone()).expect("threads")
    }

    /// Of nobody in particular, costing as much as 1000 rows.
    const ORDER: Order = Order { who: None, rows: 744, limit: Duration::from_secs(3600) };

    /// Keeps a thread busy until the returned barrier is waited for.
    fn occupy(pool: &Pool) -> (Arc<Barrier>, oneshot::Receiver<()>) {
        let (started, go) = (Arc::new(Barrier::new(2)), Arc::new(Barrier::new(2)));
        let inside = (started.clone(), go.clone());
        let result = pool.submit(ORDER, move |_| {
            inside.0.wait();
            inside.1.wait();
        });
        started.wait();
        (go, result.expect("room"))
    }

    #[test]
    fn what_does_not_fit_is_refused_and_what_was_taken_is_finished() {
        let pool = pool(1, 2);
        let (go, first) = occupy(&pool);
        let second = pool.submit(ORDER, |_| 2).expect("room for one");
        let third = pool.submit(ORDER, |_| 3).expect("room for two");
        assert_eq!((pool.queued(), pool.busy()), (2, 1));
        assert!(
            matches!(pool.submit(ORDER, |_| 4), Err(Refused::Full { retry_after }) if retry_after.get() == 1)
        );
        assert_eq!(pool.queued(), 2, "what was refused does not count");
        go.wait();
        pool.finish();
        first.blocking_recv().expect("finished");
        assert_eq!(second.blocking_recv(), Ok(2));
        assert_eq!(third.blocking_recv(), Ok(3));
        assert_eq!((pool.queued(), pool.busy()), (0, 0));
        assert_eq!(pool.submit(ORDER, |_| 5).err(), Some(Refused::Closed));
    }

    #[test]
    fn work_nobody_waits_for_is_not_begun() {
        let pool = pool(1, 4);
        let (go, _first) = occupy(&pool);
        let begun = Arc::new(AtomicUsize::new(0));
        for keep in [false, true, false] {
            let begun = begun.clone();
            let result = pool.submit(ORDER, move |_| begun.fetch_add(1, Ordering::Relaxed)).expect("room");
            if keep {
                std::mem::forget(result);
            }
        }
        go.wait();
        pool.finish();
        assert_eq!(begun.load(Ordering::Relaxed), 1);
    }

    #[test]
    fn work_nobody_waits_for_keeps_nobody_out() {
        let pool = pool(1, 2);
        let (go, _first) = occupy(&pool);
        let left = pool.submit(ORDER, |_| 1).expect("room");
        let kept = pool.submit(ORDER, |_| 2).expect("room");
        assert!(matches!(pool.submit(ORDER, |_| 3), Err(Refused::Full { .. })), "both are waited for");
        drop(left);
        let third = pool.submit(ORDER, |_| 3).expect("the place of who left");
        assert_eq!(pool.queued(), 2);
        assert!(matches!(pool.submit(ORDER, |_| 4), Err(Refused::Full { .. })));
        go.wait();
        pool.finish();
        assert_eq!((kept.blocking_recv(), third.blocking_recv()), (Ok(2), Ok(3)));
    }

    /// Does work that takes so long by the clock.
    fn work(pool: &Pool, clock: &ManualClock, took: Duration) {
        let clock = clock.clone();
        let result = pool.submit(ORDER, move |_| clock.advance(took)).expect("room");
        result.blocking_recv().expect("finished");
        // The result comes first, then the thread notes how long it took.
        while pool.busy() > 0 {
            std::thread::yield_now();
        }
    }

    /// A burst of clients that leave, as happens under overload, must not make the service promise a free queue.
    #[test]
    fn abandoned_work_does_not_shorten_the_estimate() {
        let clock = ManualClock::new();
        let pool = pool_by(&clock.clock(), 1, 30);
        work(&pool, &clock, Duration::from_secs(2));
        let (go, first) = occupy(&pool);
        for _ in 0..25 {
            drop(pool.submit(ORDER, |_| ()).expect("room"));
        }
        clock.advance(Duration::from_secs(2));
        go.wait();
        first.blocking_recv().expect("finished");
        // Takes the pool past those that left.
        work(&pool, &clock, Duration::from_secs(2));
        assert_eq!(pool.shared.mean_ns.load(Ordering::Relaxed), 2_000_000, "2 s for 1000 rows");
        pool.finish();
    }

    #[test]
    fn the_estimate_follows_the_times_of_late() {
        let clock = ManualClock::new();
        let pool = pool_by(&clock.clock(), 1, 30);
        for (took, mean_ns) in [(400, 400_000), (400, 400_000), (0, 350_000), (0, 306_250)] {
            work(&pool, &clock, Duration::from_millis(took));
            assert!(pool.shared.mean_ns.load(Ordering::Relaxed).abs_diff(mean_ns) <= 1, "after {took} ms");
        }
        pool.finish();
    }

    #[test]
    fn refusals_say_when_to_come_back() {
        let clock = ManualClock::new();
        let pool = pool_by(&clock.clock(), 1, 30);
        work(&pool, &clock, Duration::from_secs(1));
        let (go, _first) = occupy(&pool);
        // 1 s for each that waits, and half of one for what is in work.
        let hurried =
            Order { who: Some(TokenKey::of_digest([1; 32])), limit: Duration::from_millis(2400), ..ORDER };
        let mut waiting: Vec<_> =
            (0..2).map(|_| pool.submit(hurried, |_| ()).expect("0.5 s and 1.5 s are in time")).collect();
        let late = pool.submit(hurried, |_| ()).err();
        assert!(matches!(late, Some(Refused::Late { retry_after }) if retry_after.get() == 1), "{late:?}");
        let patient = Order { limit: Duration::from_secs(3600), ..hurried };
        waiting.push(pool.submit(patient, |_| ()).expect("an hour is enough"));
        while let Ok(result) = pool.submit(patient, |_| ()) {
            waiting.push(result);
        }
        // A lane alone may hold half of the queue.
        assert_eq!(waiting.len(), 15);
        let full = pool.submit(patient, |_| ()).err();
        assert!(matches!(full, Some(Refused::Full { retry_after }) if retry_after.get() == 16), "{full:?}");
        drop(waiting);
        go.wait();
        pool.finish();
    }

    #[test]
    fn a_panic_is_told_and_costs_no_thread() {
        let pool = pool(1, 4);
        let broken = pool.submit(ORDER, |_| -> u32 { std::panic::panic_any("broken") }).expect("room");
        assert!(broken.blocking_recv().is_err());
        assert_eq!(pool.submit(ORDER, |_| 1).expect("room").blocking_recv(), Ok(1), "the thread goes on");
        pool.finish();
    }
}
