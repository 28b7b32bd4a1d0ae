//! Sends a request to a member that holds an object until one answers: to another member when the first is put out, is
//! full, leaves, never received the request, or replies invalidly.
//!
//! Whether a member runs is known by its probes (`members/watch.rs`), so a member that computes for long is left alone. Only
//! after a quarter of a query's time a second member is asked as well, for the case that the threads of the first hang.

use std::num::NonZeroU64;
use std::sync::Arc;
use std::time::Duration;

use futures_util::StreamExt as _;
use futures_util::stream::FuturesUnordered;
use tokio::time::{Instant, sleep_until};
use veiloc_map::regions::ObjectId;
use veiloc_service::LocalizeFailure;
use veiloc_service::auth::Lane;
use veiloc_service::telemetry::{GatewayCounts, OpenCall, RequestContext};

use crate::ClusterError;
use crate::announcement::MemberId;
use crate::bus::Bus;
use crate::members::{Choice, Member, Members, Work};
use crate::message::{RejectReason, Reply, ReplyOutcome, Request, RequestIdBytes, Task};

/// After this fraction of the time limit a second member is asked too, although the first one runs.
const LATE_DIVISOR: u32 = 4;

/// Maximum number of messages per request about one object.
const MAX_MESSAGES: usize = 8;

/// How long a request waits in the gateway for a free place in the queue of a member, and the pause between two looks.
const WAIT_FOR_PLACE: Duration = Duration::from_secs(1);
const PLACE_PAUSE: Duration = Duration::from_millis(20);

/// Pause before a member is asked again that still works on a cancelled message of the same request.
const CANCEL_PAUSE: Duration = Duration::from_millis(50);

/// How long a request waits for a member, when no member that holds the object can be asked.
const WAIT_FOR_MEMBER: Duration = Duration::from_secs(2);

/// Retry interval when no member is reachable.
const RETRY_AFTER: NonZeroU64 = NonZeroU64::MIN;

const UNREACHED: LocalizeFailure = LocalizeFailure::Unreached { retry_after: RETRY_AFTER };

/// State shared by all requests of a gateway.
pub(crate) struct Dispatcher<'a> {
    pub(crate) bus: &'a Bus,
    pub(crate) members: &'a Members,
    pub(crate) counts: &'a GatewayCounts,
}

/// A request about one object.
pub(crate) struct ObjectRequest {
    pub(crate) object: ObjectId,
    pub(crate) name: RequestIdBytes,
    pub(crate) lane: Option<Lane>,
    pub(crate) rows: u32,
    pub(crate) task: Task,
    pub(crate) deadline: Instant,
    /// Where messages are recorded, if traces are sent.
    pub(crate) trace: Option<Arc<RequestContext>>,
}

/// Why a message brought no answer.
enum MessageFailure {
    /// The member has left, or never received it.
    NotReceived,
    Rejected(RejectReason),
    NoReply,
    BadReply,
    Closed,
}

impl MessageFailure {
    /// Its name in metrics and traces.
    const fn outcome(&self) -> &'static str {
        match self {
            Self::NotReceived => "no-subscriber",
            Self::Rejected(_) => "rejected",
            Self::NoReply | Self::Closed => "no-reply",
            Self::BadReply => "invalid-reply",
        }
    }
}

