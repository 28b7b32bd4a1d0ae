//! Progress of long work: a bar on a terminal, occasional lines in a log.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// A line for each tenth of a stage, but at least this time after the line before.
const MIN_INTERVAL: Duration = Duration::from_secs(1);
/// A line after this time, even with little progress.
const MAX_INTERVAL: Duration = Duration::from_secs(10);

/// Shorter remaining times are not printed, seconds.
const MIN_REMAINING: f64 = 5.0;

/// One stage of work with a known number of steps.
pub(crate) struct Stage(StageOutput);

/// Form of the output.
enum StageOutput {
    /// No output.
    Silent,
    /// A bar on a terminal.
    Bar(ProgressBar),
    /// Lines on a stderr that is not a terminal.
    Lines(Mutex<Lines>),
}

impl Stage {
    /// Returns a stage without output.
    pub(crate) const fn silent() -> Self {
        Self(StageOutput::Silent)
    }

    /// Returns a bar of `total` steps.
    pub(crate) fn bar(name: &str, total: u64) -> Self {
        let style = ProgressStyle::with_template("{msg:28} {wide_bar:.cyan/dim} {pos}/{len} {eta:>4}")
            .unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar = ProgressBar::new(total).with_style(style).with_message(name.to_owned());
        bar.enable_steady_tick(Duration::from_millis(200));
        Self(StageOutput::Bar(bar))
    }

    /// Prints lines on stderr, the first at once.
    pub(crate) fn lines(name: &str, total: u64) -> Self {
        let start = Instant::now();
        let lines = Lines { name: name.to_owned(), total, done: 0, tenth: 0, start, last: start };
        print_line(&lines.text(start));
        Self(StageOutput::Lines(Mutex::new(lines)))
    }

    /// Adds finished steps.
    pub(crate) fn advance(&self, steps: u64) {
        self.update(|bar| bar.inc(steps), |lines| lines.done += steps);
    }

    /// Sets the number of finished steps and the total.
    pub(crate) fn set_position(&self, done: u64, total: u64) {
        self.update(
            |bar| {
                bar.set_length(total);
                bar.set_position(done);
            },
            |lines| (lines.done, lines.total) = (done, total),
        );
    }

    fn update(&self, of_bar: impl FnOnce(&ProgressBar), of_lines: impl FnOnce(&mut Lines)) {
        match &self.0 {
            StageOutput::Silent => {}
            StageOutput::Bar(bar) => of_bar(bar),
            StageOutput::Lines(lines) => {
                let mut lines = lines.lock().unwrap_or_else(PoisonError::into_inner);
                of_lines(&mut lines);
                if let Some(text) = lines.due(Instant::now()) {
                    print_line(&text);
                }
            }
        }
    }

    /// Hides the bar while something is printed.
    pub(crate) fn suspend<T>(&self, act: impl FnOnce() -> T) -> T {
        match &self.0 {
            StageOutput::Bar(bar) => bar.suspend(act),
            StageOutput::Silent | StageOutput::Lines(_) => act(),
        }
    }

    /// Ends the stage and removes its bar.
    pub(crate) fn finish(&self) {
        if let StageOutput::Bar(bar) = &self.0 {
            bar.finish_and_clear();
        }
    }
}

/// Progress of a stage that prints lines.
struct Lines {
    name: String,
    total: u64,
    done: u64,
    /// Tenths of the stage that were printed.
    tenth: u64,
    start: Instant,
    last: Instant,
}

impl Lines {
    /// Returns the next line if it is due.
    fn due(&mut self, now: Instant) -> Option<String> {
        let tenth = (10 * self.done).checked_div(self.total).unwrap_or(0);
        let since = now.saturating_duration_since(self.last);
        if since < MIN_INTERVAL || (tenth <= self.tenth && since < MAX_INTERVAL) {
            return None;
        }
        (self.tenth, self.last) = (tenth, now);
        Some(self.text(now))
    }

    fn text(&self, now: Instant) -> String {
        match self.total {
            0 => self.name.clone(),
            total => format!("{} {}/{total}{}", self.name, self.done, self.remaining(now)),
        }
    }

    /// The time that the other steps will take if they are as long as those before; empty if it is short.
    fn remaining(&self, now: Instant) -> String {
        let rest = self.total.saturating_sub(self.done) as f64;
        let seconds = now.saturating_duration_since(self.start).as_secs_f64() * rest / self.done as f64;
        match seconds {
            s if !s.is_finite() || s < MIN_REMAINING => String::new(),
            s if s < 90.0 => format!(", about {s:.0} s left"),
            s => format!(", about {:.0} min left", s / 60.0),
        }
    }
}

/// Prints a line on stderr; a failure to do so is ignored.
fn print_line(text: &str) {
    use std::io::Write as _;
    let _ = writeln!(std::io::stderr(), "{text}");
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(total: u64) -> (Lines, Instant) {
        let start = Instant::now();
        (
            Lines { name: "Extracting features".to_owned(), total, done: 0, tenth: 0, start, last: start },
            start,
        )
    }

    /// Returns the lines that a stage of 900 steps at `ms` milliseconds each prints.
    fn printed_lines(ms: u64) -> Vec<String> {
        let (mut lines, start) = lines(900);
        let step = |i: u64| (i, start + Duration::from_millis(i * ms));
        (1..=900)
            .map(step)
            .filter_map(|(done, now)| {
                lines.done = done;
                lines.due(now)
            })
            .collect()
    }

    #[test]
    fn fast_stages_print_tenths_and_slow_stages_every_ten_seconds() {
        assert!(printed_lines(1).is_empty(), "all in 0.9 s: the first line is enough");
        let tenths = printed_lines(20);
        assert_eq!(tenths.len(), 10);
        assert_eq!(tenths[0], "Extracting features 90/900, about 16 s left");
        assert_eq!(tenths[9], "Extracting features 900/900");
        let slow = printed_lines(1000);
        assert_eq!(slow.len(), 90, "here every tenth falls on a multiple of ten seconds");
        assert_eq!(slow[0], "Extracting features 10/900, about 15 min left");
        assert_eq!(slow[84], "Extracting features 850/900, about 50 s left");
    }

    #[test]
    fn stages_without_total_print_by_time() {
        let (mut lines, start) = lines(0);
        lines.done = 5;
        assert_eq!(lines.due(start + Duration::from_secs(9)), None);
        assert_eq!(lines.due(start + Duration::from_secs(10)).as_deref(), Some("Extracting features"));
    }
}
