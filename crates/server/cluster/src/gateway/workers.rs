//! Which worker is asked for a region, and when a second one is.
//!
//! Every worker can serve every region; who has it open already answers sooner. So the workers are ranked for each region
//! by rendezvous hashing (Thaler and Ravishankar, 1998): all gateways send it to the same two, and a worker that comes or
//! goes changes little. Of the two, the less busy is asked (peak EWMA: latency times requests in flight, of `tower`).
//! When it takes longer than 95 of 100 requests did, the other is asked too, for at most a tenth of all requests, and the
//! worker is probed. A worker that does not answer its probe, or whose requests time out, is put aside.

use std::collections::VecDeque;
use std::net::{IpAddr, SocketAddr};
use std::num::NonZeroU64;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock, Weak};
use std::time::Duration;

use futures_util::StreamExt as _;
use futures_util::future::join_all;
use futures_util::stream::FuturesUnordered;
use reqwest::header::{AUTHORIZATION, HeaderValue};
use reqwest::{Client, Request};
use tokio::sync::watch;
use tokio::time::{Instant, sleep_until};
use tower::Service as _;
use tower::load::{CompleteOnResponse, Load as _, PeakEwma};
use url::Url;
use veiloc_map::regions::ObjectId;
use veiloc_protocol::Answer;
use veiloc_service::LocalizeFailure;
use veiloc_service::telemetry::{GatewayCounts, OpenCall};

use super::reply::Reply;
use super::{Query, REGION, TRACEPARENT};
use crate::ClusterError;
use crate::object_store::address::without_login;

/// Where the workers are, and how they know the gateway.
#[derive(Clone)]
#[non_exhaustive]
pub struct WorkerAccess {
    /// Their addresses, `http://…` or `https://…`. A host name with several addresses stands for several workers, and is
    /// resolved again every few seconds.
    pub urls: Vec<String>,
    /// The token of the gateway; `None` if the workers need none.
    pub token: Option<String>,
    /// CA certificates of the workers, PEM. Default: those of the system.
    pub ca: Option<PathBuf>,
}

impl WorkerAccess {
    /// Workers at these addresses that need no token.
    pub fn new(urls: Vec<String>) -> Self {
        Self { urls, token: None, ca: None }
    }
}

/// All workers of a gateway.
pub struct Workers {
    urls: Vec<Url>,
    authorization: Option<HeaderValue>,
    certificates: Vec<reqwest::Certificate>,
    known: RwLock<Vec<Arc<Worker>>>,
    /// The last round trips, and what may be spent on second requests.
    hedging: Mutex<Hedging>,
}

/// One worker.
struct Worker {
    /// Names it in logs, in traces, and for the hash of regions.
    name: String,
    url: Url,
    address: SocketAddr,
    client: Client,
    load: Mutex<PeakEwma<Client>>,
    /// Whether it answers its probes.
    answers: watch::Sender<bool>,
    aside: Mutex<Aside>,
}

/// For how long a worker whose requests time out gets no others.
#[derive(Default)]
struct Aside {
    failures: u32,
    until: Option<Instant>,
}

/// Interval of the probes, and their time limit.
const PROBE_EVERY: Duration = Duration::from_secs(1);
const PROBE_TIMEOUT: Duration = Duration::from_secs(1);
/// Interval at which host names are resolved again.
const RESOLVE_EVERY: u32 = 5;
const CONNECT_TIMEOUT: Duration = Duration::from_secs(1);
/// A service closes connections that are idle for longer than 5 s.
const IDLE_TIMEOUT: Duration = Duration::from_secs(4);
/// Assumed latency of a new worker, and the time in which a peak is forgotten.
const FIRST_LATENCY: Duration = Duration::from_millis(50);
const DECAY: Duration = Duration::from_secs(10);
/// Workers that are asked for one region before a pause.
const TRIES: usize = 3;
/// Pauses before all are asked again.
const PAUSES: [Duration; 5] = [
    Duration::from_millis(50),
    Duration::from_millis(200),
    Duration::from_millis(500),
    Duration::from_secs(1),
    Duration::from_secs(2),
];
/// While workers are busy, only the shorter of them: they say themselves when to come again.
const LONGEST_BUSY_PAUSE: Duration = Duration::from_millis(500);
const LONGEST_ASIDE: Duration = Duration::from_secs(60);

