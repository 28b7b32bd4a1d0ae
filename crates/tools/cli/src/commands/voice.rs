//! The log of a command that runs for long, and what it says to people, on one road.

use std::time::Duration;

use tracing_subscriber::filter::LevelFilter;
use veiloc_service::LogQueue;

/// How long the last lines of the log may take.
const LAST_LINES: Duration = Duration::from_secs(1);

/// What is logged, and how.
#[derive(clap::Args)]
pub(crate) struct LogArgs {
    /// How much to log: off, error, warn, info, debug or trace.
    #[arg(long, default_value = "info", value_name = "LEVEL")]
    pub(crate) log: LevelFilter,
    /// Log one JSON object a line.
    #[arg(long)]
    pub(crate) log_json: bool,
}

/// Talk for people, on the road of the log, so that a reader who is slow or gone holds nothing up. In a log of JSON it
/// is JSON too.
pub(crate) struct Voice {
    pub(crate) log: LogQueue,
    json: bool,
    quiet: bool,
}

impl Voice {
    /// Starts the log, to stderr by way of a queue, without colour: logs are read by programs more often than by people.
    pub(crate) fn start(args: &LogArgs, quiet: bool) -> std::io::Result<Self> {
        let queue = LogQueue::start(std::io::stderr())?;
        let writer = queue.clone();
        let log = tracing_subscriber::fmt()
            .with_max_level(args.log)
            .with_writer(move || writer.line())
            .with_ansi(false)
            .with_target(false)
            // Else it would tell of its own errors on stderr, and panic when that is gone.
            .log_internal_errors(false);
        // Fails only when something logs already, which then is what was meant.
        let _ = if args.log_json { log.json().try_init() } else { log.try_init() };
        Ok(Self { log: queue, json: args.log_json, quiet })
    }

    pub(crate) fn say(&self, text: impl std::fmt::Display) {
        if self.json {
            tracing::info!("{text}");
        } else if !self.quiet {
            self.log.say(text);
        }
    }

    pub(crate) fn complain(&self, text: impl std::fmt::Display) {
        if self.json {
            tracing::error!("{text}");
        } else {
            self.log.say(format_args!("error: {text}"));
        }
    }

    /// Whether errors are told as JSON.
    pub(crate) const fn is_json(&self) -> bool {
        self.json
    }

    /// Where nobody reads the log the end must not wait for it.
    pub(crate) fn end(&self) {
        self.log.flush(LAST_LINES);
    }
}
