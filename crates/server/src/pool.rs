//! The threads that localize, behind a queue of fixed length.
//!
//! Localization keeps a processor busy for tens of milliseconds, so it must not run where connections are served, and
//! more of it at a time than there are processors only makes everybody wait longer. Dedicated threads and a bounded
//! channel say both: what does not fit is refused before anything is spent on it.

use std::num::{NonZeroU64, NonZeroUsize};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use crate::panics;

/// One piece of work: gets the time it waited, sends its result itself, and tells whether it was begun at all.
type Work = Box<dyn FnOnce(Duration) -> bool + Send>;

struct Job {
    work: Work,
    accepted: Instant,
}

/// Counts that the pool's users and its threads share.
#[derive(Default)]
struct Counts {
    queued: AtomicUsize,
    busy: AtomicUsize,
    /// Microseconds of a job that was begun, a running mean; 0 before the first.
    mean_us: AtomicU64,
}

impl Counts {
    fn job_took(&self, time: Duration) {
        let took = u64::try_from(time.as_micros()).unwrap_or(u64::MAX).max(1);
        let next =
            |mean: u64| if mean == 0 { took } else { (mean.saturating_mul(7).saturating_add(took)) / 8 };
        // Never refuses: the closure always has a next value.
        let _ = self.mean_us.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |mean| Some(next(mean)));
    }
}

/// A fixed number of threads and a bounded queue.
pub(crate) struct Pool {
    /// `None` once closed.
    sender: Mutex<Option<SyncSender<Job>>>,
    threads: Mutex<Vec<JoinHandle<()>>>,
    counts: Arc<Counts>,
    workers: NonZeroUsize,
}

/// Why work was not taken.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Refused {
    /// The queue is full; there should be room after this many seconds.
    Full { retry_after: NonZeroU64 },
    /// The pool is closed.
    Closed,
}

impl Pool {
    /// Starts the threads.
    pub(crate) fn start(workers: NonZeroUsize, queue: NonZeroUsize) -> std::io::Result<Self> {
        let (sender, receiver) = sync_channel(queue.get());
        let receiver = Arc::new(Mutex::new(receiver));
        let counts = Arc::new(Counts::default());
        let mut threads = Vec::new();
        panics::watch();
        for i in 0..workers.get() {
            let (receiver, counts) = (receiver.clone(), counts.clone());
            let run = move || work_until_closed(&receiver, &counts);
            threads.push(std::thread::Builder::new().name(format!("localize-{i}")).spawn(run)?);
        }
        Ok(Self { sender: Mutex::new(Some(sender)), threads: Mutex::new(threads), counts, workers })
    }

    /// Queues work. The receiver gets its result; an error there means that the work panicked, at the place that
    /// [`panics`] logged.
    ///
    /// Work whose receiver is gone by the time a thread is free (the client left, or time ran out) is not begun.
    pub(crate) fn submit<T: Send + 'static>(
        &self,
        work: impl FnOnce(Duration) -> T + Send + 'static,
    ) -> Result<oneshot::Receiver<T>, Refused> {
        let (reply, result) = oneshot::channel();
        let work: Work = Box::new(move |waited| {
            let begun = !reply.is_closed();
            if begun {
                // Nobody waits any longer when this fails.
                let _ = reply.send(work(waited));
            }
            begun
        });
        let sender = self.sender.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(sender) = sender.as_ref() else { return Err(Refused::Closed) };
        // Counted first, so that the thread that takes it never counts below zero.
        self.counts.queued.fetch_add(1, Ordering::Relaxed);
        match sender.try_send(Job { work, accepted: Instant::now() }) {
            Ok(()) => Ok(result),
            Err(error) => {
                self.counts.queued.fetch_sub(1, Ordering::Relaxed);
                Err(match error {
                    TrySendError::Full(_) => Refused::Full { retry_after: self.retry_after() },
                    TrySendError::Disconnected(_) => Refused::Closed,
                })
            }
        }
    }

    /// How many wait.
    pub(crate) fn queued(&self) -> usize {
        self.counts.queued.load(Ordering::Relaxed)
    }

    /// How many are being worked on.
    pub(crate) fn busy(&self) -> usize {
        self.counts.busy.load(Ordering::Relaxed)
    }

    /// Takes nothing more; what was taken is finished. Blocks until it is.
    pub(crate) fn finish(&self) {
        self.sender.lock().unwrap_or_else(PoisonError::into_inner).take();
        let threads = std::mem::take(&mut *self.threads.lock().unwrap_or_else(PoisonError::into_inner));
        for thread in threads {
            // Work that panics is caught where it runs.
            let _ = thread.join();
        }
    }

    /// The time the queue takes at the pace of late, from one second to a minute.
    fn retry_after(&self) -> NonZeroU64 {
        let mean = self.counts.mean_us.load(Ordering::Relaxed);
        let all = mean.saturating_mul(self.queued() as u64) / self.workers.get() as u64;
        NonZeroU64::new(all.div_ceil(1_000_000).clamp(1, 60)).unwrap_or(NonZeroU64::MIN)
    }
}

