//! `veiloc serve`: maps as a service.

use std::net::SocketAddr;
use std::num::{NonZeroU32, NonZeroUsize};
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use tracing_subscriber::filter::LevelFilter;
use veiloc_server::{BadGeoFrame, GeoFrame, MapSource, RateLimit, ServerOptions, TlsFiles, run_until_signal};

use crate::commands::localization_args::{MatchArgs, PoseArgs, positive};
use crate::exit::{Exit, Failure, Outcome};
use crate::ui::Ui;

/// Serve maps: sealed queries in over HTTP, poses out.
///
/// Stops on SIGINT or SIGTERM, after answering what it accepted. Map, token and certificate files may be replaced (by
/// renaming others over them) while it runs; SIGHUP makes it read them at once. The log goes to stderr and never holds
/// anything of a query. Addresses, answers and the file of tokens are described in docs/service.md.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// A map and the name it is served under; several may be given.
    #[arg(long = "map", required = true, value_name = "NAME=FILE")]
    maps: Vec<NamedMap>,
    /// Where a map lies on Earth, so that poses can be told as OGC GeoPose: degrees, metres above the WGS 84 ellipsoid,
    /// the quaternion that turns map axes into east, north, up there, and metres a map unit (1).
    #[arg(long = "geo", value_name = "NAME=LAT,LON,HEIGHT,QW,QX,QY,QZ[,METRES]", allow_hyphen_values = true)]
    geo: Vec<NamedFrame>,
    /// Where to listen; port 0 for any free one.
    #[arg(long, default_value = "127.0.0.1:8080", value_name = "ADDR:PORT")]
    listen: SocketAddr,
    /// Certificate chain, PEM. Without it plain HTTP is spoken, on loopback only.
    #[arg(long, requires = "key", value_name = "FILE")]
    cert: Option<PathBuf>,
    /// Private key of the certificate, PEM.
    #[arg(long, requires = "cert", value_name = "FILE")]
    key: Option<PathBuf>,
    /// Speak plain HTTP beyond loopback: for a proxy in front that does TLS.
    #[arg(long)]
    insecure_http: bool,
    /// Who may ask, a line each: a name, the SHA-256 of the token, and `operator` if it may read the metrics.
    #[arg(long, value_name = "FILE")]
    tokens: Option<PathBuf>,
    /// Let everybody ask, beyond loopback too.
    #[arg(long, conflicts_with = "tokens")]
    allow_anonymous: bool,
    /// Requests per second for each token; without tokens, for all together.
    #[arg(long, default_value = "20", value_name = "N")]
    rate: NonZeroU32,
    /// Requests at once after a pause. Default: as many as in a second.
    #[arg(long, value_name = "N")]
    burst: Option<NonZeroU32>,
    /// Threads that localize. Default: one a core.
    #[arg(long, value_name = "N")]
    workers: Option<NonZeroUsize>,
    /// Queries that may wait for a worker; one more is refused with 503.
    #[arg(long, default_value = "32", value_name = "N")]
    queue: NonZeroUsize,
    /// Connections at a time.
    #[arg(long, default_value = "1024", value_name = "N")]
    connections: NonZeroUsize,
    /// Seconds a query may take from its last byte to its pose, waiting included.
    #[arg(long, default_value_t = 30.0, value_parser = positive, value_name = "SECONDS")]
    request_timeout: f64,
    /// Seconds a query's body may take to arrive.
    #[arg(long, default_value_t = 15.0, value_parser = positive, value_name = "SECONDS")]
    body_timeout: f64,
    /// Seconds that what was accepted may still take when the service is stopped.
    #[arg(long, default_value_t = 30.0, value_parser = positive, value_name = "SECONDS")]
    grace: f64,
    /// Seconds between two looks whether files were replaced.
    #[arg(long, default_value_t = 2.0, value_parser = positive, value_name = "SECONDS")]
    watch: f64,
    /// How much to log: off, error, warn, info, debug or trace.
    #[arg(long, default_value = "info", value_name = "LEVEL")]
    log: LevelFilter,
    /// Log one JSON object a line.
    #[arg(long)]
    log_json: bool,
    #[command(flatten)]
    pose: PoseArgs,
    #[command(flatten)]
    matching: MatchArgs,
}

