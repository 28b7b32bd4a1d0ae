//! Where a panic happened, for the log; never what it said, because that may hold something of a query (rule L8).
//!
//! What a panic says, its payload, goes to the process's panic hook, and the default one prints it. [`watch`] puts a
//! hook before the one there is: it logs file and line, and for threads that work for the service ([`mark`]) that is all
//! there is. For other threads the earlier hook is called as if nothing had been.

use std::cell::Cell;
use std::panic::PanicHookInfo;
use std::sync::Once;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::telemetry::RequestId;

static OWN_PROCESS: AtomicBool = AtomicBool::new(false);

thread_local! {
    static OURS: Cell<bool> = const { Cell::new(false) };
    static REQUEST: Cell<Option<RequestId>> = const { Cell::new(None) };
}

/// This thread works for the service: of its panics only the place is told.
pub fn mark() {
    OURS.set(true);
}

/// Does something for a request: a panic of this thread meanwhile is told with its name. Threads that work for it beside
/// this one do not know it.
pub fn during<T>(request: RequestId, work: impl FnOnce() -> T) -> T {
    struct Done;
    impl Drop for Done {
        fn drop(&mut self) {
            REQUEST.set(None);
        }
    }
    REQUEST.set(Some(request));
    let _done = Done;
    work()
}

/// The whole process works for the service: of no panic more than the place is told, and never but through the log, which
/// does not block when nobody reads it.
pub fn own_process() {
    OWN_PROCESS.store(true, Ordering::Relaxed);
}

/// Logs the place of every panic of the process from now on.
pub(crate) fn watch() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let earlier = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            tell_place(info);
            if !OURS.get() && !OWN_PROCESS.load(Ordering::Relaxed) {
                earlier(info);
            }
        }));
    });
}

fn tell_place(info: &PanicHookInfo<'_>) {
    // `location` is always there today.
    let (file, line) = info.location().map_or(("unknown", 0), |place| (place.file(), place.line()));
    let request = REQUEST.get().map(tracing::field::display);
    tracing::error!(request, file, line, "a thread panicked");
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroUsize;
    use std::process::Command;

    use crate::telemetry::RequestIds;

    use super::during;
    use crate::clock::Clock;
    use crate::pool::{Order, Pool};

    /// Says in a panic what nobody may read, on a thread of the pool.
    fn break_a_job() {
        tracing_subscriber::fmt().with_writer(std::io::stderr).init();
        let pool = Pool::start(NonZeroUsize::MIN, NonZeroUsize::MIN, Clock::default()).expect("threads");
        let order = Order { who: None, rows: 1, limit: std::time::Duration::from_secs(60) };
        let secret = String::from("SECRET") + "WORDS";
        let id = RequestIds::start().expect("random").next();
        let broken = pool
            .submit(order, move |_| -> u32 { during(id, || std::panic::panic_any(secret)) })
            .expect("room");
        assert!(broken.blocking_recv().is_err());
        let other = pool.submit(order, |_| -> u32 { std::panic::panic_any("of no request") }).expect("room");
        assert!(other.blocking_recv().is_err());
        assert_eq!(pool.submit(order, |_| 1).expect("room").blocking_recv(), Ok(1), "the thread goes on");
        pool.finish();
    }

    /// In a process of its own, so that all it ever wrote can be read.
    #[test]
    fn a_panicking_job_logs_its_place_and_not_its_message() {
        const CHILD: &str = "VEILOC_SERVER_TEST_PANICS";
        if std::env::var_os(CHILD).is_some() {
            return break_a_job();
        }
        let output = Command::new(std::env::current_exe().expect("this program"))
            .args(["--exact", "panics::tests::a_panicking_job_logs_its_place_and_not_its_message"])
            .arg("--nocapture")
            .env(CHILD, "1")
            .output()
            .expect("it runs");
        let said = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
        assert!(output.status.success() && said.contains("1 passed"), "{said}");
        let lines: Vec<_> = said.lines().filter(|line| line.contains("a thread panicked")).collect();
        assert_eq!(lines.len(), 2, "{said}");
        assert!(lines.iter().all(|line| line.contains("panics.rs") && line.contains("line=")), "{said}");
        // The first is told with the name of its request, and the thread has forgotten it by the second.
        let of_request: Vec<_> = lines.iter().map(|line| line.contains("request=")).collect();
        assert_eq!(of_request, [true, false], "{said}");
        assert!(!said.contains("SECRETWORDS"), "{said}");
    }
}
