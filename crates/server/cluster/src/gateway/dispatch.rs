//! Sends a request to one group until a member answers, with hedging and retries: the same request again when a
//! member is slow, busy, gone, or replies invalidly.

use crate::ClusterError;
use std::time::Duration;

use crate::bus::{Bus, Subject};
use bytes::Bytes;
use futures_util::StreamExt as _;
use futures_util::stream::FuturesUnordered;
use std::num::NonZeroU64;
use tokio::time::{Instant, sleep_until};
use veiloc_map::regions::ObjectId;
use veiloc_service::LocalizeFailure;
use veiloc_service::telemetry::GatewayCounts;

use super::latency_tracker::LatencyTracker;
use crate::message::{RejectReason, Reply, ReplyOutcome, Request, RequestIdBytes, Task};

/// Maximum number of messages to one group per request.
const MAX_MESSAGES: usize = 8;

/// Pause after a failed message before the next one; doubles after each further failure.
const PAUSE: Duration = Duration::from_millis(10);

/// After this fraction of the time limit a hedge is always allowed: a member that has not answered by then is
/// considered dead.
const FORCED_HEDGE_DIVISOR: u32 = 4;

/// Retry interval when no member is reachable.
const RETRY_AFTER: NonZeroU64 = NonZeroU64::MIN;

/// State shared by all requests of a gateway.
pub(crate) struct Dispatcher<'a> {
    pub(crate) bus: &'a Bus,
    pub(crate) counts: &'a GatewayCounts,
    pub(crate) latency: &'a LatencyTracker,
}

/// A request to one group.
pub(crate) struct GroupRequest<'a> {
    pub(crate) group: &'a (Subject, ObjectId),
    pub(crate) name: RequestIdBytes,
    pub(crate) task: Task,
    pub(crate) deadline: Instant,
}

/// Why a message brought no answer.
enum MessageFailure {
    NoResponders,
    Rejected(RejectReason),
    NoReply,
    BadReply,
    Closed,
}