impl Workers {
    /// Finds the workers and probes them from now on.
    ///
    /// # Errors
    /// [`ClusterError::Workers`]: an address, the token or the certificates cannot be used.
    pub async fn start(access: &WorkerAccess, counts: GatewayCounts) -> Result<Arc<Self>, ClusterError> {
        let wrong =
            |setting: String, reason: &str| ClusterError::Workers { setting, reason: reason.to_owned() };
        // Only the first installed provider counts; an existing one is kept.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let mut urls = Vec::new();
        for text in &access.urls {
            let url = Url::parse(text).ok().filter(|url| {
                ["http", "https"].contains(&url.scheme())
                    && url.has_host()
                    && url.username().is_empty()
                    && url.query().is_none()
            });
            let remedy =
                "a worker is given as http://HOST:PORT or https://HOST:PORT, its token with --worker-token";
            urls.push(url.ok_or_else(|| wrong(format!("--workers {}", without_login(text)), remedy))?);
        }
        let authorization = match &access.token {
            None => None,
            Some(token) => {
                let value = HeaderValue::try_from(format!("Bearer {}", token.trim()));
                let mut value = value.map_err(|_| {
                    wrong(
                        "--worker-token".to_owned(),
                        "the file must hold a token, as `veiloc token new` writes it",
                    )
                })?;
                value.set_sensitive(true);
                Some(value)
            }
        };
        let certificates = match &access.ca {
            None => Vec::new(),
            Some(path) => {
                let pem = std::fs::read(path).map_err(ClusterError::io(path))?;
                let all = reqwest::Certificate::from_pem_bundle(&pem).unwrap_or_default();
                if all.is_empty() {
                    let setting = format!("--worker-ca {}", path.display());
                    return Err(wrong(setting, "the file must hold certificates in PEM"));
                }
                all
            }
        };
        let (known, hedging) = (RwLock::default(), Mutex::default());
        let all = Arc::new(Self { urls, authorization, certificates, known, hedging });
        all.resolve().await?;
        all.probe(&counts).await;
        tokio::spawn(watch_workers(Arc::downgrade(&all), counts));
        Ok(all)
    }

    /// Whether any worker answers.
    pub(super) fn any_answers(&self) -> bool {
        self.all().iter().any(|worker| worker.is_available())
    }

