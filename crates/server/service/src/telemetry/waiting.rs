//! A queue of fixed length that one thread of its own empties: who hands something over never waits, and may ask that what
//! was handed over so far is done.

use std::num::NonZeroUsize;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::{Duration, Instant};

/// Pause between two attempts to get the wish to flush into a full queue.
const PAUSE: Duration = Duration::from_millis(5);

/// What lies in the queue.
pub(crate) enum Waiting<T> {
    Item(T),
    /// Answered when everything before it is done.
    Flush(Flushed),
}

/// Who waits for the queue to be flushed.
pub(crate) struct Flushed(SyncSender<()>);

impl Flushed {
    /// All that was handed over before is done. Who asked may have given up.
    pub(crate) fn tell(self) {
        let _ = self.0.try_send(());
    }
}

/// The end that hands over; clones share the queue.
pub(crate) struct Sender<T>(SyncSender<Waiting<T>>);

impl<T> Clone for Sender<T> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

/// A queue in which `length` items may wait.
pub(crate) fn queue<T>(length: NonZeroUsize) -> (Sender<T>, Receiver<Waiting<T>>) {
    let (sender, receiver) = sync_channel(length.get());
    (Sender(sender), receiver)
}

impl<T> Sender<T> {
    /// Whether there was room for it.
    #[must_use]
    pub(crate) fn hand_over(&self, item: T) -> bool {
        self.0.try_send(Waiting::Item(item)).is_ok()
    }

    /// Waits until everything handed over so far is done, no longer than `patience`. Whether it was.
    pub(crate) fn flush(&self, patience: Duration) -> bool {
        let deadline = Instant::now() + patience;
        let (done, told) = sync_channel(1);
        let mut wish = Waiting::Flush(Flushed(done));
        loop {
            match self.0.try_send(wish) {
                Ok(()) => break,
                Err(TrySendError::Full(back)) if Instant::now() < deadline => {
                    wish = back;
                    std::thread::sleep(PAUSE);
                }
                Err(_) => return false,
            }
        }
        told.recv_timeout(deadline.saturating_duration_since(Instant::now())).is_ok()
    }
}