impl Dispatcher<'_> {
    /// Returns the answer of the group: regions or a pose, or why there is none.
    pub(crate) async fn dispatch(&self, request: &GroupRequest<'_>) -> Result<ReplyOutcome, LocalizeFailure> {
        let begun = Instant::now();
        let time = request.deadline.saturating_duration_since(begun);
        let forced_hedge_at = begun + time / FORCED_HEDGE_DIVISOR;
        let (mut hedge_delay, mut pause) = (self.latency.hedge_after(), PAUSE);
        let (mut sent, mut next) = (0, begun);
        let mut in_flight = FuturesUnordered::new();
        let mut why = LocalizeFailure::TimedOut;
        self.latency.record_request();
        loop {
            tokio::select! {
                Some(end) = in_flight.next(), if !in_flight.is_empty() => match end {
                    Ok(outcome) => {
                        // The remaining messages are dropped with the request, which cancels them.
                        (0..in_flight.len()).for_each(|_| self.counts.message("superseded"));
                        return Ok(outcome);
                    }
                    Err(failed) => {
                        why = self.record_failure(failed);
                        if sent == MAX_MESSAGES && in_flight.is_empty() {
                            return Err(why);
                        }
                        // Other messages in flight may still be answered; one more is sent in addition.
                        next = next.min(Instant::now() + pause);
                        pause *= 2;
                    }
                },
                () = sleep_until(next), if sent < MAX_MESSAGES => {
                    let now = Instant::now();
                    let is_hedge = !in_flight.is_empty();
                    if !is_hedge || now >= forced_hedge_at || self.latency.take_hedge() {
                        if is_hedge {
                            self.counts.hedged();
                        }
                        sent += 1;
                        in_flight.push(self.send(request));
                    }
                    next = now + hedge_delay;
                    hedge_delay *= 2;
                }
                () = sleep_until(request.deadline) => return Err(why),
            }
        }
    }

    /// Counts the failure; returns the result if no other message succeeds.
    fn record_failure(&self, failed: MessageFailure) -> LocalizeFailure {
        let (end, why) = match failed {
            MessageFailure::NoResponders => {
                ("no-subscriber", LocalizeFailure::Unreached { retry_after: RETRY_AFTER })
            }
            MessageFailure::Rejected(RejectReason::Busy { retry_after }) => {
                ("rejected", LocalizeFailure::Busy { retry_after })
            }
            // The member that works on the request has received its own message.
            MessageFailure::Rejected(RejectReason::InProgress) => ("rejected", LocalizeFailure::TimedOut),
            MessageFailure::Rejected(RejectReason::Broken) => ("rejected", LocalizeFailure::Broken),
            MessageFailure::Rejected(
                RejectReason::Leaving | RejectReason::NotHeld | RejectReason::Undecodable,
            ) => ("rejected", LocalizeFailure::Unreached { retry_after: RETRY_AFTER }),
            MessageFailure::NoReply => ("no-reply", LocalizeFailure::TimedOut),
            MessageFailure::BadReply => {
                ("invalid-reply", LocalizeFailure::Unreached { retry_after: RETRY_AFTER })
            }
            MessageFailure::Closed => ("no-reply", LocalizeFailure::Unreached { retry_after: RETRY_AFTER }),
        };
        self.counts.message(end);
        why
    }

    /// Sends one message and waits for its reply.
    async fn send(&self, request: &GroupRequest<'_>) -> Result<ReplyOutcome, MessageFailure> {
        let begun = Instant::now();
        let (subject, object) = request.group;
        let within = request.deadline.saturating_duration_since(begun);
        let message = Request { name: request.name, object: *object, within, task: request.task.clone() };
        let sent = self.bus.request_cancellable(subject, message.encode(), within).await;
        let reply: Bytes = sent.map_err(|error| match error {
            ClusterError::NoResponders { .. } => MessageFailure::NoResponders,
            ClusterError::TimedOut { .. } => MessageFailure::NoReply,
            _ => MessageFailure::Closed,
        })?;
        let Reply { outcome, worked, waited, .. } = Reply::decode(reply, &request.name).map_err(|error| {
            tracing::warn!(%error, %subject, "a worker sent an invalid reply");
            MessageFailure::BadReply
        })?;
        let fits = match (&outcome, &request.task) {
            (ReplyOutcome::Rejected(why), _) => return Err(MessageFailure::Rejected(*why)),
            // Cancelled by the worker, not by us: another member continues.
            (ReplyOutcome::Failed(LocalizeFailure::Stopped), _) => {
                return Err(MessageFailure::Rejected(RejectReason::Leaving));
            }
            (ReplyOutcome::Failed(_), Task::Search { .. } | Task::Pose { .. }) => true,
            (ReplyOutcome::Regions(_), Task::Search { .. }) => true,
            (ReplyOutcome::Pose(_), Task::Pose { .. }) => true,
            _ => false,
        };
        if !fits {
            return Err(MessageFailure::BadReply);
        }
        let took = begun.elapsed();
        self.latency.record(took);
        self.counts.message("answered");
        self.counts.round_trip(took.saturating_sub(worked).saturating_sub(waited));
        Ok(outcome)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use veiloc_service::telemetry::{GaugeValues, Metrics, MetricsOptions};

    use super::*;
    use crate::gateway::latency_tracker::{INITIAL_DELAY, MAX_DELAY, MIN_DELAY};

    const MINUTE: Duration = Duration::from_secs(60);

    /// A group of members with chosen latencies, with a paused clock.
    struct Group {
        bus: Bus,
        region: (Subject, ObjectId),
        counts: GatewayCounts,
        latency: LatencyTracker,
    }

    impl Group {
        fn new() -> Self {
            let subject = Subject::new(["veiloc", "test", "region"]).expect("a subject");
            Self {
                bus: Bus::in_process(),
                region: (subject, ObjectId::of(b"region")),
                counts: GatewayCounts::default(),
                latency: LatencyTracker::default(),
            }
        }

        /// A member that answers after this latency, or never. Counts received and cancelled requests.
        async fn member(&self, latency: Option<Duration>) -> [Arc<AtomicUsize>; 2] {
            let counts = [Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0))];
            let mut membership = self.bus.join(&self.region.0).await.expect("joined");
            let [answered_count, cancelled] = counts.clone();
            tokio::spawn(async move {
                while let Some(mut incoming) = membership.next().await {
                    answered_count.fetch_add(1, Ordering::Relaxed);
                    let cancelled = cancelled.clone();
                    tokio::spawn(async move {
                        let request = Request::decode(incoming.payload.clone()).expect("a request");
                        tokio::select! {
                            () = answered_after(latency) => {
                                let outcome = ReplyOutcome::Regions(Vec::new());
                                let (worked, waited) = (Duration::ZERO, Duration::ZERO);
                                let reply = Reply { name: request.name, outcome, worked, waited };
                                incoming.answer(reply.encode()).await.expect("sent");
                            }
                            () = incoming.cancelled() => {
                                cancelled.fetch_add(1, Ordering::Relaxed);
                            }
                        }
                    });
                }
            });
            counts
        }

        /// Sends a request; returns its result and duration.
        async fn ask(&self) -> (Result<ReplyOutcome, LocalizeFailure>, Duration) {
            let dispatcher = Dispatcher { bus: &self.bus, counts: &self.counts, latency: &self.latency };
            let begun = Instant::now();
            let task = Task::Search { globals: vec![Bytes::from_static(b"an image")] };
            let request = GroupRequest { group: &self.region, name: [7; 16], task, deadline: begun + MINUTE };
            (dispatcher.dispatch(&request).await, begun.elapsed())
        }

        fn hedges(&self) -> u64 {
            let metrics =
                Metrics::new(&MetricsOptions { gateway: Some(&self.counts), ..MetricsOptions::default() });
            let text = metrics.text(&GaugeValues::default());
            let hedges = text.lines().find_map(|line| line.strip_prefix("veiloc_cluster_hedges_total "));
            hedges.expect("it is counted").parse().expect("a count")
        }
    }

    async fn answered_after(latency: Option<Duration>) {
        match latency {
            Some(latency) => tokio::time::sleep(latency).await,
            None => std::future::pending().await,
        }
    }

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn sum(counts: &AtomicUsize) -> usize {
        counts.load(Ordering::Relaxed)
    }

    #[tokio::test(start_paused = true)]
    async fn silent_member_is_hedged() {
        let group = Group::new();
        let [answered_count, _] = group.member(Some(ms(100))).await;
        let [silent_count, cancelled] = group.member(None).await;
        // Members take turns: each first message goes to the silent one, because each second goes to the other.
        let mut times = Vec::new();
        for _ in 0..4 {
            let (outcome, time) = group.ask().await;
            assert!(matches!(outcome, Ok(ReplyOutcome::Regions(_))));
            times.push(time);
        }
        // The first time uses the initial delay; then 1.5 times the recent latency.
        assert_eq!(times, [INITIAL_DELAY + ms(100), ms(250), ms(250), ms(250)]);
        assert_eq!((sum(&silent_count), sum(&answered_count), group.hedges()), (4, 4, 4));
        // The silent member receives the cancel messages as soon as it runs.
        tokio::time::sleep(ms(1)).await;
        assert_eq!(sum(&cancelled), 4);
    }

    #[tokio::test(start_paused = true)]
    async fn hedge_delay_follows_recent_latencies() {
        for (latency, after) in [(ms(1), MIN_DELAY), (ms(200), ms(300)), (Duration::from_secs(9), MAX_DELAY)]
        {
            let group = Group::new();
            (0..20).for_each(|_| group.latency.record(latency));
            let [silent_count, _] = group.member(None).await;
            let [answered_count, _] = group.member(Some(ms(5))).await;
            while sum(&silent_count) == 0 {
                let before = sum(&answered_count);
                let (outcome, time) = group.ask().await;
                assert!(outcome.is_ok() && sum(&answered_count) == before + 1);
                assert_eq!(time, if sum(&silent_count) == 0 { ms(5) } else { after + ms(5) });
            }
        }
    }

    #[tokio::test(start_paused = true)]
    async fn silent_group_times_out() {
        let group = Group::new();
        let [silent_count, _] = group.member(None).await;
        let (outcome, time) = group.ask().await;
        assert!(matches!(outcome, Err(LocalizeFailure::TimedOut)));
        assert_eq!(time, MINUTE);
        assert!((2..=MAX_MESSAGES).contains(&sum(&silent_count)), "{}", sum(&silent_count));
    }

    #[tokio::test(start_paused = true)]
    async fn empty_group_is_retried_and_reported() {
        let group = Group::new();
        let (outcome, time) = group.ask().await;
        assert!(matches!(outcome, Err(LocalizeFailure::Unreached { .. })));
        // Pauses of 10, 20, … 640 ms between eight messages.
        assert_eq!(time, PAUSE * 127);
    }
}
