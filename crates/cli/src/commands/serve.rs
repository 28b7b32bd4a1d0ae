//! `veiloc serve`: the HTTP service.

use std::net::SocketAddr;
use std::num::{NonZeroU32, NonZeroUsize};
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use veiloc_service::{
    CorsOrigin, GeoReference, ListenAddress, MapSource, RateLimit, ServerOptions, ShutdownSummary, TlsFiles,
    run_prepared,
};

use crate::args::localization_args::{not_negative, positive};
use crate::commands::logger::{LogArgs, Logger};
use crate::commands::map_memory::Memory;
use crate::commands::page_args::{PageConfig, page};
#[cfg(feature = "cluster")]
use crate::commands::store_args::StoreArgs;
use crate::commands::with_config::run_with_config;
use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::ui::Ui;

/// Serve maps over HTTP: sealed queries in, poses out.
///
/// Stops on SIGINT or SIGTERM after answering the accepted requests; a second signal stops it at once. Map, token and
/// certificate files may be replaced (by renaming another file over them) while it runs; SIGHUP makes it read them at
/// once. The log goes to stderr and never contains data of a query. Endpoints, responses and the token file are
/// described in docs/reference/http.md.
///
/// Every option may also be set in a file (--config), where `drain-delay = 5` is `--drain-delay 5`, or in the
/// environment as VEILOC_DRAIN_DELAY. The environment overrides the file, and the command line overrides both. An
/// option that may be given several times takes a list in the file, and values separated by `;` in the environment.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Settings file (TOML) whose keys are these options; relative paths in it are relative to its folder.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Print the settings and the origin of each value as such a file, and exit.
    #[arg(long)]
    print_config: bool,
    /// A map and the name under which it is served; may be given several times.
    #[arg(long = "map", required_unless_present_any = ["folder", "store"], value_name = "NAME=FILE")]
    maps: Vec<NamedMap>,
    /// Folder whose files NAME.vmap are served as NAME; added and removed files are noticed.
    #[arg(long = "maps", value_name = "DIR")]
    folder: Option<PathBuf>,
    /// Where a map is on earth, for `POST /geopose`: latitude and longitude of its origin (degrees, WGS 84), metres above the
    /// ellipsoid and, if its x axis is not east, `,DEGREES` from there, counter-clockwise. Its z is up and its unit the
    /// metre, as after `map align --gps`; may be given several times. Default: none
    #[arg(long, value_name = "NAME=LAT,LON,H")]
    geo_reference: Vec<GeoReference>,
    /// Give devices the packs of the maps (`/v1/maps/NAME/pack`), with which they send only what the place knows, or points
    /// instead of descriptors. A pack shows what the place looks like, without where (docs/guide/pack.md). Default: no packs.
    #[arg(long)]
    packs: bool,
    /// Storage of the map bytes: copied into memory (safe against changes of the file), or memory-mapped; a mapped file
    /// must not be written or truncated while it is served.
    #[arg(long, value_enum, default_value_t = Memory::Copied, value_name = "WHERE")]
    map_memory: Memory,
    #[cfg(feature = "cluster")]
    #[command(flatten)]
    from_store: StoreArgs,
    /// Object store of published maps (needs the cargo feature `cluster`).
    #[cfg(not(feature = "cluster"))]
    #[arg(long, hide = true, value_name = "URL")]
    store: Option<String>,
    /// Address with a port (0 for any free one) or a Unix socket to listen on; may be given several times.
    #[arg(long, default_value = "127.0.0.1:8080", value_name = "ADDR:PORT|unix:PATH")]
    listen: Vec<ListenAddress>,
    /// File mode of Unix sockets; it decides who may connect.
    #[arg(long, default_value = "660", value_parser = mode, value_name = "OCTAL")]
    socket_mode: Mode,
    /// Address for probes and metrics, in plain HTTP without token; only the operator should reach it. Default: the
    /// next port on loopback.
    #[arg(long, value_name = "ADDR:PORT")]
    admin_listen: Option<SocketAddr>,
    /// Certificate chain, PEM. Without it the service uses plain HTTP, on loopback only.
    #[arg(long, requires = "key", value_name = "FILE")]
    cert: Option<PathBuf>,
    /// Private key of the certificate, PEM.
    #[arg(long, requires = "cert", value_name = "FILE")]
    key: Option<PathBuf>,
    /// CA certificates for client authentication (mTLS), PEM. A client without a certificate of these CAs fails the TLS
    /// handshake; other clients still need a token.
    #[arg(long, requires = "cert", value_name = "FILE")]
    client_ca: Option<PathBuf>,
    /// Use plain HTTP beyond loopback: for a reverse proxy that terminates TLS.
    #[arg(long)]
    insecure_http: bool,
    /// Origin whose pages may send requests from a browser (CORS); may be given several times. Default: none.
    #[arg(long, value_name = "https://HOST")]
    cors_origin: Vec<CorsOrigin>,
    /// Token file, as written by `veiloc token`; only its tokens may send requests.
    #[arg(long, value_name = "FILE")]
    tokens: Option<PathBuf>,
    /// Seconds for which the last valid tokens are accepted after their file is removed, emptied or damaged; afterwards
    /// all requests are refused.
    #[arg(long, default_value_t = 300.0, value_parser = not_negative, value_name = "SECONDS")]
    tokens_max_stale: f64,
    /// Accept requests without token, beyond loopback too.
    #[arg(long, conflicts_with = "tokens")]
    allow_anonymous: bool,
    /// Requests per second for each token; without tokens, for all clients together.
    #[arg(long, default_value = "20", value_name = "N")]
    rate: NonZeroU32,
    /// Burst size: requests at once after a pause. Default: the number allowed per second.
    #[arg(long, value_name = "N")]
    burst: Option<NonZeroU32>,
    /// Threads that localize. Default: one per core.
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
    /// Maximum number of queries that wait for a thread; further queries are refused with 503.
    #[arg(long, default_value = "32", value_name = "N")]
    queue: NonZeroUsize,
    /// Maximum number of connections. A new connection beyond it evicts an idle one, unauthenticated ones first.
    #[arg(long, default_value = "1024", value_name = "N")]
    connections: NonZeroUsize,
    /// Maximum number of unauthenticated connections per address (IPv6: per /64).
    #[arg(long, default_value = "128", value_name = "N")]
    connections_per_address: NonZeroUsize,
    /// Number of connections reserved for authenticated clients. Default: half with --tokens, otherwise none.
    #[arg(long, value_name = "N")]
    reserved_connections: Option<usize>,
    /// Seconds after which an unauthenticated connection is closed.
    #[arg(long, default_value_t = 60.0, value_parser = positive, value_name = "SECONDS")]
    unauthenticated_max_age: f64,
    /// Seconds after which any connection is closed; a request in progress is finished.
    #[arg(long, default_value_t = 600.0, value_parser = positive, value_name = "SECONDS")]
    connection_max_age: f64,
    /// Timeout of a query in seconds, from its last byte to its pose, including the time in the queue.
    #[arg(long, default_value_t = 30.0, value_parser = positive, value_name = "SECONDS")]
    request_timeout: f64,
    /// Answers leave at whole multiples of these seconds after a query was received, so that their time does not show
    /// whether a pose was found; 0 turns this off. It should exceed the time of almost all localizations
    /// (`veiloc_late_answers_total` counts the others).
    #[arg(long, default_value_t = 1.0, value_parser = not_negative, value_name = "SECONDS")]
    answer_quantum: f64,
    /// Timeout for receiving a query's body, in seconds.
    #[arg(long, default_value_t = 15.0, value_parser = positive, value_name = "SECONDS")]
    body_timeout: f64,
    /// Seconds between the stop signal and the end of accepting connections; during this time `/readyz` returns 503, so
    /// that load balancers remove the instance.
    #[arg(long, default_value_t = 2.0, value_parser = not_negative, value_name = "SECONDS")]
    drain_delay: f64,
    /// Seconds that accepted requests may still take after the service is stopped.
    #[arg(long, default_value_t = 30.0, value_parser = positive, value_name = "SECONDS")]
    grace: f64,
    /// Seconds between two checks for replaced files.
    #[arg(long, default_value_t = 2.0, value_parser = positive, value_name = "SECONDS")]
    watch: f64,
    /// Serve a web page at `/` that shows the device's query and its pose. Default: no page.
    #[arg(long)]
    page: bool,
    /// Files of the web page, as built by bindings/web/build.sh. Default: the folder veiloc-page beside the program.
    #[arg(long, requires = "page", value_name = "DIR")]
    page_folder: Option<PathBuf>,
    /// Maximum number of map points that the page shows to clients with access to the map; the points reveal the scene.
    #[arg(long, default_value_t = 0, value_name = "N")]
    page_points: usize,
    #[command(flatten)]
    log: LogArgs,
    /// Send traces to the collector at this address, as OTLP over HTTP (`/v1/traces` is appended): for example
    /// http://127.0.0.1:4318. Default: no traces are sent.
    #[arg(long, value_name = "URL")]
    otlp: Option<String>,
}

