//! A log that keeps nobody waiting: lines go into a queue of fixed length, and one thread of its own writes them.
//!
//! A write to stderr blocks while nobody reads the pipe behind it, and fails when its reader has gone or the disk is
//! full. Neither may hold up a request, nor the end of the program. So whoever logs only hands its line over; a line that
//! does not fit, or that could not be written, is counted ([`LogQueue::dropped`], `veiloc_log_lines_dropped_total`), and
//! the log itself tells how many are missing as soon as it can be written again.

use std::fmt;
use std::io::{self, Write};
use std::num::NonZeroUsize;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use prometheus_client::metrics::counter::Counter;

use crate::telemetry::waiting::{Sender, Waiting, queue};

/// Lines that may wait to be written: a second of the busiest service, about a megabyte.
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
    /// The system's, when there is no thread to be had.
    pub fn start(sink: impl Write + Send + 'static) -> io::Result<Self> {
        Self::with_capacity(sink, LINES)
    }

    fn with_capacity(sink: impl Write + Send + 'static, lines: NonZeroUsize) -> io::Result<Self> {
        let (sender, receiver) = queue(lines);
        let dropped = Counter::default();
        let writer = Writer { sink, dropped: dropped.clone(), told: 0, torn: false };
        std::thread::Builder::new().name("log".to_owned()).spawn(move || writer.run(&receiver))?;
        Ok(Self { sender, dropped })
    }

    /// Where a line is written to, whole in one call, as `tracing_subscriber` does. Never blocks and never fails.
    pub fn line(&self) -> LogLine {
        LogLine(self.clone())
    }

    /// Hands over a line that is not from the log.
    pub fn say(&self, text: impl fmt::Display) {
        self.hand_over(format!("{text}\n").into_bytes());
    }

    /// Lines that were not written, so far.
    pub fn dropped(&self) -> u64 {
        self.dropped.get()
    }

    /// The count of dropped lines, as the metrics show it.
    pub(crate) fn dropped_counter(&self) -> Counter {
        self.dropped.clone()
    }

    /// Waits until everything handed over so far is written, no longer than `patience`. Whether it was.
    pub fn flush(&self, patience: Duration) -> bool {
        self.sender.flush(patience)
    }

    fn hand_over(&self, line: Vec<u8>) {
        if !self.sender.hand_over(line) {
            self.dropped.inc();
        }
    }
}

/// Takes one line.
#[derive(Debug)]
pub struct LogLine(LogQueue);

impl Write for LogLine {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        self.0.hand_over(line.to_vec());
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

struct Writer<W> {
    sink: W,
    dropped: Counter,
    /// Dropped lines that the log has told of.
    told: u64,
    /// Whether the last write may have left a part of a line.
    torn: bool,
}

/// How long the log has to be quiet before it tells what is missing: not in the middle of what drops lines.
const QUIET: Duration = Duration::from_millis(200);

impl<W: Write> Writer<W> {
    fn run(mut self, messages: &Receiver<Waiting<Vec<u8>>>) {
        loop {
            match messages.recv_timeout(QUIET) {
                Ok(Waiting::Item(line)) => self.write(&line),
                Ok(Waiting::Flush(flushed)) => flushed.tell(),
                Err(RecvTimeoutError::Timeout) => self.tell_dropped(),
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

    /// Through the log's own door, so that it has the log's own form. That line may be dropped too, and is told then.
    fn tell_dropped(&mut self) {
        let dropped = self.dropped.get();
        if dropped > self.told && !self.torn {
            tracing::warn!(
                lines = dropped - self.told,
                "log lines were dropped: what reads the log is too slow"
            );
            self.told = dropped;
        } else if self.torn && self.sink.write_all(b"\n").is_ok() {
            // Written again at last: told next time.
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

    /// A pipe that nobody reads until it is opened.
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
    fn a_pipe_nobody_reads_holds_nobody_up() {
        let pipe = Stuck::default();
        let log = LogQueue::with_capacity(pipe.clone(), three()).expect("a thread");
        for i in 0..100 {
            log.line().write_all(format!("line {i}\n").as_bytes()).expect("never fails");
        }
        // Three wait, one is being written at most.
        assert!((96..=97).contains(&log.dropped()), "{}", log.dropped());
        assert!(!log.flush(Duration::from_millis(1)), "nothing is written yet");
        pipe.open();
        assert!(log.flush(Duration::from_secs(120)));
        let text = pipe.text();
        assert_eq!(text.lines().count() as u64, 100 - log.dropped(), "{text}");
        assert!(text.starts_with("line 0\n"), "{text}");
    }

    /// A reader that has gone, or a full disk, and later not any more.
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
    fn what_cannot_be_written_is_counted_and_the_log_goes_on() {
        let (full, (sender, written)) = (Arc::new(AtomicBool::new(true)), channel());
        let log = LogQueue::start(Broken(full.clone(), sender)).expect("a thread");
        for _ in 0..5 {
            log.say("lost");
        }
        assert!(log.flush(Duration::from_secs(120)));
        assert_eq!(log.dropped(), 5);
        full.store(false, Ordering::SeqCst);
        log.say("kept");
        assert!(log.flush(Duration::from_secs(120)));
        assert_eq!(log.dropped(), 5);
        drop(log);
        let text: Vec<u8> = written.into_iter().flatten().collect();
        let text = String::from_utf8(text).expect("text");
        assert!(text.ends_with("\nkept\n") && !text.contains("lost"), "{text:?}");
    }
}