    fn all(&self) -> Vec<Arc<Worker>> {
        self.known.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn hedging(&self) -> MutexGuard<'_, Hedging> {
        self.hedging.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Looks up the addresses of all host names. Workers that were known stay the same; where a lookup fails, too.
    async fn resolve(&self) -> Result<(), ClusterError> {
        let (known, mut found) = (self.all(), Vec::new());
        for url in &self.urls {
            let (host, port) =
                (url.host_str().unwrap_or_default(), url.port_or_known_default().unwrap_or(80));
            let literal = host.trim_matches(['[', ']']).parse::<IpAddr>().is_ok();
            let addresses: Vec<SocketAddr> =
                match tokio::net::lookup_host((host.trim_matches(['[', ']']), port)).await {
                    Ok(addresses) => addresses.collect(),
                    Err(error) => {
                        tracing::warn!(%url, %error, "the address of workers cannot be resolved");
                        found.extend(known.iter().filter(|worker| worker.url == *url).cloned());
                        continue;
                    }
                };
            for address in &addresses {
                // One address may change without moving regions to other workers.
                let name = if addresses.len() == 1 { url.to_string() } else { format!("{url}#{address}") };
                let same = |worker: &&Arc<Worker>| worker.name == name && worker.address == *address;
                found.push(match known.iter().find(same) {
                    Some(worker) => worker.clone(),
                    None => Arc::new(self.worker(name, url, *address, literal)?),
                });
            }
        }
        *self.known.write().unwrap_or_else(PoisonError::into_inner) = found;
        Ok(())
    }

    fn worker(
        &self,
        name: String,
        url: &Url,
        address: SocketAddr,
        literal: bool,
    ) -> Result<Worker, ClusterError> {
        // A proxy from the environment is not meant for the operator's own machines.
        let mut client = Client::builder()
            .no_proxy()
            .http1_only()
            .connect_timeout(CONNECT_TIMEOUT)
            .pool_idle_timeout(IDLE_TIMEOUT)
            .redirect(reqwest::redirect::Policy::none())
            .tcp_nodelay(true);
        if !self.certificates.is_empty() {
            client = client.tls_certs_only(self.certificates.clone());
        }
        if let Some(host) = url.host_str().filter(|_| !literal) {
            client = client.resolve(host, address);
        }
        let client = client.build().map_err(|error| ClusterError::Workers {
            setting: format!("--workers {url}"),
            reason: error.to_string(),
        })?;
        let load = PeakEwma::new(
            client.clone(),
            FIRST_LATENCY,
            DECAY.as_nanos() as f64,
            CompleteOnResponse::default(),
        );
        let (answers, aside) = (watch::Sender::new(true), Mutex::default());
        Ok(Worker { name, url: url.clone(), address, client, load: Mutex::new(load), answers, aside })
    }

    async fn probe(&self, counts: &GatewayCounts) {
        let all = self.all();
        join_all(all.iter().map(|worker| worker.probe())).await;
        let answering = all.iter().filter(|worker| worker.is_available()).count();
        counts.workers(answering, all.len() - answering);
    }

    /// All workers in the order in which they are asked for a region.
    fn ranked(&self, region: &ObjectId) -> Vec<Arc<Worker>> {
        let mut all: Vec<(u64, Arc<Worker>)> =
            self.all().into_iter().map(|worker| (weight(region, &worker.name), worker)).collect();
        all.sort_by_key(|(weight, _)| std::cmp::Reverse(*weight));
        let all = all.into_iter().map(|(_, worker)| worker);
        let (mut ranked, aside): (Vec<_>, Vec<_>) = all.partition(|worker| worker.is_available());
        if let [first, second, ..] = &ranked[..]
            && second.cost() < first.cost()
        {
            ranked.swap(0, 1);
        }
        // Better one that seems to be away than none.
        ranked.extend(aside);
        ranked.truncate(TRIES);
        ranked
    }

    /// Asks workers for the pose in a region until one answers.
    pub(super) async fn ask(
        &self,
        map: &str,
        region: ObjectId,
        query: &Query,
        counts: &GatewayCounts,
    ) -> Result<Answer, LocalizeFailure> {
        let mut pauses = PAUSES.iter();
        loop {
            let ended = self.ask_once(map, region, query, counts).await;
            let patience = match ended {
                Err(LocalizeFailure::Unreached { .. }) => PAUSES[PAUSES.len() - 1],
                Err(LocalizeFailure::Busy { .. }) => LONGEST_BUSY_PAUSE,
                _ => return ended,
            };
            let Some(pause) = pauses.next().filter(|pause| **pause <= patience) else { return ended };
            if Instant::now() + *pause >= query.deadline {
                return ended;
            }
            tokio::time::sleep(*pause).await;
        }
    }

    async fn ask_once(
        &self,
        map: &str,
        region: ObjectId,
        query: &Query,
        counts: &GatewayCounts,
    ) -> Result<Answer, LocalizeFailure> {
        let mut next = self.ranked(&region).into_iter();
        let mut running = FuturesUnordered::new();
        let send = |worker: Arc<Worker>| {
            let request = self.request(&worker, map, region, query);
            async move {
                let (begun, call) = (Instant::now(), Sent { counts, call: request.1, ended: false });
                let reply = worker.send(request.0).await;
                (worker, begun, call, reply)
            }
        };
        let mut hedge_at = Instant::now() + self.hedging().after();
        // Those that are asked, and of them those that still answer their probes.
        let (mut asked, mut watched) = (Vec::<Arc<Worker>>::new(), Vec::<Arc<Worker>>::new());
        let mut begin = |worker: Arc<Worker>, watched: &mut Vec<Arc<Worker>>| {
            if *worker.answers.borrow() {
                watched.push(worker.clone());
            }
            asked.push(worker.clone());
            send(worker)
        };
        let mut why = LocalizeFailure::Unreached { retry_after: NonZeroU64::MIN };
        loop {
            if running.is_empty() {
                let Some(worker) = next.next() else { return Err(why) };
                running.push(begin(worker, &mut watched));
            }
            let lost = first_lost(&watched);
            tokio::select! {
                Some((worker, begun, mut call, reply)) = running.next() => match reply {
                    Reply::Decided(result) => {
                        call.end("answered");
                        worker.succeeded();
                        counts.round_trip(begun.elapsed());
                        self.hedging().answered(begun.elapsed());
                        return *result;
                    }
                    Reply::Busy(retry_after) => {
                        call.end("busy");
                        why = LocalizeFailure::Busy { retry_after };
                    }
                    Reply::Stopping => call.end("refused"),
                    Reply::Refused(reason) => {
                        call.end("refused");
                        tracing::warn!(worker = worker.name, request = %query.id(), reason, "a worker refused a query");
                    }
                    Reply::Failed(reason) => {
                        call.end("failed");
                        tracing::warn!(worker = worker.name, request = %query.id(), reason, "a worker failed");
                        worker.answers.send_replace(false);
                    }
                },
                // The same bytes go to the next, and the first that answers counts.
                () = sleep_until(hedge_at) => {
                    hedge_at = query.deadline + Duration::from_secs(1);
                    for worker in watched.clone() {
                        tokio::spawn(async move { worker.probe().await });
                    }
                    if self.hedging().may_hedge() && let Some(worker) = next.next() {
                        counts.hedged();
                        running.push(begin(worker, &mut watched));
                    }
                }
                number = lost => {
                    // It may still answer, but the next need not wait for that.
                    watched.remove(number);
                    if let Some(worker) = next.next() {
                        running.push(begin(worker, &mut watched));
                    }
                }
                () = sleep_until(query.deadline) => {
                    for worker in &asked {
                        worker.timed_out();
                    }
                    return Err(LocalizeFailure::TimedOut);
                }
            }
        }
    }

    /// The request, and its record in the trace.
    fn request(
        &self,
        worker: &Worker,
        map: &str,
        region: ObjectId,
        query: &Query,
    ) -> (Request, Option<OpenCall>) {
        let mut url = worker.url.clone();
        let base = url.path().trim_end_matches('/');
        let path = format!("{base}/v1/maps/{map}/regions/{region}/{}", query.route());
        url.set_path(&path);
        let mut request = Request::new(reqwest::Method::POST, url);
        let call = query.trace().map(|trace| trace.call(worker.name.clone()));
        let span = call.as_ref().map_or(query.id().span(0), OpenCall::span);
        let headers = request.headers_mut();
        headers.clone_from(&query.headers);
        // Hexadecimal digits are valid values.
        if let Ok(region) = HeaderValue::try_from(region.to_string()) {
            headers.insert(REGION, region);
        }
        if let Ok(parent) = HeaderValue::try_from(format!("00-{}-{span}-01", query.id())) {
            headers.insert(TRACEPARENT, parent);
        }
        if let Some(authorization) = &self.authorization {
            headers.insert(AUTHORIZATION, authorization.clone());
        }
        *request.body_mut() = Some(query.body.clone().into());
        (request, call)
    }
}

/// The number of the first of these workers that no longer answers.
async fn first_lost(workers: &[Arc<Worker>]) -> usize {
    if workers.is_empty() {
        return std::future::pending().await;
    }
    let lost = workers.iter().enumerate().map(|(number, worker)| {
        let mut answers = worker.answers.subscribe();
        Box::pin(async move {
            // Its sender lives as long as the worker.
            let _ = answers.wait_for(|answers| !answers).await;
            number
        })
    });
    futures_util::future::select_all(lost).await.0
}

/// A request to a worker, counted when it ends.
struct Sent<'a> {
    counts: &'a GatewayCounts,
    call: Option<OpenCall>,
    ended: bool,
}

