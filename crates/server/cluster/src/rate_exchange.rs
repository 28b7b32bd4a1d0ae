//! Rates of tokens over all gateways: each gateway reports what it accepted, and takes what others accepted from its own
//! buckets ([`SharedRates`], decision 0055).
//!
//! A report leaves at once, and a further one after [`PAUSE`]. Without news, an empty one each period says that the
//! gateway runs. Nothing is stored on the bus, and what was accepted without a connection is not reported later.

use std::collections::BTreeMap;
use std::num::NonZeroU32;
use std::time::Duration;

use bytes::Bytes;
use prost::Message;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep_until};
use veiloc_service::SharedRates;
use veiloc_service::auth::Lane;
use veiloc_service::telemetry::GatewayCounts;

use crate::ClusterError;
use crate::announcement::{MemberId, read_period};
use crate::bus::{Bus, Subject};
use crate::frame_version::{OLDEST_VERSION, check_version};
use crate::subjects;

/// Least time between two reports.
const PAUSE: Duration = Duration::from_millis(50);

/// Periods without a report after which a gateway is silent.
const SILENT_AFTER: u32 = 6;

/// How long a silent gateway is counted.
const FORGET_AFTER: Duration = Duration::from_secs(600);

/// Maximum number of clients in a report; more are sent in several.
const MAX_CLIENTS: usize = 1024;

/// Options of the exchange.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct RateExchangeOptions {
    /// What a gateway is taken to accept that fell silent without leaving. `false`, the default: nothing, as if it were
    /// dead (fail open). `true`: as much as this one, for ten minutes (fail closed).
    pub count_silent: bool,
    /// Time between two reports without news. Default 500 ms.
    pub period: Duration,
}

impl Default for RateExchangeOptions {
    fn default() -> Self {
        Self { count_silent: false, period: Duration::from_millis(500) }
    }
}

/// What a gateway accepted since its last report.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Report {
    gateway: MemberId,
    period: Duration,
    leaving: bool,
    spent: Vec<(Lane, NonZeroU32)>,
}

#[derive(Clone, PartialEq, Message)]
struct ReportFrame {
    #[prost(fixed32, tag = "1")]
    version: u32,
    #[prost(bytes = "bytes", tag = "2")]
    gateway: Bytes,
    #[prost(fixed32, tag = "3")]
    period_ms: u32,
    #[prost(fixed32, tag = "4")]
    leaving: u32,
    #[prost(bytes = "bytes", tag = "5")]
    lanes: Bytes,
    #[prost(fixed32, repeated, tag = "6")]
    requests: Vec<u32>,
}

impl Report {
    fn encode(&self) -> Bytes {
        let frame = ReportFrame {
            version: OLDEST_VERSION,
            gateway: Bytes::copy_from_slice(self.gateway.as_bytes()),
            period_ms: u32::try_from(self.period.as_millis()).unwrap_or(u32::MAX),
            leaving: self.leaving.into(),
            lanes: self.spent.iter().flat_map(|(lane, _)| *lane.as_bytes()).collect::<Vec<u8>>().into(),
            requests: self.spent.iter().map(|(_, requests)| requests.get()).collect(),
        };
        frame.encode_to_vec().into()
    }

    fn decode(bytes: Bytes) -> Result<Self, ClusterError> {
        let frame = ReportFrame::decode(bytes).map_err(|_| ClusterError::Frame)?;
        check_version(frame.version)?;
        let field = |field| ClusterError::FrameField { field };
        let gateway: [u8; 16] = frame.gateway.as_ref().try_into().map_err(|_| field("gateway"))?;
        let period = read_period(frame.period_ms)?;
        let (lanes, rest) = frame.lanes.as_chunks::<32>();
        if !rest.is_empty() || lanes.len() > MAX_CLIENTS {
            return Err(field("lanes"));
        }
        let requests: Option<Vec<NonZeroU32>> = frame.requests.iter().copied().map(NonZeroU32::new).collect();
        let requests = requests.filter(|all| all.len() == lanes.len()).ok_or(field("requests"))?;
        Ok(Self {
            gateway: MemberId::from_bytes(gateway),
            period,
            leaving: frame.leaving != 0,
            spent: lanes.iter().map(|lane| Lane::from_bytes(*lane)).zip(requests).collect(),
        })
    }
}

/// Exchanges what is spent with the other gateways on this bus. It runs until the returned task is aborted or the bus is
/// closed; dropping the handle does not end it. When the service stops, it says so to the others.
///
/// # Errors
/// [`ClusterError`]: the system has no randomness, or the bus is closed.
pub async fn share_rates(
    bus: &Bus,
    rates: SharedRates,
    options: RateExchangeOptions,
    counts: GatewayCounts,
) -> Result<JoinHandle<()>, ClusterError> {
    let subject = subjects::of_gateways()?;
    let mut reports = bus.listen(&subject).await?;
    let (bus, own) = (bus.clone(), MemberId::draw()?);
    let mut exchange =
        Exchange { bus, subject, own, rates, options, counts, others: BTreeMap::new(), has_warned: false };
    Ok(tokio::spawn(async move {
        let (mut next, mut earliest, mut has_news) = (Instant::now(), Instant::now(), false);
        loop {
            exchange.count_gateways(Instant::now());
            let due = if has_news { earliest.min(next) } else { next };
            tokio::select! {
                report = reports.next() => match report {
                    Some(bytes) => exchange.received(bytes, Instant::now()),
                    None => return,
                },
                () = exchange.rates.changed(), if !has_news => has_news = true,
                () = sleep_until(due) => {
                    exchange.report().await;
                    let now = Instant::now();
                    (next, earliest, has_news) = (now + exchange.options.period, now + PAUSE, false);
                }
            }
        }
    }))
}

