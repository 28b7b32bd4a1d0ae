//! What to serve, to whom, and how much at a time; checked before anything is opened.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::num::{NonZeroU32, NonZeroUsize};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use crate::http::{Conduct, ListenAddress, TlsFiles};
use crate::web_page::Page;
use veiloc_localization::LocalizeOptions;
use veiloc_map::MapMemory;
use veiloc_map::is_map_name;

use crate::clock::Clock;
use crate::elsewhere::MapElsewhere;
use crate::error::ServerError;
use crate::origin::Origin;
use crate::telemetry::{GatewayCounts, LogQueue};

/// A map and the name it is served under.
#[derive(Debug, Clone)]
pub struct MapSource {
    /// Part of the address: letters, digits, `-`, `_` and `.`, at most 64.
    pub name: String,
    /// The map file. It may be replaced (by renaming another over it) while it is served.
    pub path: PathBuf,
}

/// How often one token may ask.
#[derive(Debug, Clone, Copy)]
pub struct RateLimit {
    /// Requests per second in the long run.
    pub per_second: NonZeroU32,
    /// Requests at once after a pause.
    pub burst: NonZeroU32,
}

/// How long anything may take.
#[derive(Debug, Clone, Copy)]
pub struct Timeouts {
    /// Head of a request, and pause between two requests of a connection. Also the TLS handshake.
    pub head: Duration,
    /// Body of a request.
    pub body: Duration,
    /// From the end of the body to the pose, waiting for a worker included.
    pub localize: Duration,
    /// The client's reading of an answer, as long as it takes nothing.
    pub write: Duration,
    /// A connection on which no known token came; where none are needed, any. What is being answered is finished.
    pub unknown_life: Duration,
    /// Any connection.
    pub life: Duration,
    /// When the server is told to stop, it says so (`/readyz`, `connection: close`) for so long before it takes no more
    /// connections: balancers need that time to look elsewhere.
    pub drain: Duration,
    /// What was accepted may still take this long after that.
    pub grace: Duration,
}

impl Default for Timeouts {
    /// 5 s for a head (phones on bad networks need two), 15 s for a body (140 kB at 80 kbit/s), 30 s for a pose; a minute
    /// for a connection that brings no token, ten for any.
    fn default() -> Self {
        Self {
            head: Duration::from_secs(5),
            body: Duration::from_secs(15),
            localize: Duration::from_secs(30),
            write: Duration::from_secs(15),
            unknown_life: Duration::from_secs(60),
            life: Duration::from_secs(600),
            drain: Duration::ZERO,
            grace: Duration::from_secs(30),
        }
    }
}

impl Timeouts {
    /// Of connections. The last answer of one may take as long as any.
    pub(crate) fn conduct(&self) -> Conduct {
        let Self { head, write, unknown_life, life, .. } = *self;
        Conduct { head, write, unknown_life, life }
    }
}