impl Sent<'_> {
    fn end(&mut self, outcome: &'static str) {
        self.counts.request(outcome);
        if let Some(call) = &mut self.call {
            call.set_outcome(outcome);
        }
        self.ended = true;
    }
}

impl Drop for Sent<'_> {
    fn drop(&mut self) {
        if !self.ended {
            self.counts.request("superseded");
        }
    }
}

/// Probes the workers and resolves their names until the gateway is dropped.
async fn watch_workers(workers: Weak<Workers>, counts: GatewayCounts) {
    for round in 1_u32.. {
        tokio::time::sleep(PROBE_EVERY).await;
        let Some(workers) = workers.upgrade() else { return };
        if round % RESOLVE_EVERY == 0
            && let Err(error) = workers.resolve().await
        {
            tracing::error!(%error, "workers");
        }
        workers.probe(&counts).await;
    }
}

impl Worker {
    fn aside(&self) -> MutexGuard<'_, Aside> {
        self.aside.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_available(&self) -> bool {
        *self.answers.borrow() && self.aside().until.is_none_or(|until| until <= Instant::now())
    }

    /// How long a further request would take, by its latency and its requests in flight.
    fn cost(&self) -> tower::load::peak_ewma::Cost {
        self.load.lock().unwrap_or_else(PoisonError::into_inner).load()
    }

    async fn send(&self, request: Request) -> Reply {
        let response = self.load.lock().unwrap_or_else(PoisonError::into_inner).call(request);
        Reply::read(response.await).await
    }

    /// Asks whether it is ready.
    async fn probe(&self) {
        let mut url = self.url.clone();
        let path = format!("{}/readyz", url.path().trim_end_matches('/'));
        url.set_path(&path);
        let response = tokio::time::timeout(PROBE_TIMEOUT, self.client.get(url).send()).await;
        let answers = matches!(response, Ok(Ok(response)) if response.status().is_success());
        if self.answers.send_replace(answers) != answers {
            let state = if answers { "answers" } else { "does not answer" };
            tracing::info!(worker = self.name, "this worker {state}");
        }
    }

