//! A queue of bounded length emptied by one dedicated thread. Senders never wait, and may wait for a flush.

use std::num::NonZeroUsize;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::{Duration, Instant};

/// Pause between two attempts to enqueue a flush into a full queue.
const PAUSE: Duration = Duration::from_millis(5);

/// An entry of the queue.
pub(crate) enum QueueItem<T> {
    Item(T),
    /// Signalled when everything before it is done.
    Flush(FlushSignal),
}

/// Signal that the queue was flushed.
pub(crate) struct FlushSignal(SyncSender<()>);

impl FlushSignal {
    /// Signals that everything before is done. The waiting side may be gone.
    pub(crate) fn notify(self) {
        let _ = self.0.try_send(());
    }
}

/// Sending half; clones share the queue.
pub(crate) struct Sender<T>(SyncSender<QueueItem<T>>);

impl<T> Clone for Sender<T> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

/// A queue for at most `length` items.
pub(crate) fn queue<T>(length: NonZeroUsize) -> (Sender<T>, Receiver<QueueItem<T>>) {
    let (sender, receiver) = sync_channel(length.get());
    (Sender(sender), receiver)
}

impl<T> Sender<T> {
    /// Enqueues an item; returns whether there was room.
    #[must_use]
    pub(crate) fn send(&self, item: T) -> bool {
        self.0.try_send(QueueItem::Item(item)).is_ok()
    }

    /// Waits until all enqueued items are done, at most `timeout`. Returns whether they were.
    pub(crate) fn flush(&self, timeout: Duration) -> bool {
        let deadline = Instant::now() + timeout;
        let (done, done_signal) = sync_channel(1);
        let mut flush = QueueItem::Flush(FlushSignal(done));
        loop {
            match self.0.try_send(flush) {
                Ok(()) => break,
                Err(TrySendError::Full(back)) if Instant::now() < deadline => {
                    flush = back;
                    std::thread::sleep(PAUSE);
                }
                Err(_) => return false,
            }
        }
        done_signal.recv_timeout(deadline.saturating_duration_since(Instant::now())).is_ok()
    }
}
