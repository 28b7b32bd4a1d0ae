//! Log and messages of a long-running command, through one queue.

use std::time::Duration;

use tracing_subscriber::filter::LevelFilter;
use veiloc_service::LogQueue;

/// Maximum time for writing the last lines of the log.
const LAST_LINES: Duration = Duration::from_secs(1);

/// Level and format of the log.
#[derive(clap::Args)]
pub(crate) struct LogArgs {
    /// Log level: off, error, warn, info, debug or trace.
    #[arg(long, default_value = "info", value_name = "LEVEL")]
    pub(crate) log: LevelFilter,
    /// Log one JSON object per line.
    #[arg(long)]
    pub(crate) log_json: bool,
}

/// Messages for people, written through the queue of the log, so that a slow or closed stderr does not block the
/// command. With a JSON log the messages are JSON too.
pub(crate) struct Logger {
    pub(crate) log: LogQueue,
    json: bool,
    quiet: bool,
}

impl Logger {
    /// Starts the log on stderr, through a queue and without colour: logs are read by programs more often than by
    /// people.
    pub(crate) fn start(args: &LogArgs, quiet: bool) -> std::io::Result<Self> {
        let queue = LogQueue::start(std::io::stderr())?;
        let writer = queue.clone();
        let log = tracing_subscriber::fmt()
            .with_max_level(args.log)
            .with_writer(move || writer.line())
            .with_ansi(false)
            .with_target(false)
            // Otherwise it would report its own errors on stderr, and panic if stderr is closed.
            .log_internal_errors(false);
        // Fails only if another subscriber exists already, which then takes precedence.
        let _ = if args.log_json { log.json().try_init() } else { log.try_init() };
        Ok(Self { log: queue, json: args.log_json, quiet })
    }

    pub(crate) fn info(&self, text: impl std::fmt::Display) {
        if self.json {
            tracing::info!("{text}");
        } else if !self.quiet {
            self.log.plain_line(text);
        }
    }

    pub(crate) fn error(&self, text: impl std::fmt::Display) {
        if self.json {
            tracing::error!("{text}");
        } else {
            self.log.plain_line(format_args!("error: {text}"));
        }
    }

    /// Returns whether errors are reported as JSON.
    pub(crate) const fn is_json(&self) -> bool {
        self.json
    }

    /// Flushes the log, with a time limit: a closed stderr must not delay the exit.
    pub(crate) fn flush(&self) {
        self.log.flush(LAST_LINES);
    }
}
