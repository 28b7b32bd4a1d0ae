//! Options of the service, checked before any file is opened.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::num::{NonZeroU32, NonZeroUsize};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use crate::http::{ConnectionTimeouts, ListenAddress, TlsFiles};
use crate::web_page::Page;
use veiloc_localization::LocalizeOptions;
use veiloc_map::MapMemory;
use veiloc_map::is_map_name;

use crate::error::ServerError;
use crate::http::origin::CorsOrigin;
use crate::maps::geo_reference::GeoReference;
use crate::maps::regions::Regions;
use crate::maps::remote::RemoteMap;
use crate::queue::clock::{Clock, Gate};
use crate::telemetry::{GatewayCounts, LogQueue};

/// A map file and the name under which it is served.
#[derive(Debug, Clone)]
pub struct MapSource {
    /// Part of the address: letters, digits, `-`, `_` and `.`, at most 64.
    pub name: String,
    /// The map file. It may be replaced by renaming while it is served.
    pub path: PathBuf,
}

/// Rate limit of one token.
#[derive(Debug, Clone, Copy)]
pub struct RateLimit {
    /// Sustained requests per second.
    pub per_second: NonZeroU32,
    /// Burst size.
    pub burst: NonZeroU32,
}

/// Time limits.
#[derive(Debug, Clone, Copy)]
pub struct Timeouts {
    /// Receiving the head of a request, and idle time between two requests of a connection. Also the TLS handshake.
    pub head: Duration,
    /// Receiving the body of a request.
    pub body: Duration,
    /// From the end of the body to the pose, time in the queue included.
    pub localize: Duration,
    /// Longest stall while the client reads an answer.
    pub write: Duration,
    /// Lifetime of an unauthenticated connection; of any connection if no tokens are required. Requests in flight are
    /// finished.
    pub unauthenticated_max_age: Duration,
    /// Lifetime of any connection.
    pub max_age: Duration,
    /// After a stop request the service reports it (`/readyz`, `connection: close`) for this long before it closes
    /// its listeners, so that load balancers can redirect clients.
    pub drain: Duration,
    /// Time limit after that for finishing accepted requests.
    pub grace: Duration,
}

impl Default for Timeouts {
    /// 5 s for a head (phones on bad networks need two), 15 s for a body (140 kB at 80 kbit/s), 30 s for a pose; one
    /// minute for an unauthenticated connection, ten for any connection.
    fn default() -> Self {
        Self {
            head: Duration::from_secs(5),
            body: Duration::from_secs(15),
            localize: Duration::from_secs(30),
            write: Duration::from_secs(15),
            unauthenticated_max_age: Duration::from_secs(60),
            max_age: Duration::from_secs(600),
            drain: Duration::ZERO,
            grace: Duration::from_secs(30),
        }
    }
}

impl Timeouts {
    /// The limits that apply to connections.
    pub(crate) fn connection_timeouts(&self) -> ConnectionTimeouts {
        let Self { head, write, unauthenticated_max_age, max_age, .. } = *self;
        ConnectionTimeouts { head, write, unauthenticated_max_age, max_age }
    }
}