struct Exchange {
    bus: Bus,
    subject: Subject,
    own: MemberId,
    rates: SharedRates,
    options: RateExchangeOptions,
    counts: GatewayCounts,
    others: BTreeMap<MemberId, Other>,
    has_warned: bool,
}

/// Another gateway.
struct Other {
    period: Duration,
    heard: Instant,
    is_silent: bool,
}

impl Exchange {
    /// Reports what was accepted here since the last time, and that this gateway runs.
    async fn report(&self) {
        let spent = self.rates.take_spent();
        if !self.bus.is_connected() {
            return;
        }
        let empty: &[_] = &[];
        let parts = spent.chunks(MAX_CLIENTS);
        let parts: Vec<_> = if spent.is_empty() { vec![empty] } else { parts.collect() };
        for part in parts {
            let (gateway, period, leaving) = (self.own, self.options.period, self.rates.is_stopping());
            let report = Report { gateway, period, leaving, spent: part.to_vec() };
            if let Err(error) = self.bus.publish(&self.subject, report.encode()).await {
                tracing::warn!(%error, "what clients spend cannot be reported to other gateways");
            }
        }
    }

    fn received(&mut self, bytes: Bytes, now: Instant) {
        let report = match Report::decode(bytes) {
            Ok(report) => report,
            Err(error) => {
                if !std::mem::replace(&mut self.has_warned, true) {
                    tracing::warn!(%error, "an invalid report of a gateway was received; further ones are not logged");
                }
                return;
            }
        };
        if report.gateway == self.own {
            return;
        }
        if report.leaving {
            self.others.remove(&report.gateway);
        } else {
            let other = Other { period: report.period, heard: now, is_silent: false };
            let before = self.others.insert(report.gateway, other);
            if before.is_none_or(|before| before.is_silent) {
                tracing::info!(gateway = %report.gateway, "another gateway reports what its clients spend");
            }
        }
        for (lane, requests) in report.spent {
            self.counts.peer_requests(requests.get());
            self.rates.charge(lane, requests);
        }
    }

    /// Notices gateways that fell silent.
    fn count_gateways(&mut self, now: Instant) {
        self.others.retain(|_, other| now < other.heard + FORGET_AFTER);
        for (id, other) in &mut self.others {
            if !other.is_silent && now > other.heard + other.period * SILENT_AFTER {
                other.is_silent = true;
                tracing::warn!(
                    gateway = %id,
                    "another gateway is silent: what its clients spend is not known here"
                );
            }
        }
        let silent = self.others.values().filter(|other| other.is_silent).count();
        self.counts.gateways(self.others.len() - silent, silent);
        let one_and = |more: usize| NonZeroU32::MIN.saturating_add(u32::try_from(more).unwrap_or(u32::MAX));
        let weight = one_and(if self.options.count_silent { silent } else { 0 });
        self.rates.set_gateways(one_and(self.others.len()), weight);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report() -> Report {
        let requests = NonZeroU32::MIN.saturating_add(4);
        Report {
            gateway: MemberId::from_bytes([7; 16]),
            period: Duration::from_millis(500),
            leaving: false,
            spent: vec![(Lane::from_bytes([1; 32]), requests), (Lane::from_bytes([2; 32]), NonZeroU32::MIN)],
        }
    }

    #[test]
    fn reports_round_trip() {
        for leaving in [false, true] {
            for spent in [Vec::new(), report().spent] {
                let sent = Report { leaving, spent, ..report() };
                assert_eq!(Report::decode(sent.encode()).expect("read"), sent);
            }
        }
    }

    #[test]
    fn invalid_reports_name_the_field() {
        let read = |change: &dyn Fn(&mut ReportFrame)| {
            let mut frame = ReportFrame::decode(report().encode()).expect("a frame");
            change(&mut frame);
            Report::decode(frame.encode_to_vec().into()).expect_err("refused").to_string()
        };
        let field = |field| ClusterError::FrameField { field }.to_string();
        assert_eq!(read(&|f| f.version = 1), ClusterError::FrameVersion { found: 1 }.to_string());
        assert_eq!(read(&|f| f.gateway = Bytes::from_static(b"short")), field("gateway"));
        assert_eq!(read(&|f| f.period_ms = 0), field("period_ms"));
        assert_eq!(read(&|f| f.lanes = f.lanes.slice(1..)), field("lanes"));
        assert_eq!(read(&|f| f.requests[0] = 0), field("requests"));
        assert_eq!(read(&|f| f.requests.push(1)), field("requests"));
        assert!(matches!(Report::decode(Bytes::from_static(b"\xff\xff garbage")), Err(ClusterError::Frame)));
    }
}