impl Dispatcher<'_> {
    /// Returns the answer of a member: regions or a pose, or why there is none.
    pub(crate) async fn dispatch(&self, request: &ObjectRequest) -> Result<ReplyOutcome, LocalizeFailure> {
        let begun = Instant::now();
        let late = begun + request.deadline.saturating_duration_since(begun) / LATE_DIVISOR;
        let work = Work::of(&request.task);
        let mut changes = self.members.changes();
        let (mut in_flight, mut put_out) = (FuturesUnordered::new(), FuturesUnordered::new());
        // Members that are not asked again: they have the request, or rejected it.
        let mut asked: Vec<MemberId> = Vec::new();
        // Members of which an answer may come.
        let mut pending: Vec<MemberId> = Vec::new();
        let (mut wants_member, mut is_late, mut sent, mut why) = (true, false, 0, UNREACHED);
        let (mut give_up, mut retry_at) = (begun + WAIT_FOR_MEMBER, None);
        loop {
            if sent == MAX_MESSAGES && in_flight.is_empty() {
                return Err(why);
            }
            if wants_member && sent < MAX_MESSAGES {
                changes.mark_unchanged();
                match self.members.choose(&request.object, request.lane, work, &asked) {
                    Choice::Ask(member) => {
                        if !in_flight.is_empty() {
                            self.counts.hedged();
                        }
                        wants_member = false;
                        sent += 1;
                        asked.push(member.id());
                        pending.push(member.id());
                        let out = member.clone();
                        put_out.push(async move {
                            out.put_out().await;
                            out.id()
                        });
                        in_flight.push(self.send(request, work, member));
                    }
                    Choice::Full { retry_after } if in_flight.is_empty() => {
                        let now = Instant::now();
                        if now >= begun + WAIT_FOR_PLACE {
                            return Err(LocalizeFailure::Busy { retry_after });
                        }
                        // What other regions have computed for the query would be lost.
                        wants_member = false;
                        retry_at = Some(now + PLACE_PAUSE);
                        give_up = now + WAIT_FOR_MEMBER;
                    }
                    Choice::NoMember if in_flight.is_empty() && is_final(why) => return Err(why),
                    Choice::Full { .. } | Choice::NoMember => {}
                }
            }
            tokio::select! {
                biased;
                Some((member, end)) = in_flight.next(), if !in_flight.is_empty() => match end {
                    Ok(outcome) => {
                        // The remaining messages are dropped with the request, which cancels them.
                        (0..in_flight.len()).for_each(|_| self.counts.message("superseded"));
                        return Ok(outcome);
                    }
                    Err(MessageFailure::Rejected(RejectReason::InProgress)) => {
                        // It was out, is back, and still works on an earlier message; if no reply to that is awaited any
                        // more, it was cancelled.
                        self.counts.message("rejected");
                        if in_flight.is_empty() {
                            pending.clear();
                            asked.retain(|id| *id != member.id());
                            retry_at = Some(Instant::now() + CANCEL_PAUSE);
                            give_up = Instant::now() + WAIT_FOR_MEMBER;
                        }
                    }
                    Err(failure) => {
                        pending.retain(|id| *id != member.id());
                        why = self.record_failure(&failure);
                        let may_ask_again = match failure {
                            MessageFailure::NotReceived => true,
                            // As soon as its queue has a free place.
                            MessageFailure::Rejected(RejectReason::Busy { .. }) => {
                                Instant::now() < begun + WAIT_FOR_PLACE
                            }
                            _ => false,
                        };
                        if may_ask_again {
                            asked.retain(|id| *id != member.id());
                        }
                        wants_member = true;
                        give_up = Instant::now() + WAIT_FOR_MEMBER;
                    }
                },
                Some(member) = put_out.next(), if !put_out.is_empty() => {
                    if pending.contains(&member) {
                        // It may be asked again when it is back.
                        asked.retain(|id| *id != member);
                        wants_member = true;
                    }
                }
                () = sleep_until(late), if !is_late && !in_flight.is_empty() => {
                    is_late = true;
                    wants_member = true;
                }
                _ = changes.changed(), if wants_member => {}
                () = sleep_until(retry_at.unwrap_or(request.deadline)), if retry_at.is_some() => {
                    retry_at = None;
                    wants_member = true;
                }
                () = sleep_until(give_up), if in_flight.is_empty() => return Err(why),
                () = sleep_until(request.deadline) => return Err(if in_flight.is_empty() { why } else { LocalizeFailure::TimedOut }),
            }
        }
    }

    /// Counts the failure; returns the result if no other message succeeds.
    fn record_failure(&self, failure: &MessageFailure) -> LocalizeFailure {
        self.counts.message(failure.outcome());
        match failure {
            MessageFailure::Rejected(RejectReason::Busy { retry_after }) => {
                LocalizeFailure::Busy { retry_after: *retry_after }
            }
            MessageFailure::Rejected(RejectReason::InProgress) | MessageFailure::NoReply => {
                LocalizeFailure::TimedOut
            }
            MessageFailure::Rejected(RejectReason::Broken) => LocalizeFailure::Broken,
            MessageFailure::Rejected(
                RejectReason::Leaving | RejectReason::NotHeld | RejectReason::Undecodable,
            )
            | MessageFailure::NotReceived
            | MessageFailure::BadReply
            | MessageFailure::Closed => UNREACHED,
        }
    }

    /// Sends one message and waits for its reply.
    async fn send(
        &self,
        request: &ObjectRequest,
        work: Work,
        member: Arc<Member>,
    ) -> (Arc<Member>, Result<ReplyOutcome, MessageFailure>) {
        let result = self.ask(request, work, &member).await;
        match &result {
            Err(MessageFailure::Rejected(RejectReason::Busy { retry_after })) => {
                member.set_refused(request.lane, *retry_after);
            }
            Err(MessageFailure::Rejected(RejectReason::Leaving)) => member.set_leaving(),
            Err(MessageFailure::Rejected(RejectReason::NotHeld)) => member.set_not_held(&request.object),
            Err(MessageFailure::BadReply) => self.members.put_out(&member),
            _ => {}
        }
        (member, result)
    }

    async fn ask(
        &self,
        request: &ObjectRequest,
        work: Work,
        member: &Arc<Member>,
    ) -> Result<ReplyOutcome, MessageFailure> {
        let begun = Instant::now();
        let within = request.deadline.saturating_duration_since(begun);
        let mut call = request.trace.as_ref().map(|trace| trace.call(member.id().to_string()));
        let result = self.ask_traced(request, work, member, begun, within, call.as_mut()).await;
        if let Some(call) = &mut call {
            call.set_outcome(match &result {
                Ok(_) => "answered",
                Err(failure) => failure.outcome(),
            });
        }
        result
    }

    async fn ask_traced(
        &self,
        request: &ObjectRequest,
        work: Work,
        member: &Arc<Member>,
        begun: Instant,
        within: Duration,
        call: Option<&mut OpenCall>,
    ) -> Result<ReplyOutcome, MessageFailure> {
        let message = Request {
            version: member.version(),
            span: call.map(|call| call.span()),
            name: request.name,
            object: request.object,
            lane: request.lane,
            rows: request.rows,
            within,
            task: request.task.clone(),
        };
        let mut asked = member.ask(request.name, request.object, request.lane, work);
        let reply = tokio::select! {
            // The request is sent first. A reply that came counts, also when the member no longer knows the request.
            biased;
            reply = self.bus.request_cancellable(member.subject(), message.encode(), within) => reply,
            () = asked.lost() => return Err(MessageFailure::NotReceived),
        };
        let reply = reply.map_err(|error| match error {
            ClusterError::NoResponders { .. } => {
                self.members.remove(member);
                MessageFailure::NotReceived
            }
            ClusterError::TimedOut { .. } => MessageFailure::NoReply,
            _ => MessageFailure::Closed,
        })?;
        let Reply { outcome, worked, waited, load, .. } =
            Reply::decode(reply, &request.name).map_err(|error| {
                tracing::warn!(%error, member = %member.id(), "a worker sent an invalid reply");
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
        asked.answered(took.saturating_sub(waited), load);
        self.counts.message("answered");
        self.counts.round_trip(took.saturating_sub(worked).saturating_sub(waited));
        Ok(outcome)
    }
}

/// Whether waiting for another member is useless after this failure.
const fn is_final(why: LocalizeFailure) -> bool {
    matches!(why, LocalizeFailure::Busy { .. } | LocalizeFailure::Broken)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering};

    use bytes::Bytes;
    use veiloc_service::BodyKind;
    use veiloc_service::auth::TokenKey;
    use veiloc_service::telemetry::{GaugeValues, Metrics, MetricsOptions};

    use super::*;
    use crate::announcement::Announcement;
    use crate::frame_version::FrameVersions;
    use crate::members::Role;
    use crate::message::Load;
    use crate::subjects;

    const MAP: &str = "test";
    const MINUTE: Duration = Duration::from_secs(60);
    /// Longer than all pauses between probes.
    const SECOND: Duration = Duration::from_secs(1);

    /// Members with chosen behaviour, with a paused clock.
    struct Group {
        bus: Bus,
        members: Members,
        counts: GatewayCounts,
        names: AtomicU32,
    }

    /// What a member does, and how often it was asked.
    #[derive(Default)]
    struct Behaviour {
        /// Answers requests after this time; never, if it is `None`.
        answers_after: Option<Duration>,
        /// Answers neither requests nor pings while this is true.
        hangs: AtomicBool,
        /// Loses the next requests, as a NATS node that dies does.
        loses: AtomicUsize,
        /// Rejects requests.
        rejects: Option<RejectReason>,
        /// Refuses requests while this many are in work.
        capacity: Option<usize>,
        in_work: AtomicUsize,
        /// Says of the next requests that it still works on them.
        still_works: AtomicUsize,
        load: Load,
        asked: AtomicUsize,
        pinged: AtomicUsize,
        cancelled: AtomicUsize,
    }

    impl Behaviour {
        fn answering(after: Duration) -> Self {
            Self { answers_after: Some(after), load: Load { jobs: 0, free: 32 }, ..Self::default() }
        }

        fn asked(&self) -> usize {
            self.asked.load(Ordering::Relaxed)
        }
    }

    fn object() -> ObjectId {
        ObjectId::of(b"region")
    }

    impl Group {
        async fn new() -> Self {
            let bus = Bus::in_process();
            let members = Members::listen(&bus, MAP, Role::Gateway).await.expect("a table");
            Self { bus, members, counts: GatewayCounts::default(), names: AtomicU32::new(0) }
        }

        /// A member that announces itself; returns when it can be asked.
        async fn member(&self, behaviour: Behaviour) -> Arc<Behaviour> {
            let [before, _] = self.members.counts();
            // Members are chosen in the order of their ids.
            let (id, behaviour) = (MemberId::from_bytes([before as u8; 16]), Arc::new(behaviour));
            let mut requests =
                self.bus.join(&subjects::of_member(MAP, &id).expect("a subject")).await.expect("joined");
            let (bus, does) = (self.bus.clone(), behaviour.clone());
            let announcement = Announcement {
                versions: FrameVersions::OWN,
                member: id,
                period: SECOND / 2,
                leaving: false,
                threads: 1,
                load: behaviour.load,
                objects: [object()].into(),
                placed: None,
            };
            tokio::spawn(async move {
                loop {
                    if !does.hangs.load(Ordering::Relaxed) {
                        let subject = subjects::of_members(MAP).expect("a subject");
                        bus.publish(&subject, announcement.encode()).await.expect("sent");
                    }
                    tokio::time::sleep(announcement.period).await;
                }
            });
            let does = behaviour.clone();
            tokio::spawn(async move {
                let mut known = Vec::new();
                while let Some(mut incoming) = requests.next().await {
                    let request = Request::decode(incoming.payload.clone()).expect("a request");
                    let does = does.clone();
                    let outcome = match &request.task {
                        Task::Ping { owed } => {
                            does.pinged.fetch_add(1, Ordering::Relaxed);
                            let is_unknown =
                                |(_, (name, _)): &(u32, &(RequestIdBytes, ObjectId))| !known.contains(name);
                            let unknown = (0..).zip(owed).filter(is_unknown).map(|(i, _)| i).collect();
                            ReplyOutcome::Here { unknown }
                        }
                        _ if does.loses.load(Ordering::Relaxed) > 0 => {
                            does.loses.fetch_sub(1, Ordering::Relaxed);
                            // A lost request is no cancelled one: its reply channel stays.
                            std::mem::forget(incoming);
                            continue;
                        }
                        _ => {
                            known.push(request.name);
                            does.asked.fetch_add(1, Ordering::Relaxed);
                            let still = does.still_works.load(Ordering::Relaxed);
                            does.still_works.store(still.saturating_sub(1), Ordering::Relaxed);
                            let in_progress = Some(RejectReason::InProgress).filter(|_| still > 0);
                            let retry_after = NonZeroU64::MIN;
                            let in_work = does.in_work.load(Ordering::Relaxed);
                            let full = does.capacity.filter(|capacity| in_work >= *capacity);
                            let full = full.map(|_| RejectReason::Busy { retry_after });
                            does.rejects.or(in_progress).or(full).map_or(
                                ReplyOutcome::Failed(LocalizeFailure::EmptyMap),
                                ReplyOutcome::Rejected,
                            )
                        }
                    };
                    let is_ping = matches!(request.task, Task::Ping { .. });
                    let is_refused = matches!(outcome, ReplyOutcome::Rejected(RejectReason::Busy { .. }));
                    let is_work = !is_ping && !is_refused;
                    let after = if is_work { does.answers_after } else { Some(Duration::ZERO) };
                    does.in_work.fetch_add(usize::from(is_work), Ordering::Relaxed);
                    tokio::spawn(async move {
                        tokio::select! {
                            () = answered_after(after.filter(|_| !does.hangs.load(Ordering::Relaxed))) => {
                                let (worked, waited) = (Duration::ZERO, Duration::ZERO);
                                let Request { version, name, .. } = request;
                                let reply = Reply { version, name, outcome, worked, waited, load: does.load };
                                does.in_work.fetch_sub(usize::from(is_work), Ordering::Relaxed);
                                incoming.answer(reply.encode()).await.expect("sent");
                            }
                            () = incoming.cancelled() => {
                                does.cancelled.fetch_add(usize::from(!is_ping), Ordering::Relaxed);
                            }
                        }
                    });
                }
            });
            while self.members.counts() != [before + 1, 0] {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
            behaviour
        }

        async fn ask_for(&self, lane: Option<Lane>) -> (Result<ReplyOutcome, LocalizeFailure>, Duration) {
            let dispatcher = Dispatcher { bus: &self.bus, members: &self.members, counts: &self.counts };
            let begun = Instant::now();
            let mut name = [0; 16];
            name[..4].copy_from_slice(&self.names.fetch_add(1, Ordering::Relaxed).to_be_bytes());
            let task = Task::Pose { kind: BodyKind::Query, body: Bytes::from_static(b"sealed"), near: None };
            let deadline = begun + MINUTE;
            let request =
                ObjectRequest { object: object(), name, lane, rows: 100, task, deadline, trace: None };
            (dispatcher.dispatch(&request).await, begun.elapsed())
        }

        /// Sends a request that must be answered; returns how long that took.
        async fn ask(&self) -> Duration {
            let (answer, took) = self.ask_for(None).await;
            assert!(matches!(answer.expect("an answer"), ReplyOutcome::Failed(LocalizeFailure::EmptyMap)));
            took
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

    const fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[tokio::test(start_paused = true)]
    async fn silent_member_is_put_out_after_one_missed_answer() {
        let group = Group::new().await;
        let works = group.member(Behaviour::answering(ms(20))).await;
        let hangs = group.member(Behaviour::answering(ms(20))).await;
        hangs.hangs.store(true, Ordering::Relaxed);
        let mut longest = Duration::ZERO;
        for _ in 0..10 {
            longest = longest.max(group.ask().await);
        }
        // One request waited until the member was put out; the hedge went to the other member.
        assert!(longest > ms(20) && longest < SECOND / 2, "{longest:?}");
        assert_eq!((hangs.asked(), works.asked(), group.hedges()), (1, 10, 1));
        assert_eq!(group.members.counts(), [1, 1]);
        tokio::time::sleep(ms(1)).await;
        assert_eq!(hangs.cancelled.load(Ordering::Relaxed), 1);
        // It is probed, and gets no request until it answers.
        let pinged = hangs.pinged.load(Ordering::Relaxed);
        tokio::time::sleep(SECOND * 2).await;
        assert!(hangs.pinged.load(Ordering::Relaxed) > pinged);
        assert_eq!((group.ask().await, hangs.asked()), (ms(20), 1));
        hangs.hangs.store(false, Ordering::Relaxed);
        tokio::time::sleep(SECOND * 2).await;
        assert_eq!(group.members.counts(), [2, 0]);
        for _ in 0..4 {
            assert_eq!(group.ask().await, ms(20));
        }
        assert!(hangs.asked() > 1);
    }

    /// A member whose announcements stay away is put out before a request waits for it, and then forgotten.
    #[tokio::test(start_paused = true)]
    async fn member_without_announcements_is_forgotten() {
        let group = Group::new().await;
        let works = group.member(Behaviour::answering(ms(20))).await;
        let hangs = group.member(Behaviour::answering(ms(20))).await;
        hangs.hangs.store(true, Ordering::Relaxed);
        tokio::time::sleep(SECOND * 2).await;
        assert_eq!(group.members.counts(), [1, 1]);
        for _ in 0..4 {
            assert_eq!(group.ask().await, ms(20));
        }
        assert_eq!((hangs.asked(), works.asked()), (0, 4));
        tokio::time::sleep(SECOND * 2).await;
        assert_eq!(group.members.counts(), [1, 0]);
        hangs.hangs.store(false, Ordering::Relaxed);
        tokio::time::sleep(SECOND).await;
        assert_eq!(group.members.counts(), [2, 0]);
    }

    #[tokio::test(start_paused = true)]
    async fn slow_member_is_left_alone() {
        let group = Group::new().await;
        let slow = group.member(Behaviour::answering(SECOND * 5)).await;
        let other = group.member(Behaviour { answers_after: None, ..Behaviour::answering(SECOND) }).await;
        // The first one is asked first.
        assert_eq!(group.ask().await, SECOND * 5);
        assert_eq!((slow.asked(), other.asked(), group.hedges()), (1, 0, 0));
        assert!(slow.pinged.load(Ordering::Relaxed) > 10);
    }

    /// A worker that answers pings, and whose threads hang.
    #[tokio::test(start_paused = true)]
    async fn other_member_is_asked_after_a_quarter_of_the_time() {
        let group = Group::new().await;
        let hangs = group.member(Behaviour { answers_after: None, ..Behaviour::answering(SECOND) }).await;
        let works = group.member(Behaviour::answering(ms(20))).await;
        let mut times = Vec::new();
        while hangs.asked() == 0 {
            times.push(group.ask().await);
        }
        assert_eq!(times.pop(), Some(MINUTE / 4 + ms(20)));
        assert!(works.asked() >= 1 && group.hedges() == 1);
    }

    #[tokio::test(start_paused = true)]
    async fn slow_member_gets_fewer_requests() {
        let group = Group::new().await;
        let slow = group.member(Behaviour::answering(SECOND * 2)).await;
        let fast = group.member(Behaviour::answering(ms(20))).await;
        for _ in 0..100 {
            group.ask().await;
        }
        assert!(slow.asked() <= 2 && fast.asked() >= 98, "{} of the slow one", slow.asked());
    }

    #[tokio::test(start_paused = true)]
    async fn concurrent_requests_are_balanced() {
        let group = Group::new().await;
        let members = [
            group.member(Behaviour::answering(ms(200))).await,
            group.member(Behaviour::answering(ms(200))).await,
            group.member(Behaviour::answering(ms(200))).await,
        ];
        futures_util::future::join_all((0..30).map(|_| group.ask())).await;
        assert!(members.iter().all(|member| (8..=12).contains(&member.asked())));
    }

    /// A request that a NATS node took with it when it died is sent again as soon as the member does not know it.
    #[tokio::test(start_paused = true)]
    async fn lost_request_is_sent_again() {
        let group = Group::new().await;
        let only =
            group.member(Behaviour { loses: AtomicUsize::new(1), ..Behaviour::answering(SECOND * 3) }).await;
        let took = group.ask().await;
        assert!(took > SECOND * 3 && took < SECOND * 3 + SECOND / 2, "{took:?}");
        assert_eq!((only.asked(), group.members.counts()), (1, [1, 0]));
    }

    /// The cancelled message of a request that was sent again may still be worked on.
    #[tokio::test(start_paused = true)]
    async fn member_that_still_works_on_a_request_is_asked_again() {
        let group = Group::new().await;
        let only = group
            .member(Behaviour { still_works: AtomicUsize::new(2), ..Behaviour::answering(ms(20)) })
            .await;
        assert_eq!((group.ask().await, only.asked()), ((ms(20) + CANCEL_PAUSE) * 2 + ms(20), 3));
    }

    #[tokio::test(start_paused = true)]
    async fn full_member_is_known_before_a_query_is_sent() {
        let group = Group::new().await;
        let full = group
            .member(Behaviour { load: Load { jobs: 33, free: 0 }, ..Behaviour::answering(ms(20)) })
            .await;
        let (answer, took) = group.ask_for(None).await;
        assert!(matches!(answer, Err(LocalizeFailure::Busy { .. })), "{answer:?}");
        assert_eq!((took, full.asked()), (WAIT_FOR_PLACE, 0));
        let free = group.member(Behaviour::answering(ms(20))).await;
        assert_eq!((group.ask().await, free.asked(), full.asked()), (ms(20), 1, 0));
    }

    /// A refusal concerns the client whose share of a queue is used up.
    #[tokio::test(start_paused = true)]
    async fn refused_client_is_not_sent_again_at_once() {
        let group = Group::new().await;
        let retry_after = NonZeroU64::new(7).expect("not zero");
        let rejects = Some(RejectReason::Busy { retry_after });
        let member = group.member(Behaviour { rejects, ..Behaviour::answering(Duration::ZERO) }).await;
        let lane = |n: u8| Some(Lane::of(&TokenKey::of_digest([n; 32])));
        let refused = futures_util::future::join_all((0..10).map(|_| group.ask_for(lane(1)))).await;
        for (answer, took) in refused {
            assert_eq!(answer.expect_err("refused"), LocalizeFailure::Busy { retry_after });
            assert!(took >= WAIT_FOR_PLACE && took < WAIT_FOR_PLACE * 2, "{took:?}");
        }
        // All of the first burst, and then one in a quarter of a second.
        assert!((10..=16).contains(&member.asked()), "{}", member.asked());
        let before = member.asked();
        group.ask_for(lane(2)).await.0.expect_err("refused");
        assert!(member.asked() > before, "another client is sent");
    }

    /// Each answer to a client is a place in its share of the queue, so a request that waits takes it.
    #[tokio::test(start_paused = true)]
    async fn answers_free_places_for_a_refused_client() {
        let group = Group::new().await;
        let member = group.member(Behaviour { capacity: Some(4), ..Behaviour::answering(ms(100)) }).await;
        let lane = Some(Lane::of(&TokenKey::of_digest([1; 32])));
        let all = futures_util::future::join_all((0..24).map(|_| group.ask_for(lane))).await;
        assert!(all.iter().all(|(answer, _)| answer.is_ok()), "{all:?}");
        let longest = all.iter().map(|(_, took)| *took).max().expect("some");
        assert!(longest >= ms(600) && longest < ms(900), "four at a time take 0.6 s: {longest:?}");
        assert!(member.asked() < 24 + 24 + 12, "{} messages", member.asked());
    }

    #[tokio::test(start_paused = true)]
    async fn object_without_members_is_reported() {
        let group = Group::new().await;
        let (answer, took) = group.ask_for(None).await;
        assert!(matches!(answer, Err(LocalizeFailure::Unreached { .. })));
        assert_eq!(took, WAIT_FOR_MEMBER);
        // A member that comes in time is asked.
        let (took, ()) = futures_util::join!(group.ask(), async {
            tokio::time::sleep(SECOND).await;
            group.member(Behaviour::answering(ms(20))).await;
        });
        assert!(took > SECOND && took < SECOND * 3 / 2, "{took:?}");
    }
}
