//! Logs the location of panics, never their message, because a message may contain parts of a query (rule L8).
//!
//! The panic payload goes to the panic hook of the process, and the default hook prints it. [`watch`] installs a hook
//! in front of the existing one. It logs file and line. For threads that work for the service
//! ([`mark_service_thread`]) this is all; for other threads the existing hook runs as before.

use std::cell::Cell;
use std::panic::PanicHookInfo;
use std::sync::Once;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::telemetry::RequestId;

static QUIET_PROCESS: AtomicBool = AtomicBool::new(false);

thread_local! {
    static IS_SERVICE_THREAD: Cell<bool> = const { Cell::new(false) };
    static CURRENT_REQUEST: Cell<Option<RequestId>> = const { Cell::new(None) };
}

/// Marks this thread as working for the service: of its panics only the location is logged.
pub(crate) fn mark_service_thread() {
    IS_SERVICE_THREAD.set(true);
}

/// Runs `work` for a request: a panic of this thread is then logged with the request id. Helper threads of the work
/// are not covered.
pub(crate) fn with_request<T>(request: RequestId, work: impl FnOnce() -> T) -> T {
    struct Done;
    impl Drop for Done {
        fn drop(&mut self) {
            CURRENT_REQUEST.set(None);
        }
    }
    CURRENT_REQUEST.set(Some(request));
    let _done = Done;
    work()
}

/// Marks the whole process: panics of all threads are logged by location only, and only through the log, which never
/// blocks.
pub(crate) fn hide_panic_messages() {
    QUIET_PROCESS.store(true, Ordering::Relaxed);
}

/// Installs the hook.
pub(crate) fn watch() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let earlier = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            log_location(info);
            if !IS_SERVICE_THREAD.get() && !QUIET_PROCESS.load(Ordering::Relaxed) {
                earlier(info);
            }
        }));
    });
}

fn log_location(info: &PanicHookInfo<'_>) {
    // `location` is always `Some` in current Rust versions.
    let (file, line) = info.location().map_or(("unknown", 0), |at| (at.file(), at.line()));
    let request = CURRENT_REQUEST.get().map(tracing::field::display);
    tracing::error!(request, file, line, "a thread panicked");
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroUsize;
    use std::process::Command;

    use crate::telemetry::RequestIds;

    use super::with_request;
    use crate::queue::clock::Clock;
    use crate::queue::pool::{JobSpec, Pool};

    /// Panics with a secret message on a thread of the pool.
    fn panic_in_a_job() {
        tracing_subscriber::fmt().with_writer(std::io::stderr).init();
        let pool = Pool::start(NonZeroUsize::MIN, NonZeroUsize::MIN, Clock::default()).expect("threads");
        let spec =
            JobSpec { client: None, rows: 1, is_session: false, limit: std::time::Duration::from_secs(60) };
        let secret = String::from("SECRET") + "WORDS";
        let id = RequestIds::start().expect("random").next();
        let broken = pool
            .submit(spec, move |_| -> u32 { with_request(id, || std::panic::panic_any(secret)) })
            .expect("room");
        assert!(broken.blocking_recv().is_err());
        let other =
            pool.submit(spec, |_| -> u32 { std::panic::panic_any("outside of a request") }).expect("room");
        assert!(other.blocking_recv().is_err());
        assert_eq!(pool.submit(spec, |_| 1).expect("room").blocking_recv(), Ok(1), "the thread goes on");
        pool.finish();
    }

    /// In a separate process, so that its whole output can be checked.
    #[test]
    fn panic_log_has_location_without_message() {
        const CHILD: &str = "VEILOC_SERVER_TEST_PANICS";
        if std::env::var_os(CHILD).is_some() {
            return panic_in_a_job();
        }
        let output = Command::new(std::env::current_exe().expect("this program"))
            .args(["--exact", "telemetry::panics::tests::panic_log_has_location_without_message"])
            .arg("--nocapture")
            .env(CHILD, "1")
            .output()
            .expect("it runs");
        let output_text = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
        assert!(output.status.success() && output_text.contains("1 passed"), "{output_text}");
        let lines: Vec<_> = output_text.lines().filter(|line| line.contains("a thread panicked")).collect();
        assert_eq!(lines.len(), 2, "{output_text}");
        assert!(
            lines.iter().all(|line| line.contains("panics.rs") && line.contains("line=")),
            "{output_text}"
        );
        // The first panic is logged with its request id, and the thread has dropped the id before the second.
        let of_request: Vec<_> = lines.iter().map(|line| line.contains("request=")).collect();
        assert_eq!(of_request, [true, false], "{output_text}");
        assert!(!output_text.contains("SECRETWORDS"), "{output_text}");
    }
}