/// The mode of a file, in octal digits.
#[derive(Debug, Clone, Copy)]
struct Mode(u32);

fn mode(text: &str) -> Result<Mode, String> {
    match u32::from_str_radix(text, 8) {
        Ok(mode) if mode <= 0o777 && text.bytes().all(|digit| digit.is_ascii_digit()) => Ok(Mode(mode)),
        _ => Err("three octal digits are expected, such as 660".to_owned()),
    }
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

/// Serves with the merged settings of command line, environment and file.
///
/// # Errors
/// [`Failure`], which the caller reports.
pub(crate) fn run(first: &clap::ArgMatches, ui: &Ui) -> Outcome {
    run_with_config("serve", first, ui, serve)
}

fn serve(args: &Args, ui: &Ui) -> Outcome {
    let mut options = options(args)?;
    let logger = Logger::start(&args.log, ui.is_quiet())?;
    options.log = Some(logger.log.clone());
    let scheme = if options.tls.is_some() { "https" } else { "http" };
    #[cfg(feature = "cluster")]
    let serves_regions = args.from_store.serves_regions();
    #[cfg(not(feature = "cluster"))]
    let serves_regions = false;
    let ended = run_prepared(with_store(args, options), |listening| {
        if let Some(admin) = listening.admin {
            logger.info(format!("probes and metrics on http://{admin}"));
        }
        let names = match listening.maps[..] {
            [] if serves_regions => "regions".to_owned(),
            [] => "no map yet".to_owned(),
            _ => listening.maps.join(", "),
        };
        for address in &listening.addresses {
            match address {
                ListenAddress::Tcp(address) => {
                    logger.info(format!("serving {names} on {scheme}://{address}"));
                }
                // Clients behind a proxy of this machine are under the proxy's control.
                ListenAddress::Unix(_) => logger.info(format!("serving {names} on {address}")),
            }
        }
    });
    let exit = match ended {
        Ok(ShutdownSummary { answered, given_up: 0, .. }) => {
            logger.info(format!(
                "stopped; all accepted requests were answered, {answered} of them after the stop signal"
            ));
            Exit::Success
        }
        Ok(ShutdownSummary { answered, given_up, forced: true }) => {
            logger.error(format!(
                "stopped at once by a second signal: {given_up} connections were closed; {answered} \
                 requests were answered after the first signal"
            ));
            Exit::Refused
        }
        Ok(ShutdownSummary { answered, given_up, forced: false }) => {
            logger.error(format!(
                "{given_up} connections did not end within {} s and were closed; {answered} requests were \
                 answered in that time; allow more time with --grace if those requests are important",
                args.grace
            ));
            Exit::Refused
        }
        Err(Failure::Refused { report } | Failure::Output { report }) if logger.is_json() => {
            logger.error(report);
            Exit::Refused
        }
        // An error before the first request is printed directly.
        Err(failure) => return Err(failure),
    };
    logger.flush();
    Ok(exit)
}

/// Adds the regions or maps of the store.
#[cfg(feature = "cluster")]
async fn with_store(args: &Args, options: ServerOptions) -> Result<ServerOptions, Failure> {
    args.from_store.add_to(options, Duration::from_secs_f64(args.watch.min(86_400.0))).await
}

/// Without the cargo feature, a store is refused.
#[cfg(not(feature = "cluster"))]
#[expect(clippy::unused_async, reason = "same signature as with the feature")]
async fn with_store(args: &Args, options: ServerOptions) -> Result<ServerOptions, Failure> {
    match args.store {
        Some(_) => Err(crate::commands::missing_feature::error("veiloc serve --store", "cluster")),
        None => Ok(options),
    }
}

fn options(args: &Args) -> Result<ServerOptions, Failure> {
    let source = |map: &NamedMap| MapSource { name: map.name.clone(), path: map.path.clone() };
    let mut options = ServerOptions::new(args.maps.iter().map(source).collect());
    options.listen.clone_from(&args.listen);
    options.socket_mode = args.socket_mode.0;
    options.cors.clone_from(&args.cors_origin);
    options.maps_folder.clone_from(&args.folder);
    options.geo_references.clone_from(&args.geo_reference);
    options.map_memory = args.map_memory.into();
    if let (Some(cert), Some(key)) = (&args.cert, &args.key) {
        options.tls =
            Some(TlsFiles { cert: cert.clone(), key: key.clone(), client_ca: args.client_ca.clone() });
    }
    options.insecure_http = args.insecure_http;
    options.tokens.clone_from(&args.tokens);
    options.tokens_max_stale = Duration::from_secs_f64(args.tokens_max_stale.min(86_400.0 * 365.0));
    options.allow_anonymous = args.allow_anonymous;
    options.rate = RateLimit { per_second: args.rate, burst: args.burst.unwrap_or(args.rate) };
    if let Some(threads) = args.threads {
        options.threads = threads;
    }
    options.queue = args.queue;
    options.connections = args.connections;
    options.connections_per_address = args.connections_per_address;
    options.reserved_connections = args.reserved_connections;
    options.admin = Some(args.admin_listen.unwrap_or_else(|| ServerOptions::default_admin(&args.listen)));
    let seconds = |s: f64| Duration::from_secs_f64(s.min(86_400.0));
    options.timeouts.localize = seconds(args.request_timeout);
    options.answer_quantum = seconds(args.answer_quantum);
    options.timeouts.body = seconds(args.body_timeout);
    options.timeouts.drain = seconds(args.drain_delay);
    options.timeouts.grace = seconds(args.grace);
    options.timeouts.unauthenticated_max_age = seconds(args.unauthenticated_max_age);
    options.timeouts.max_age = seconds(args.connection_max_age);
    options.packs = args.packs;
    options.watch = Some(seconds(args.watch));
    options.otlp.clone_from(&args.otlp);
    if args.page {
        let north = args.geo_reference.iter().map(|at| (at.map.clone(), at.x_from_east_deg)).collect();
        let page_config = PageConfig { points: args.page_points, views: Vec::new(), north };
        options.page = Some(Arc::new(page(args.page_folder.as_ref(), &page_config)?));
        options.page_points = args.page_points;
    }
    Ok(options)
}

#[cfg(test)]
mod settings_tests;
