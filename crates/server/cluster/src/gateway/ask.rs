//! Asking one group, until somebody answers: the same question again when a member is slow, busy, gone or says nonsense.

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
use crate::message::{Outcome, Reply, Request, RequestName, Wanted, Why};

/// Messages to one group for one question.
const MOST_MESSAGES: usize = 8;

/// The pause after a member that could not, before another one is asked; after each further one twice as long.
const PAUSE: Duration = Duration::from_millis(10);

/// Of the time there is, a second message may always be sent after this part: whoever has not answered then is gone.
const LAST_RESORT: u32 = 4;

/// When to come back when nobody is there.
const COME_BACK: NonZeroU64 = NonZeroU64::MIN;

/// What all questions of a gateway share.
pub(crate) struct Route<'a> {
    pub(crate) bus: &'a Bus,
    pub(crate) counts: &'a GatewayCounts,
    pub(crate) latency: &'a LatencyTracker,
}

/// A question to one group.
pub(crate) struct Ask<'a> {
    pub(crate) group: &'a (Subject, ObjectId),
    pub(crate) name: RequestName,
    pub(crate) wanted: Wanted,
    pub(crate) deadline: Instant,
}

/// How a message ended that brought no answer.
enum Failed {
    Nobody,
    TurnedAway(Why),
    NoReply,
    BadReply,
    Closed,
}

