//! A log that never blocks its callers: lines go into a queue of bounded length, and a dedicated thread writes them.
//!
//! A write to stderr blocks while the reader of its pipe is stuck, and fails when the reader is gone or the disk is
//! full. Neither may delay a request or the end of the program. So callers only enqueue a line. A line that does not
//! fit, or could not be written, is counted ([`LogQueue::dropped`], `veiloc_log_lines_dropped_total`), and the log
//! reports the number as soon as it can be written again.

use std::fmt;
use std::io::{self, Write};
use std::num::NonZeroUsize;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use prometheus_client::metrics::counter::Counter;

use crate::telemetry::background_queue::{QueueItem, Sender, queue};

/// Capacity of the queue: one second of the busiest service, about a megabyte.
const LINES: NonZeroUsize = NonZeroUsize::MIN.saturating_add(4095);

/// The queue of lines; clones share it.
#[derive(Clone)]
pub struct LogQueue {
    sender: Sender<Vec<u8>>,
    dropped: Counter,
}

impl fmt::Debug for LogQueue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LogQueue").field("dropped", &self.dropped()).finish_non_exhaustive()
    }
}

impl LogQueue {
    /// Starts the thread that writes to `sink`.
    ///
    /// # Errors
    /// The system refused a thread.
    pub fn start(sink: impl Write + Send + 'static) -> io::Result<Self> {
        Self::with_capacity(sink, LINES)
    }

    fn with_capacity(sink: impl Write + Send + 'static, lines: NonZeroUsize) -> io::Result<Self> {
        let (sender, receiver) = queue(lines);
        let dropped = Counter::default();
        let writer = Writer { sink, dropped: dropped.clone(), reported: 0, torn: false };
        std::thread::Builder::new().name("log".to_owned()).spawn(move || writer.run(&receiver))?;
        Ok(Self { sender, dropped })
    }

    /// A writer for one line, which must be written in one call, as `tracing_subscriber` does. Never blocks and never
    /// fails.
    pub fn line(&self) -> LogLine {
        LogLine(self.clone())
    }

    /// Enqueues a line that is not a log event.
    pub fn plain_line(&self, text: impl fmt::Display) {
        self.send(format!("{text}\n").into_bytes());
    }

    /// Number of lines dropped so far.
    pub fn dropped(&self) -> u64 {
        self.dropped.get()
    }

    /// The counter of dropped lines for the metrics.
    pub(crate) fn dropped_counter(&self) -> Counter {
        self.dropped.clone()
    }

    /// Waits until all enqueued lines are written, at most `timeout`. Returns whether they were.
    pub fn flush(&self, timeout: Duration) -> bool {
        self.sender.flush(timeout)
    }

    fn send(&self, line: Vec<u8>) {
        if !self.sender.send(line) {
            self.dropped.inc();
        }
    }
}

/// Writer of one line.
#[derive(Debug)]
pub struct LogLine(LogQueue);

impl Write for LogLine {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        self.0.send(line.to_vec());
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

struct Writer<W> {
    sink: W,
    dropped: Counter,
    /// Dropped lines that the log has reported.
    reported: u64,
    /// Whether the last write may have left a partial line.
    torn: bool,
}

/// Idle time before dropped lines are reported, so that the report does not add to a burst.
const QUIET_PERIOD: Duration = Duration::from_millis(200);

impl<W: Write> Writer<W> {
    fn run(mut self, messages: &Receiver<QueueItem<Vec<u8>>>) {
        loop {
            match messages.recv_timeout(QUIET_PERIOD) {
                Ok(QueueItem::Item(line)) => self.write(&line),
                Ok(QueueItem::Flush(flushed)) => flushed.notify(),
                Err(RecvTimeoutError::Timeout) => self.report_dropped(),
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    fn write(&mut self, line: &[u8]) {
        let separator: &[u8] = if self.torn { b"\n" } else { b"" };
        let written = self.sink.write_all(separator).and_then(|()| self.sink.write_all(line));
        self.torn = written.and_then(|()| self.sink.flush()).is_err();
        if self.torn {
            self.dropped.inc();
        }
    }

    /// Reports dropped lines through the log itself, so that they have the format of the log. If this line is dropped
    /// too, it is reported later.
    fn report_dropped(&mut self) {
        let dropped = self.dropped.get();
        if dropped > self.reported && !self.torn {
            tracing::warn!(
                lines = dropped - self.reported,
                "log lines were dropped: the reader of the log is too slow"
            );
            self.reported = dropped;
        } else if self.torn && self.sink.write_all(b"\n").is_ok() {
            // The sink works again; the next call reports.
            self.torn = false;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::sync::mpsc::{Sender, channel};
    use std::sync::{Arc, Condvar, Mutex};

    use super::*;

    /// A pipe whose reader is stuck until `open`.
    #[derive(Clone, Default)]
    struct Stuck(Arc<(Mutex<bool>, Condvar)>, Arc<Mutex<Vec<u8>>>);

    impl Stuck {
        fn open(&self) {
            *self.0.0.lock().expect("not poisoned") = true;
            self.0.1.notify_all();
        }

        fn text(&self) -> String {
            String::from_utf8(self.1.lock().expect("not poisoned").clone()).expect("text")
        }
    }

    impl Write for Stuck {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let open = self.0.0.lock().expect("not poisoned");
            drop(self.0.1.wait_while(open, |open| !*open).expect("not poisoned"));
            self.1.lock().expect("not poisoned").extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn three() -> NonZeroUsize {
        NonZeroUsize::new(3).expect("not zero")
    }

    #[test]
    fn stuck_reader_does_not_block_callers() {
        let pipe = Stuck::default();
        let log = LogQueue::with_capacity(pipe.clone(), three()).expect("a thread");
        for i in 0..100 {
            log.line().write_all(format!("line {i}\n").as_bytes()).expect("never fails");
        }
        // Three are queued, at most one is being written.
        assert!((96..=97).contains(&log.dropped()), "{}", log.dropped());
        assert!(!log.flush(Duration::from_millis(1)), "nothing is written yet");
        pipe.open();
        assert!(log.flush(Duration::from_secs(120)));
        let text = pipe.text();
        assert_eq!(text.lines().count() as u64, 100 - log.dropped(), "{text}");
        assert!(text.starts_with("line 0\n"), "{text}");
    }

    /// A sink that fails until the flag is cleared.
    struct Broken(Arc<AtomicBool>, Sender<Vec<u8>>);

    impl Write for Broken {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if self.0.load(Ordering::SeqCst) {
                return Err(io::ErrorKind::StorageFull.into());
            }
            self.1.send(bytes.to_vec()).expect("the test listens");
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn failed_writes_are_counted_and_the_log_recovers() {
        let (full, (sender, written)) = (Arc::new(AtomicBool::new(true)), channel());
        let log = LogQueue::start(Broken(full.clone(), sender)).expect("a thread");
        for _ in 0..5 {
            log.plain_line("lost");
        }
        assert!(log.flush(Duration::from_secs(120)));
        assert_eq!(log.dropped(), 5);
        full.store(false, Ordering::SeqCst);
        log.plain_line("written");
        assert!(log.flush(Duration::from_secs(120)));
        assert_eq!(log.dropped(), 5);
        drop(log);
        let text: Vec<u8> = written.into_iter().flatten().collect();
        let text = String::from_utf8(text).expect("text");
        assert!(text.ends_with("\nwritten\n") && !text.contains("lost"), "{text:?}");
    }
}