/// All options of the service.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct ServerOptions {
    /// Addresses to listen on, at least one. A Unix socket is reachable only through this machine, usually by a local
    /// proxy that does TLS. So neither TLS nor tokens are required there.
    pub listen: Vec<ListenAddress>,
    /// File mode of Unix sockets, which controls who may connect.
    pub socket_mode: u32,
    /// Map files to serve. At least one, unless there is a maps folder, a remote map or regions.
    pub maps: Vec<MapSource>,
    /// Maps of remote backends.
    pub remote_maps: Vec<RemoteMap>,
    /// Regions of published maps (`/v1/maps/{name}/regions/{region}/localize`). `None`: none are served.
    pub regions: Option<Regions>,
    /// A folder whose files `NAME.vmap` are also served, each as `NAME`. Added and removed files are followed.
    pub maps_folder: Option<PathBuf>,
    /// Where maps are on earth, for `POST /geopose`. A map without one answers no GeoPose request.
    pub geo_references: Vec<GeoReference>,
    /// How map files are loaded. By default they are copied into memory, so that later changes of the files have no
    /// effect on them.
    pub map_memory: MapMemory,
    /// Certificate files. Without them the service speaks plain HTTP, on loopback only.
    pub tls: Option<TlsFiles>,
    /// Allows plain HTTP beyond loopback, for use behind a proxy that does TLS.
    pub insecure_http: bool,
    /// Origins whose pages may send requests from a browser (CORS). None by default.
    pub cors: Vec<CorsOrigin>,
    /// The file of tokens, see `docs/reference/http.md`. Without it any client on this machine may query.
    pub tokens: Option<PathBuf>,
    /// How long the last valid tokens stay in force when the file of tokens is missing, empty or invalid; after that
    /// every query is refused.
    pub tokens_max_stale: Duration,
    /// Allows queries without tokens beyond loopback.
    pub allow_anonymous: bool,
    /// Rate limit of each token; without tokens, of all requests together.
    pub rate: RateLimit,
    /// Threads that localize. Default: one per core.
    pub threads: NonZeroUsize,
    /// Maximum length of the queue; a further query is refused with 503. 32 queries wait about a second on two cores.
    pub queue: NonZeroUsize,
    /// Maximum number of open connections. A further connection evicts an idle one, unauthenticated ones first.
    pub connections: NonZeroUsize,
    /// Maximum number of unauthenticated connections per address (for IPv6, per /64).
    pub connections_per_address: NonZeroUsize,
    /// Number of [`Self::connections`] reserved for authenticated clients. `None`: half of them, or none without
    /// [`Self::tokens`].
    pub reserved_connections: Option<usize>,
    /// Address of a separate listener for probes and metrics: plain HTTP without token, so only the operator may
    /// reach it. `None`: no such listener.
    pub admin: Option<SocketAddr>,
    /// The queue through which the program writes its log, if it uses one; dropped lines are counted in the metrics.
    pub log: Option<LogQueue>,
    /// Counters of a gateway, to be included in the metrics.
    pub gateway: Option<GatewayCounts>,
    /// Address of the collector for traces (OTLP over HTTP); `/v1/traces` is appended.
    pub otlp: Option<String>,
    /// Time limits.
    pub timeouts: Timeouts,
    /// Answers leave at whole multiples of this time after the body of the query was received, so that their time does
    /// not show whether the query was localized (rule L12). Should exceed the time of almost all localizations. Zero:
    /// answers leave at once.
    pub answer_quantum: Duration,
    /// Clock of rate limits and of estimated waiting times. Default: the clock of the system.
    pub clock: Clock,
    /// For tests; `None`: no gate.
    #[doc(hidden)]
    pub gate: Option<Gate>,
    /// How often map, token and certificate files and the maps folder are checked for changes; `None`: never. A
    /// revoked token is refused after this time at the latest.
    pub watch: Option<Duration>,
    /// Options of localization.
    pub localize: LocalizeOptions,
    /// The web page served at `/`; `None`: no page.
    pub page: Option<Arc<Page>>,
    /// Maximum number of map points shown on the page to clients that may use the map. Default 0: none.
    pub page_points: usize,
    /// Whether devices get the packs of the maps: what the places look like, without where.
    pub packs: bool,
}

impl ServerOptions {
    /// Default options for these maps: `127.0.0.1:8080`, plain HTTP, no tokens.
    pub fn new(maps: Vec<MapSource>) -> Self {
        Self {
            listen: vec![ListenAddress::Tcp(SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 8080))],
            socket_mode: 0o660,
            maps,
            remote_maps: Vec::new(),
            regions: None,
            maps_folder: None,
            geo_references: Vec::new(),
            map_memory: MapMemory::default(),
            tls: None,
            insecure_http: false,
            cors: Vec::new(),
            tokens: None,
            tokens_max_stale: Duration::from_secs(300),
            allow_anonymous: false,
            rate: RateLimit { per_second: DEFAULT_RATE, burst: DEFAULT_RATE },
            threads: std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN),
            queue: NonZeroUsize::MIN.saturating_add(31),
            connections: NonZeroUsize::MIN.saturating_add(1023),
            connections_per_address: NonZeroUsize::MIN.saturating_add(127),
            reserved_connections: None,
            admin: None,
            log: None,
            gateway: None,
            otlp: None,
            timeouts: Timeouts::default(),
            answer_quantum: ANSWER_QUANTUM,
            clock: Clock::default(),
            gate: None,
            watch: Some(Duration::from_secs(2)),
            localize: LocalizeOptions::default(),
            page: None,
            page_points: 0,
            packs: false,
        }
    }

    /// Checks the options.
    pub(crate) fn check(&self) -> Result<(), ServerError> {
        let local = self.maps.iter().map(|map| &map.name);
        let names: Vec<&String> = local.chain(self.remote_maps.iter().map(|map| &map.name)).collect();
        if names.is_empty() && self.maps_folder.is_none() && self.regions.is_none() {
            return Err(ServerError::NoMap);
        }
        for (i, name) in names.iter().enumerate() {
            if !is_map_name(name) {
                return Err(ServerError::MapName { name: (*name).clone() });
            }
            if names[..i].contains(name) {
                return Err(ServerError::TwoMaps { name: (*name).clone() });
            }
        }
        // A maps folder may get the map later.
        let of_no_map = self.geo_references.iter().find(|reference| !names.contains(&&reference.map));
        if let Some(GeoReference { map, .. }) = of_no_map.filter(|_| self.maps_folder.is_none()) {
            return Err(ServerError::GeoReference { name: map.clone() });
        }
        if let Some(reserved) = self.reserved_connections.filter(|n| *n >= self.connections.get()) {
            return Err(ServerError::Reserved { reserved, connections: self.connections.get() });
        }
        if self.listen.is_empty() {
            return Err(ServerError::NoListener);
        }
        for listen in self.listen.iter().filter(|listen| !listen.is_local()) {
            if self.tls.is_none() && !self.insecure_http {
                return Err(ServerError::PlainHttp { listen: listen.clone() });
            }
            if self.tokens.is_none() && !self.allow_anonymous {
                return Err(ServerError::Anonymous { listen: listen.clone() });
            }
        }
        Ok(())
    }

    /// Default address for probes and metrics: loopback, on the port after the first TCP port of `listen` (port 0 if
    /// that is 0; 8081 without a TCP address). So two services on one machine do not collide.
    pub fn default_admin(listen: &[ListenAddress]) -> SocketAddr {
        let port = listen.iter().find_map(ListenAddress::tcp).map_or(8080, |address| address.port());
        SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), default_admin_port(port))
    }
}