fn work_until_closed(receiver: &Mutex<Receiver<Job>>, counts: &Counts) {
    panics::mark();
    loop {
        let job = receiver.lock().unwrap_or_else(PoisonError::into_inner).recv();
        let Ok(Job { work, accepted }) = job else { return };
        counts.queued.fetch_sub(1, Ordering::Relaxed);
        counts.busy.fetch_add(1, Ordering::Relaxed);
        let started = Instant::now();
        // Its reply is dropped with it, which is how the one who waits learns of it. The hook has logged the place; what
        // the panic said is thrown away here, because it may hold something of a query.
        let begun = catch_unwind(AssertUnwindSafe(|| work(started.duration_since(accepted))));
        counts.busy.fetch_sub(1, Ordering::Relaxed);
        // Work that nobody waited for took no time, and says nothing about how long work takes.
        if begun.unwrap_or(true) {
            counts.job_took(started.elapsed());
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;

    use super::*;

    fn pool(workers: usize, queue: usize) -> Pool {
        let number = |n| NonZeroUsize::new(n).expect("not zero");
        Pool::start(number(workers), number(queue)).expect("threads")
    }

    /// Keeps a thread busy until the returned barrier is waited for.
    fn occupy(pool: &Pool) -> (Arc<Barrier>, oneshot::Receiver<()>) {
        let (started, go) = (Arc::new(Barrier::new(2)), Arc::new(Barrier::new(2)));
        let inside = (started.clone(), go.clone());
        let result = pool.submit(move |_| {
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
        let second = pool.submit(|_| 2).expect("room for one");
        let third = pool.submit(|_| 3).expect("room for two");
        assert_eq!((pool.queued(), pool.busy()), (2, 1));
        assert!(matches!(pool.submit(|_| 4), Err(Refused::Full { retry_after }) if retry_after.get() == 1));
        assert_eq!(pool.queued(), 2, "what was refused does not count");
        go.wait();
        pool.finish();
        first.blocking_recv().expect("finished");
        assert_eq!(second.blocking_recv(), Ok(2));
        assert_eq!(third.blocking_recv(), Ok(3));
        assert_eq!((pool.queued(), pool.busy()), (0, 0));
        assert_eq!(pool.submit(|_| 5).err(), Some(Refused::Closed));
    }

    #[test]
    fn work_nobody_waits_for_is_not_begun() {
        let pool = pool(1, 4);
        let (go, _first) = occupy(&pool);
        let begun = Arc::new(AtomicUsize::new(0));
        for keep in [false, true, false] {
            let begun = begun.clone();
            let result = pool.submit(move |_| begun.fetch_add(1, Ordering::Relaxed)).expect("room");
            if keep {
                std::mem::forget(result);
            }
        }
        go.wait();
        pool.finish();
        assert_eq!(begun.load(Ordering::Relaxed), 1);
    }

    /// A burst of clients that leave, as happens under overload, must not make the service promise a free queue.
    #[test]
    fn work_nobody_waits_for_does_not_count_as_quick() {
        let pool = pool(1, 30);
        let slow = |_| std::thread::sleep(Duration::from_millis(400));
        pool.submit(slow).expect("room").blocking_recv().expect("finished");
        let (go, _first) = occupy(&pool);
        for _ in 0..25 {
            drop(pool.submit(|_| ()).expect("room"));
        }
        let last = pool.submit(|_| ()).expect("room");
        go.wait();
        last.blocking_recv().expect("finished");
        let mean = pool.counts.mean_us.load(Ordering::Relaxed);
        // 400 ms, then two jobs of next to nothing: (7/8)² of it, where 25 more would have left (7/8)²⁷, 11 ms.
        assert!(mean >= 300_000, "{mean} µs");
        let (go, _first) = occupy(&pool);
        let waiting: Vec<_> = (0..30).map(|_| pool.submit(|_| ()).expect("room")).collect();
        let Err(Refused::Full { retry_after }) = pool.submit(|_| ()) else { panic!("31 do not fit") };
        assert!(retry_after.get() >= 9, "30 times at least 300 ms, not {retry_after} s");
        drop(waiting);
        go.wait();
        pool.finish();
    }

    #[test]
    fn a_panic_is_told_and_costs_no_thread() {
        let pool = pool(1, 4);
        let broken = pool.submit(|_| -> u32 { std::panic::panic_any("broken") }).expect("room");
        assert!(broken.blocking_recv().is_err());
        assert_eq!(pool.submit(|_| 1).expect("room").blocking_recv(), Ok(1), "the thread goes on");
        pool.finish();
    }
}