/// Everything the service needs to know.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct ServerOptions {
    /// Where to listen, at least one. Behind a Unix socket there is a proxy of this machine: nobody else reaches it, so
    /// nothing is asked of it that protects against others on the way, and TLS is the proxy's.
    pub listen: Vec<ListenAddress>,
    /// Who may connect to Unix sockets, as the mode of their files.
    pub socket_mode: u32,
    /// What to serve, at least one unless there is a folder, or others hold a map.
    pub maps: Vec<MapSource>,
    /// What to serve of maps that others hold. [`Self::workers`] are then queries under way at a time.
    pub elsewhere: Vec<MapElsewhere>,
    /// A folder whose files `NAME.vmap` are served too, each as `NAME`, as they come and go.
    pub maps_folder: Option<PathBuf>,
    /// Where the bytes of maps are: by default copied into memory, so that what becomes of the files cannot touch them.
    pub map_memory: MapMemory,
    /// Certificate files. Without them the service speaks plain HTTP, which it does on loopback only.
    pub tls: Option<TlsFiles>,
    /// Plain HTTP beyond loopback: for a proxy that does TLS in front of this service.
    pub insecure_http: bool,
    /// Pages of these origins may ask from within a browser (CORS). None by default.
    pub cors: Vec<Origin>,
    /// Who may ask: one token a line, see `docs/reference/configuration.md`. Without it everybody on this machine may.
    pub tokens: Option<PathBuf>,
    /// How long the last valid tokens hold when the file of tokens is gone, empty or wrong; then nobody may ask.
    pub stale_tokens: Duration,
    /// Everybody may ask, beyond loopback too.
    pub allow_anonymous: bool,
    /// For each token; without tokens, for all requests together.
    pub rate: RateLimit,
    /// Threads that localize. Default: one a core.
    pub workers: NonZeroUsize,
    /// Queries that may wait for a worker; one more is refused with 503. 32 wait about a second on two cores.
    pub queue: NonZeroUsize,
    /// Connections at a time. One more takes the place of one that is idle, first of those that brought no token.
    pub connections: NonZeroUsize,
    /// Connections of one address (of IPv6, one /64) at a time, those that brought a known token not counted.
    pub connections_per_address: NonZeroUsize,
    /// Of [`Self::connections`], how many are for known tokens alone. `None` for half of them; without
    /// [`Self::tokens`], none are.
    pub reserved_connections: Option<usize>,
    /// Where to answer probes and metrics, beside [`Self::listen`]: plain HTTP that asks for no token, so an address that
    /// only the operator reaches. `None` for no listener of their own.
    pub admin: Option<SocketAddr>,
    /// The queue that the program's log goes through, if it does: lines it dropped are counted in the metrics.
    pub log: Option<LogQueue>,
    /// What is counted of a cluster that holds maps, to be among the metrics.
    pub gateway: Option<GatewayCounts>,
    /// Address of the collector that traces are sent to, as OTLP over HTTP: `/v1/traces` is added.
    #[cfg(feature = "opentelemetry")]
    pub otlp: Option<String>,
    /// How long anything may take.
    pub timeouts: Timeouts,
    /// What allowances and the estimates of waiting times go by. Default: the system's clock.
    pub clock: Clock,
    /// How often to look whether map, token and certificate files were replaced, and whether maps came or went; `None` for
    /// never. A token taken out of its file is refused after so much time at the latest.
    pub watch: Option<Duration>,
    /// How to localize.
    pub localize: LocalizeOptions,
    /// The page to serve at `/`; `None` for none.
    pub page: Option<Arc<Page>>,
    /// Most points of a map that the page is shown, to whoever may ask for the map. Default 0: none.
    pub page_points: usize,
}

impl ServerOptions {
    /// These maps on `127.0.0.1:8080`, with plain HTTP and without tokens.
    pub fn new(maps: Vec<MapSource>) -> Self {
        Self {
            listen: vec![ListenAddress::Tcp(SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 8080))],
            socket_mode: 0o660,
            maps,
            elsewhere: Vec::new(),
            maps_folder: None,
            map_memory: MapMemory::default(),
            tls: None,
            insecure_http: false,
            cors: Vec::new(),
            tokens: None,
            stale_tokens: Duration::from_secs(300),
            allow_anonymous: false,
            rate: RateLimit { per_second: TWENTY, burst: TWENTY },
            workers: std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN),
            queue: NonZeroUsize::MIN.saturating_add(31),
            connections: NonZeroUsize::MIN.saturating_add(1023),
            connections_per_address: NonZeroUsize::MIN.saturating_add(127),
            reserved_connections: None,
            admin: None,
            log: None,
            gateway: None,
            #[cfg(feature = "opentelemetry")]
            otlp: None,
            timeouts: Timeouts::default(),
            clock: Clock::default(),
            watch: Some(Duration::from_secs(2)),
            localize: LocalizeOptions::default(),
            page: None,
            page_points: 0,
        }
    }

    /// Refuses what would be a mistake.
    pub(crate) fn check(&self) -> Result<(), ServerError> {
        let own = self.maps.iter().map(|map| &map.name);
        let names: Vec<&String> = own.chain(self.elsewhere.iter().map(|map| &map.name)).collect();
        if names.is_empty() && self.maps_folder.is_none() {
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

    /// Where probes and metrics go unless somebody says otherwise: loopback, the port after that of the first TCP port of
    /// `listen` (for any free port any free one), so that two services of one machine differ in both; without one, 8081.
    pub fn default_admin(listen: &[ListenAddress]) -> SocketAddr {
        let port = listen.iter().find_map(ListenAddress::tcp).map_or(8080, |address| address.port());
        SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), default_admin_port(port))
    }
}

/// The port beside that of the service; any free one for any free one.
const fn default_admin_port(listen: u16) -> u16 {
    match listen {
        0 => 0,
        u16::MAX => u16::MAX - 1,
        port => port + 1,
    }
}

const TWENTY: NonZeroU32 = NonZeroU32::MIN.saturating_add(19);

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
    fn plain_http_and_negatives_stay_on_loopback() {
        for loopback in ["127.0.0.1:0", "127.8.8.8:80", "[::1]:0", "unix:v.sock"] {
            options(loopback, &["a"]).check().expect("nobody else can listen");
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
            assert!(matches!(options.check(), Err(ServerError::PlainHttp { .. })), "any of several");
        }
    }

    #[test]
    fn names_are_plain_and_different() {
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