/// The port after `listen`; 0 stays 0.
const fn default_admin_port(listen: u16) -> u16 {
    match listen {
        0 => 0,
        u16::MAX => u16::MAX - 1,
        port => port + 1,
    }
}

/// Above the 99th percentile of answers with a full queue on two cores (0.5 s), and of queries of an unknown focal length
/// that are not localized (0.8 s of processor time on busy cores).
const ANSWER_QUANTUM: Duration = Duration::from_secs(1);

const DEFAULT_RATE: NonZeroU32 = NonZeroU32::MIN.saturating_add(19);

#[cfg(test)]
mod tests {
    use super::*;

    fn options(listen: &str, names: &[&str]) -> ServerOptions {
        let source = |name: &&str| MapSource { name: (*name).to_owned(), path: "place.vmap".into() };
        let mut options = ServerOptions::new(names.iter().map(source).collect());
        options.listen = vec![listen.parse().expect("an address")];
        options
    }

    #[test]
    fn plain_http_and_anonymous_access_are_limited_to_loopback() {
        for loopback in ["127.0.0.1:0", "127.8.8.8:80", "[::1]:0", "unix:v.sock"] {
            options(loopback, &["a"]).check().expect("reachable from this machine only");
        }
        for public in ["0.0.0.0:80", "192.168.0.2:80", "[::]:80"] {
            let mut options = options(public, &["a"]);
            assert!(matches!(options.check(), Err(ServerError::PlainHttp { .. })));
            options.insecure_http = true;
            assert!(matches!(options.check(), Err(ServerError::Anonymous { .. })));
            options.insecure_http = false;
            options.tls = Some(TlsFiles { cert: "c".into(), key: "k".into(), client_ca: None });
            assert!(matches!(options.check(), Err(ServerError::Anonymous { .. })));
            options.tokens = Some("tokens".into());
            options.check().expect("TLS and tokens");
            options.tls = None;
            options.listen.insert(0, "127.0.0.1:0".parse().expect("an address"));
            assert!(
                matches!(options.check(), Err(ServerError::PlainHttp { .. })),
                "one of several addresses"
            );
        }
    }

    #[test]
    fn map_names_are_valid_and_unique() {
        options("127.0.0.1:0", &["lobby", "floor-2.b_x"]).check().expect("plain names");
        for bad in ["", ".", "..", "a/b", "ä", "a b", "a\nb", "a\"b", &"x".repeat(65)] {
            assert!(
                matches!(options("127.0.0.1:0", &[bad]).check(), Err(ServerError::MapName { .. })),
                "{bad:?}"
            );
        }
        assert!(matches!(options("127.0.0.1:0", &["a", "a"]).check(), Err(ServerError::TwoMaps { .. })));
        assert!(matches!(options("127.0.0.1:0", &[]).check(), Err(ServerError::NoMap)));
    }
}