impl Route<'_> {
    /// What the group says: regions or a pose, or why there is none.
    pub(crate) async fn ask(&self, ask: &Ask<'_>) -> Result<Outcome, LocalizeFailure> {
        let begun = Instant::now();
        let time = ask.deadline.saturating_duration_since(begun);
        let last_resort = begun + time / LAST_RESORT;
        let (mut gap, mut pause) = (self.latency.hedge_after(), PAUSE);
        let (mut sent, mut next) = (0, begun);
        let mut under_way = FuturesUnordered::new();
        let mut why = LocalizeFailure::TimedOut;
        self.latency.record_request();
        loop {
            tokio::select! {
                Some(end) = under_way.next(), if !under_way.is_empty() => match end {
                    Ok(outcome) => {
                        // Dropped with the question, which whoever is at them is told.
                        (0..under_way.len()).for_each(|_| self.counts.message("not-needed"));
                        return Ok(outcome);
                    }
                    Err(failed) => {
                        why = self.of_failed(failed);
                        if sent == MOST_MESSAGES && under_way.is_empty() {
                            return Err(why);
                        }
                        // Others who are at it may still answer; beside them another one is asked.
                        next = next.min(Instant::now() + pause);
                        pause *= 2;
                    }
                },
                () = sleep_until(next), if sent < MOST_MESSAGES => {
                    let now = Instant::now();
                    let is_second = !under_way.is_empty();
                    if !is_second || now >= last_resort || self.latency.may_hedge() {
                        if is_second {
                            self.counts.hedged();
                        }
                        sent += 1;
                        under_way.push(self.send(ask));
                    }
                    next = now + gap;
                    gap *= 2;
                }
                () = sleep_until(ask.deadline) => return Err(why),
            }
        }
    }

    /// Counts it; what the question ends with when nobody does better.
    fn of_failed(&self, failed: Failed) -> LocalizeFailure {
        let (end, why) = match failed {
            Failed::Nobody => ("nobody", LocalizeFailure::Unreached { retry_after: COME_BACK }),
            Failed::TurnedAway(Why::Busy { retry_after }) => {
                ("turned-away", LocalizeFailure::Busy { retry_after })
            }
            // The one that is at it has its own message.
            Failed::TurnedAway(Why::AtIt) => ("turned-away", LocalizeFailure::TimedOut),
            Failed::TurnedAway(Why::Broken) => ("turned-away", LocalizeFailure::Broken),
            Failed::TurnedAway(Why::Leaving | Why::NotHeld | Why::Unread) => {
                ("turned-away", LocalizeFailure::Unreached { retry_after: COME_BACK })
            }
            Failed::NoReply => ("no-reply", LocalizeFailure::TimedOut),
            Failed::BadReply => ("bad-reply", LocalizeFailure::Unreached { retry_after: COME_BACK }),
            Failed::Closed => ("no-reply", LocalizeFailure::Unreached { retry_after: COME_BACK }),
        };
        self.counts.message(end);
        why
    }

    /// One message, and what becomes of it.
    async fn send(&self, ask: &Ask<'_>) -> Result<Outcome, Failed> {
        let begun = Instant::now();
        let (subject, object) = ask.group;
        let within = ask.deadline.saturating_duration_since(begun);
        let request = Request { name: ask.name, object: *object, within, wanted: ask.wanted.clone() };
        let sent = self.bus.request_cancellable(subject, request.encode(), within).await;
        let reply: Bytes = sent.map_err(|error| match error {
            ClusterError::Nobody { .. } => Failed::Nobody,
            ClusterError::TimedOut { .. } => Failed::NoReply,
            _ => Failed::Closed,
        })?;
        let Reply { outcome, worked, waited, .. } = Reply::decode(reply, &ask.name).map_err(|error| {
            tracing::warn!(%error, %subject, "a worker's reply was not understood");
            Failed::BadReply
        })?;
        let fits = match (&outcome, &ask.wanted) {
            (Outcome::Rejected(why), _) => return Err(Failed::TurnedAway(*why)),
            // Given up there and not here: somebody else goes on.
            (Outcome::LocalizeFailure(LocalizeFailure::Stopped), _) => return Err(Failed::TurnedAway(Why::Leaving)),
            (Outcome::LocalizeFailure(_), Wanted::Search { .. } | Wanted::Pose { .. }) => true,
            (Outcome::Regions(_), Wanted::Search { .. }) => true,
            (Outcome::Pose(_), Wanted::Pose { .. }) => true,
            _ => false,
        };
        if !fits {
            return Err(Failed::BadReply);
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

    use veiloc_service::telemetry::{Metrics, MetricsOptions, GaugeValues};

    use super::*;
    use crate::gateway::latency_tracker::{LATEST, SOONEST, UNKNOWN};

    const MINUTE: Duration = Duration::from_secs(60);

    /// A group of members whose latencies the test chooses, asked by a clock that is paused.
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

        /// A member that answers after so long, or never; how often it was asked, and told that nobody waits.
        async fn member(&self, latency: Option<Duration>) -> [Arc<AtomicUsize>; 2] {
            let counts = [Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0))];
            let mut membership = self.bus.join(&self.region.0).await.expect("joined");
            let [asked, cancelled] = counts.clone();
            tokio::spawn(async move {
                while let Some(mut incoming) = membership.next().await {
                    asked.fetch_add(1, Ordering::Relaxed);
                    let cancelled = cancelled.clone();
                    tokio::spawn(async move {
                        let request = Request::decode(incoming.payload.clone()).expect("a request");
                        tokio::select! {
                            () = answered_after(latency) => {
                                let outcome = Outcome::Regions(Vec::new());
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

        /// What comes of a question, and after how long.
        async fn ask(&self) -> (Result<Outcome, LocalizeFailure>, Duration) {
            let route = Route { bus: &self.bus, counts: &self.counts, latency: &self.latency };
            let begun = Instant::now();
            let wanted = Wanted::Search { globals: vec![Bytes::from_static(b"an image")] };
            let ask = Ask { group: &self.region, name: [7; 16], wanted, deadline: begun + MINUTE };
            (route.ask(&ask).await, begun.elapsed())
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
    async fn a_second_member_is_asked_when_the_first_is_silent() {
        let group = Group::new();
        let [asked, _] = group.member(Some(ms(100))).await;
        let [heard, cancelled] = group.member(None).await;
        // Members take turns: the silent one is first each time, for the other one is second.
        let mut times = Vec::new();
        for _ in 0..4 {
            let (outcome, time) = group.ask().await;
            assert!(matches!(outcome, Ok(Outcome::Regions(_))));
            times.push(time);
        }
        // Nothing is known the first time; then half as long again as the slowest of late.
        assert_eq!(times, [UNKNOWN + ms(100), ms(250), ms(250), ms(250)]);
        assert_eq!((sum(&heard), sum(&asked), group.hedges()), (4, 4, 4));
        // Those who answer nobody are told, as soon as they get to run.
        tokio::time::sleep(ms(1)).await;
        assert_eq!(sum(&cancelled), 4);
    }

    #[tokio::test(start_paused = true)]
    async fn the_second_message_follows_the_latencies_of_late() {
        for (latency, after) in [(ms(1), SOONEST), (ms(200), ms(300)), (Duration::from_secs(9), LATEST)] {
            let group = Group::new();
            (0..20).for_each(|_| group.latency.record(latency));
            let [heard, _] = group.member(None).await;
            let [asked, _] = group.member(Some(ms(5))).await;
            while sum(&heard) == 0 {
                let before = sum(&asked);
                let (outcome, time) = group.ask().await;
                assert!(outcome.is_ok() && sum(&asked) == before + 1);
                assert_eq!(time, if sum(&heard) == 0 { ms(5) } else { after + ms(5) });
            }
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_group_that_is_silent_is_waited_for_until_the_deadline() {
        let group = Group::new();
        let [heard, _] = group.member(None).await;
        let (outcome, time) = group.ask().await;
        assert!(matches!(outcome, Err(LocalizeFailure::TimedOut)));
        assert_eq!(time, MINUTE);
        assert!((2..=MOST_MESSAGES).contains(&sum(&heard)), "{}", sum(&heard));
    }

    #[tokio::test(start_paused = true)]
    async fn an_empty_group_is_asked_again_and_reported() {
        let group = Group::new();
        let (outcome, time) = group.ask().await;
        assert!(matches!(outcome, Err(LocalizeFailure::Unreached { .. })));
        // Pauses of 10, 20, … 640 ms between eight messages.
        assert_eq!(time, PAUSE * 127);
    }
}
