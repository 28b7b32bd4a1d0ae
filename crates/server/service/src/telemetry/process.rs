//! Metrics of the process under the standard names of Prometheus (`process_…`).
//!
//! Read from `/proc` at each scrape; empty on other systems.

use std::fmt;

use prometheus_client::collector::Collector;
use prometheus_client::encoding::DescriptorEncoder;

/// Collector that reads the values at each scrape.
#[derive(Debug)]
pub(crate) struct Process;

/// Values of the process. A value that cannot be read is left out.
#[derive(Debug, Default, PartialEq)]
struct Usage {
    resident_bytes: Option<f64>,
    cpu_seconds: Option<f64>,
    open_files: Option<f64>,
    most_open_files: Option<f64>,
    threads: Option<f64>,
    /// Seconds since 1970.
    started: Option<f64>,
}

impl Collector for Process {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> Result<(), fmt::Error> {
        use prometheus_client::encoding::EncodeMetric as _;
        use prometheus_client::metrics::counter::ConstCounter;
        use prometheus_client::metrics::gauge::ConstGauge;
        let usage = linux::usage();
        if let Some(seconds) = usage.cpu_seconds {
            let counter = ConstCounter::new(seconds);
            let help = "Processor time, in user and system mode";
            counter.encode(encoder.encode_descriptor(
                "process_cpu_seconds",
                help,
                None,
                counter.metric_type(),
            )?)?;
        }
        for (name, help, value) in [
            ("process_resident_memory_bytes", "Memory the process occupies", usage.resident_bytes),
            ("process_open_fds", "Open file descriptors, connections included", usage.open_files),
            ("process_max_fds", "Most file descriptors that may be open", usage.most_open_files),
            ("process_threads", "Threads", usage.threads),
            ("process_start_time_seconds", "When the process began, seconds since 1970", usage.started),
        ] {
            let Some(value) = value else { continue };
            let gauge = ConstGauge::new(value);
            gauge.encode(encoder.encode_descriptor(name, help, None, gauge.metric_type())?)?;
        }
        Ok(())
    }
}

#[cfg(not(target_os = "linux"))]
mod linux {
    pub(super) fn usage() -> super::Usage {
        super::Usage::default()
    }
}

#[cfg(target_os = "linux")]
mod linux {
    use super::Usage;

    pub(super) fn usage() -> Usage {
        let read = |path: &str| std::fs::read_to_string(path).ok();
        let ticks = rustix::param::clock_ticks_per_second() as f64;
        let (stat, boot) = (read("/proc/self/stat"), read("/proc/stat"));
        let stat = stat.as_deref().and_then(stat_fields);
        let number = |i: usize| stat.as_ref()?.get(i)?.parse::<f64>().ok();
        Usage {
            resident_bytes: number(RESIDENT_PAGES).map(|pages| pages * rustix::param::page_size() as f64),
            cpu_seconds: number(USER).zip(number(SYSTEM)).map(|(user, system)| (user + system) / ticks),
            // The directory handle of this listing is one of them.
            open_files: std::fs::read_dir("/proc/self/fd").ok().map(|all| all.count() as f64 - 1.0),
            most_open_files: read("/proc/self/limits").as_deref().and_then(most_open_files),
            threads: number(THREADS),
            started: number(STARTED).zip(boot.as_deref().and_then(booted)).map(|(t, boot)| boot + t / ticks),
        }
    }

    // Fields of `/proc/PID/stat` behind the program name, counted from 0 (proc_pid_stat(5) counts from 3).
    const USER: usize = 11;
    const SYSTEM: usize = 12;
    const THREADS: usize = 17;
    const STARTED: usize = 19;
    const RESIDENT_PAGES: usize = 21;

    /// Fields behind the program name, which may contain spaces and brackets.
    pub(super) fn stat_fields(stat: &str) -> Option<Vec<&str>> {
        Some(stat.rsplit_once(')')?.1.split_whitespace().collect())
    }

    /// The soft limit; infinite if there is none.
    pub(super) fn most_open_files(limits: &str) -> Option<f64> {
        let line = limits.lines().find_map(|line| line.strip_prefix("Max open files"))?;
        match line.split_whitespace().next()? {
            "unlimited" => Some(f64::INFINITY),
            number => number.parse().ok(),
        }
    }

    /// Boot time, seconds since 1970.
    fn booted(stat: &str) -> Option<f64> {
        stat.lines().find_map(|line| line.strip_prefix("btime "))?.trim().parse().ok()
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use std::time::{SystemTime, UNIX_EPOCH};

    use super::*;

    #[test]
    fn proc_files_are_parsed() {
        let fields = linux::stat_fields("7 (a ) b) S 1 2 3").expect("fields");
        assert_eq!(fields, ["S", "1", "2", "3"]);
        let limits = "Limit    Soft Limit   Hard Limit  Units\nMax open files    1024    524288   files\n";
        assert_eq!(linux::most_open_files(limits), Some(1024.0));
        assert_eq!(linux::most_open_files("Max open files  unlimited  unlimited files"), Some(f64::INFINITY));
        assert_eq!(linux::most_open_files("nothing"), None);
    }

    /// The values follow what they measure.
    #[test]
    fn values_belong_to_this_process() {
        let before = linux::usage();
        let now = SystemTime::now().duration_since(UNIX_EPOCH).expect("after 1970").as_secs_f64();
        let started = before.started.expect("a start");
        assert!(started <= now + 1.0 && now - started < 86_400.0, "started {started}, now {now}");
        let memory = vec![1_u8; 64 << 20];
        let files: Vec<_> = (0..100).map(|_| std::fs::File::open("/proc/self/stat").expect("open")).collect();
        // Other tests of this program may open and close a few files.
        let mut sum = 0_u64;
        let after = loop {
            sum = sum.wrapping_add(memory.iter().map(|b| u64::from(*b)).sum::<u64>());
            // Repeat until the processor time increases: the system counts in ticks.
            let after = linux::usage();
            if after.cpu_seconds > before.cpu_seconds {
                break after;
            }
        };
        assert!(sum > 0);
        let rise = |f: fn(&Usage) -> Option<f64>| f(&after).expect("there") - f(&before).expect("there");
        assert!(rise(|u| u.resident_bytes) > 48e6, "{before:?} {after:?}");
        assert!(rise(|u| u.cpu_seconds) > 0.0, "{before:?} {after:?}");
        assert!(rise(|u| u.open_files) > 50.0, "{before:?} {after:?}");
        assert!(after.open_files < after.most_open_files && after.threads > Some(0.0), "{after:?}");
        drop((files, memory));
    }
}