    fn succeeded(&self) {
        *self.aside() = Aside::default();
    }

    /// Puts the worker aside: for a second, and twice as long after each further time.
    fn timed_out(&self) {
        let mut aside = self.aside();
        let pause = Duration::from_secs(1 << aside.failures.min(6)).min(LONGEST_ASIDE);
        aside.failures += 1;
        aside.until = Some(Instant::now() + pause);
        tracing::warn!(
            worker = self.name,
            seconds = pause.as_secs(),
            "a request timed out; the worker is put aside"
        );
    }
}

/// When a second worker is asked.
struct Hedging {
    /// Round trips of the last requests.
    recent: VecDeque<Duration>,
    /// Tenths of second requests that may be sent: each request earns one.
    budget: u32,
}

impl Default for Hedging {
    fn default() -> Self {
        Self { recent: VecDeque::new(), budget: Self::MAX_BUDGET }
    }
}

impl Hedging {
    const RECENT: usize = 256;
    const COST: u32 = 10;
    const MAX_BUDGET: u32 = 10 * Self::COST;
    /// Before there are enough round trips, and the least later on.
    const FIRST: Duration = Duration::from_secs(1);
    const LEAST: Duration = Duration::from_millis(20);

    /// The 95th percentile of the round trips.
    fn after(&self) -> Duration {
        if self.recent.len() < 20 {
            return Self::FIRST;
        }
        let mut sorted: Vec<Duration> = self.recent.iter().copied().collect();
        let number = sorted.len() * 95 / 100;
        *sorted.select_nth_unstable(number).1.max(&mut Self::LEAST.clone())
    }

    fn answered(&mut self, took: Duration) {
        if self.recent.len() == Self::RECENT {
            self.recent.pop_front();
        }
        self.recent.push_back(took);
        self.budget = (self.budget + 1).min(Self::MAX_BUDGET);
    }

    fn may_hedge(&mut self) -> bool {
        let left = self.budget.checked_sub(Self::COST);
        self.budget = left.unwrap_or(self.budget);
        left.is_some()
    }
}

/// The weight of a worker for a region. The ids of objects are hashes already, so mixing their beginning with that of the
/// worker's name is enough.
fn weight(region: &ObjectId, worker: &str) -> u64 {
    mix(mix(first_eight(region)) ^ first_eight(&ObjectId::of(worker.as_bytes())))
}

fn first_eight(id: &ObjectId) -> u64 {
    let [a, b, c, d, e, f, g, h, ..] = *id.as_bytes();
    u64::from_be_bytes([a, b, c, d, e, f, g, h])
}

/// The finalizer of SplitMix64 (Steele, Lea and Flood, 2014).
const fn mix(mut x: u64) -> u64 {
    x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joining_and_leaving_move_only_what_they_must() {
        let regions: Vec<ObjectId> = (0..2000_u32).map(|n| ObjectId::of(&n.to_be_bytes())).collect();
        let first = |region: &ObjectId, workers: u32| {
            (0..workers).max_by_key(|n| weight(region, &format!("http://worker-{n}"))).expect("one")
        };
        let moved = regions.iter().filter(|region| first(region, 7) != first(region, 8));
        // All of them to the new one: an eighth, with a standard deviation of 15.
        assert!(moved.clone().all(|region| first(region, 8) == 7));
        assert!((190..=310).contains(&moved.count()));
        for worker in 0..8 {
            let held = regions.iter().filter(|region| first(region, 8) == worker).count();
            assert!((190..=310).contains(&held), "worker {worker} is the first of {held}");
        }
    }

    #[test]
    fn second_requests_come_late_and_are_few() {
        let mut hedging = Hedging::default();
        assert_eq!(hedging.after(), Hedging::FIRST);
        for ms in 1..=100 {
            hedging.answered(Duration::from_millis(ms));
        }
        assert_eq!(hedging.after(), Duration::from_millis(96));
        assert_eq!((0..100).filter(|_| hedging.may_hedge()).count(), 10);
        (0..30).for_each(|_| hedging.answered(Duration::from_millis(1)));
        assert_eq!((0..100).filter(|_| hedging.may_hedge()).count(), 3, "a tenth");
        (0..256).for_each(|_| hedging.answered(Duration::from_micros(10)));
        assert_eq!(hedging.after(), Hedging::LEAST);
    }
}