/// `NAME=FILE`.
#[derive(Clone)]
struct NamedMap {
    name: String,
    path: PathBuf,
}

impl FromStr for NamedMap {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text.split_once('=') {
            Some((name, path)) if !name.is_empty() && !path.is_empty() => {
                Ok(Self { name: name.to_owned(), path: path.into() })
            }
            _ => Err("NAME=FILE is expected, for example lobby=lobby.vmap".to_owned()),
        }
    }
}

/// `NAME=LAT,…`.
#[derive(Clone)]
struct NamedFrame {
    name: String,
    frame: GeoFrame,
}

impl FromStr for NamedFrame {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (name, frame) = text.split_once('=').ok_or("NAME=LAT,LON,… is expected")?;
        let frame = frame.parse().map_err(|e: BadGeoFrame| e.to_string())?;
        Ok(Self { name: name.to_owned(), frame })
    }
}

pub(crate) fn run(args: &Args, ui: &Ui) -> Outcome {
    start_log(args);
    let options = options(args)?;
    let scheme = if options.tls.is_some() { "https" } else { "http" };
    let names: Vec<String> = args.maps.iter().map(|map| map.name.clone()).collect();
    let abandoned = run_until_signal(options, |address| {
        ui.say(format!("serving {} on {scheme}://{address}", names.join(", ")));
    })?;
    if abandoned > 0 {
        return Err(Failure::with_help(
            format!("{abandoned} connections did not end within {} s and were given up", args.grace),
            "give more time with --grace, if these were requests that mattered",
        ));
    }
    ui.say("stopped; all that was accepted was answered");
    Ok(Exit::Success)
}

fn options(args: &Args) -> Result<ServerOptions, Failure> {
    let geo = |name: &str| args.geo.iter().find(|g| g.name == name).map(|g| g.frame.clone());
    if let Some(stray) = args.geo.iter().find(|g| args.maps.iter().all(|map| map.name != g.name)) {
        return Err(Failure::with_help(
            format!("--geo {}: no map has this name", stray.name),
            "use the name given with --map",
        ));
    }
    let source =
        |map: &NamedMap| MapSource { name: map.name.clone(), path: map.path.clone(), geo: geo(&map.name) };
    let mut options = ServerOptions::new(args.maps.iter().map(source).collect());
    options.listen = args.listen;
    if let (Some(cert), Some(key)) = (&args.cert, &args.key) {
        options.tls = Some(TlsFiles { cert: cert.clone(), key: key.clone() });
    }
    options.insecure_http = args.insecure_http;
    options.tokens.clone_from(&args.tokens);
    options.allow_anonymous = args.allow_anonymous;
    options.rate = RateLimit { per_second: args.rate, burst: args.burst.unwrap_or(args.rate) };
    if let Some(workers) = args.workers {
        options.workers = workers;
    }
    options.queue = args.queue;
    options.connections = args.connections;
    let seconds = |s: f64| Duration::from_secs_f64(s.min(86_400.0));
    options.timeouts.localize = seconds(args.request_timeout);
    options.timeouts.body = seconds(args.body_timeout);
    options.timeouts.grace = seconds(args.grace);
    options.watch = Some(seconds(args.watch));
    options.localize = args.matching.options(&args.pose);
    Ok(options)
}

/// To stderr, without colour: logs are read by programs more often than by people.
fn start_log(args: &Args) {
    let log = tracing_subscriber::fmt()
        .with_max_level(args.log)
        .with_writer(std::io::stderr)
        .with_ansi(false)
        .with_target(false);
    // Fails only when something logs already, which then is what was meant.
    let _ = if args.log_json { log.json().try_init() } else { log.try_init() };
}
