//! `veiloc worker`: localizes in regions of a map for a gateway.

use std::net::{Ipv4Addr, SocketAddr};
use std::num::{NonZeroU32, NonZeroUsize};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use veiloc_cluster::{ClusterError, Placed, PlacementOptions, RegionShare, Worker, WorkerOptions};
use veiloc_map::MapMemory;
use veiloc_service::ServerError;
use veiloc_service::telemetry::{Traces, WorkerCounts};
use veiloc_service::worker_api::{Signals, hide_panic_messages, probes};

use crate::args::localization_args::{not_negative, positive};
use crate::commands::cluster_args::{ClusterArgs, map_name};
use crate::commands::logger::{LogArgs, Logger};
use crate::commands::map_memory::Memory;
use crate::commands::with_config::run_with_config;
use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::ui::Ui;

/// Hold regions of a published map and localize in them for `veiloc serve --cluster`.
///
/// Fetches its regions, verifies and opens them, and announces them to the gateways on the bus; then follows newly
/// published versions. Stops on SIGINT or SIGTERM: announces that it leaves and finishes the accepted queries; a second
/// signal stops it at once. The log goes to stderr and never contains data of a query. docs/guide/cluster.md describes a cluster.
///
/// Every option may also be set in a file (--config) or in the environment, as for `veiloc serve`.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Settings file (TOML) whose keys are these options; relative paths in it are relative to its folder.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Print the settings and the origin of each value as such a file, and exit.
    #[arg(long)]
    print_config: bool,
    /// NATS servers of the cluster, separated by commas; user and password may precede an `@`.
    #[arg(long, required = true, value_name = "URL[,URL]")]
    // An `Option` although it is required: a file may provide it, and the command line is parsed before the file.
    nats: Option<String>,
    /// Name of the published map.
    #[arg(long, required = true, value_parser = map_name, value_name = "NAME")]
    map: Option<String>,
    #[command(flatten)]
    cluster: ClusterArgs,
    /// Regions to hold: all, 1/3 for the first of three shares, or numbers separated by commas. Every region needs a
    /// worker; several workers may hold the same region.
    #[arg(long, default_value = "all", value_name = "SHARE")]
    regions: RegionShare,
    /// In place of --regions: every region should be held by N workers, and the workers that have this option divide the
    /// regions among them, also when workers join or leave. At least 2, so that a worker may fail. Default: none, --regions
    /// decides.
    #[arg(long, conflicts_with = "regions", value_name = "N")]
    replicas: Option<NonZeroU32>,
    /// Maximum number of regions that this worker takes, with --replicas: as many as fit into its memory. While regions
    /// move, it may hold some more. Default: no limit.
    #[arg(long, requires = "replicas", value_name = "N")]
    max_regions: Option<NonZeroU32>,
    /// Name of this worker, with --replicas; the same after a restart, and another one for each worker of a map. Default: the
    /// name of the machine and the port of --admin-listen.
    #[arg(long, requires = "replicas", value_parser = worker_name, value_name = "NAME")]
    name: Option<String>,
    /// Seconds for which the regions of a worker that left or died wait for it, with --replicas, if another worker has them.
    #[arg(long, default_value_t = 30.0, value_parser = not_negative, value_name = "SECONDS")]
    settle: f64,
    /// Do not hold the index that selects regions; at least one worker must hold it.
    #[arg(long)]
    no_index: bool,
    /// Storage of the region bytes: copied into memory, or memory-mapped; no other program may then write into the
    /// cache.
    #[arg(long, value_enum, default_value_t = Memory::Copied, value_name = "WHERE")]
    map_memory: Memory,
    /// Threads for localization. Default: one per core.
    #[arg(long, value_name = "N")]
    workers: Option<NonZeroUsize>,
    /// Maximum number of queries that wait for a thread; the gateway sends further ones to other workers.
    #[arg(long, default_value = "32", value_name = "N")]
    queue: NonZeroUsize,
    /// Address for probes and metrics, in plain HTTP; only the operator should reach it.
    #[arg(long, default_value_t = SocketAddr::new(Ipv4Addr::LOCALHOST.into(), 8082), value_name = "ADDR:PORT")]
    admin_listen: SocketAddr,
    /// Seconds between two checks for a new manifest.
    #[arg(long, default_value_t = 2.0, value_parser = positive, value_name = "SECONDS")]
    watch: f64,
    /// Seconds for which regions of an older manifest stay loaded after all regions of the new one have workers.
    #[arg(long, default_value_t = 10.0, value_parser = not_negative, value_name = "SECONDS")]
    drain_after: f64,
    /// Seconds that accepted queries may still take after the worker is stopped.
    #[arg(long, default_value_t = 30.0, value_parser = positive, value_name = "SECONDS")]
    grace: f64,
    #[command(flatten)]
    log: LogArgs,
    /// Send spans to the collector at this address, as OTLP over HTTP (`/v1/traces` is appended), for queries whose gateway
    /// sends traces: for example http://127.0.0.1:4318. Default: none.
    #[arg(long, value_name = "URL")]
    otlp: Option<String>,
}

/// Runs the worker with the merged settings of command line, environment and file.
///
/// # Errors
/// [`Failure`], which the caller reports.
pub(crate) fn run(first: &clap::ArgMatches, ui: &Ui) -> Outcome {
    run_with_config("worker", first, ui, |args: &Args, ui| {
        let logger = Logger::start(&args.log, ui.is_quiet())?;
        let outcome = run_worker(args, &logger);
        logger.flush();
        match outcome {
            Err(failure) if logger.is_json() => {
                let (Failure::Refused { report } | Failure::Output { report }) = &failure else {
                    return Err(failure);
                };
                logger.error(report);
                logger.flush();
                Ok(failure.exit())
            }
            outcome => outcome,
        }
    })
}

fn run_worker(args: &Args, logger: &Logger) -> Outcome {
    let source = args.cluster.source()?;
    let mut options = options(args);
    if let Some(url) = &args.otlp {
        let traces = Traces::start(url, "veiloc-worker", env!("CARGO_PKG_VERSION"));
        options.traces = Some(traces.map_err(|source| ServerError::Collector { source })?);
    }
    let counts = WorkerCounts::new(env!("CARGO_PKG_VERSION"), options.threads.get(), options.queue.get());
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    hide_panic_messages();
    let finished = runtime.block_on(async {
        let bus = args.cluster.bus(required_value(args.nats.as_ref()), "veiloc worker").await?;
        let worker = Worker::start(bus, source, options, counts).await?;
        let handle = worker.handle();
        let end = watch::Sender::new(false);
        let (admin, answering) = probes(Arc::new(handle.clone()), args.admin_listen, end.subscribe()).await?;
        let answering = tokio::spawn(answering);
        let signals =
            Signals::new().map_err(|source| ClusterError::System { what: "signal handlers", source })?;
        logger.info(format_args!("probes and metrics on http://{admin}"));
        logger.info(format_args!(
            "holds {} regions and indexes of {}",
            worker.held_count(),
            required_value(args.map.as_ref())
        ));
        let listening = tokio::spawn(signals.handle_signals(handle));
        let finished = worker.run().await;
        listening.abort();
        end.send_replace(true);
        // The task only waits for the message that was just sent.
        let _ = answering.await;
        Ok::<bool, ClusterError>(finished)
    })?;
    // Jobs that do not end are abandoned.
    runtime.shutdown_background();
    if finished {
        logger.info("stopped; all accepted queries were answered");
        return Ok(Exit::Success);
    }
    logger.error(format_args!(
        "stopped before all accepted queries were answered; allow more time with --grace (it was {} s)",
        args.grace
    ));
    Ok(Exit::Refused)
}

/// Returns a required value; settings without it were refused.
fn required_value(required: Option<&String>) -> &str {
    required.map(String::as_str).unwrap_or_default()
}

/// Parses the name of a worker.
fn worker_name(text: &str) -> Result<String, String> {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.:".contains(c);
    if !text.is_empty() && text.len() <= Placed::MAX_NAME && text.chars().all(is_plain) {
        Ok(text.to_owned())
    } else {
        Err(format!("letters, digits, `-`, `_`, `.` and `:` are expected, at most {}", Placed::MAX_NAME))
    }
}

/// The name of the machine, and a port that distinguishes its workers.
fn default_name(port: u16) -> String {
    let of_kernel = std::fs::read_to_string("/proc/sys/kernel/hostname").ok();
    let machine = of_kernel.or_else(|| std::env::var("HOSTNAME").ok()).unwrap_or_default();
    let machine: String = machine.trim().chars().take(Placed::MAX_NAME - 8).filter(char::is_ascii).collect();
    format!("{}:{port}", if machine.is_empty() { "worker" } else { &machine })
}

fn options(args: &Args) -> WorkerOptions {
    let seconds = |s: f64| Duration::from_secs_f64(s.min(86_400.0));
    let mut options = WorkerOptions::new(required_value(args.map.as_ref()));
    options.share = args.regions.clone();
    if let Some(replicas) = args.replicas {
        let name = args.name.clone().unwrap_or_else(|| default_name(args.admin_listen.port()));
        let mut placement = PlacementOptions::new(name, replicas);
        placement.placed.max_regions = args.max_regions;
        placement.settle = seconds(args.settle);
        options.placement = Some(placement);
    }
    options.index = !args.no_index;
    if let Some(workers) = args.workers {
        options.threads = workers;
    }
    options.queue = args.queue;
    options.memory = MapMemory::from(args.map_memory);
    options.watch = seconds(args.watch);
    options.grace = seconds(args.drain_after);
    options.finish = seconds(args.grace);
    options
}
