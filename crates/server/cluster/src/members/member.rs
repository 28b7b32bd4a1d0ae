//! One worker as a gateway sees it: what it holds, how busy it is, what it owes, and whether it answers.

use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroU64;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::{Notify, oneshot, watch};
use tokio::time::Instant;
use veiloc_map::regions::ObjectId;
use veiloc_service::auth::Lane;

use crate::announcement::{Announcement, MemberId};
use crate::bus::Subject;
use crate::frame_version::{FrameVersions, VERSION};
use crate::message::{Load, MAX_PINGED, RequestIdBytes, Task};
use crate::placement::Placed;

/// Time after which a member is asked whether it runs, and whether it has a request that it owes an answer to; and again
/// after each answer.
pub(super) const PATIENCE: Duration = Duration::from_millis(100);

/// Time limit of the answer to that. A member that misses one is put out.
pub(super) const PROBE_TIMEOUT: Duration = Duration::from_millis(200);

/// Time limit of the answer of a member that is out. It may be longer, because no request waits for it, so that a member
/// on an overloaded machine comes back.
pub(super) const OUT_PROBE_TIMEOUT: Duration = Duration::from_secs(1);

/// Half periods without an announcement after which a member is probed, and whole ones after which it is forgotten.
const LATE_AFTER: u32 = 5;
pub(super) const FORGET_AFTER: u32 = 6;

/// Pause between two probes of a member that is out.
pub(super) const PROBE_PAUSE: Duration = Duration::from_millis(250);

/// A client that a member refused is sent to it again after this time, or when an answer to it shows that a place is free.
const REFUSED_FOR: Duration = Duration::from_millis(250);

/// Answers since a refusal that are not used by new requests, after which it is forgotten.
const ENOUGH_PLACES: u32 = 16;

/// Half-life of a measured time without new measurements, so that a member that was slow is tried again.
const PACE_HALF_LIFE: Duration = Duration::from_secs(5);

/// Least time that is expected, so that the load counts before the first measurement too.
const LEAST_TIME: Duration = Duration::from_millis(1);

/// Weight of earlier times against a new one.
const PACE_MEMORY: u32 = 3;

/// Kinds of work, which have times of their own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Work {
    Search,
    Pose,
}

impl Work {
    pub(crate) const fn of(task: &Task) -> Self {
        match task {
            Task::Ping { .. } | Task::Search { .. } => Self::Search,
            Task::Pose { .. } => Self::Pose,
        }
    }
}

/// A member of a map's workers.
pub(crate) struct Member {
    pub(super) id: MemberId,
    pub(super) subject: Subject,
    /// The newest version of frames that both speak.
    version: u32,
    state: Mutex<MemberState>,
    /// Whether it is out: it gets no requests until it answers a probe.
    out: watch::Sender<bool>,
    /// Notified when it may be due earlier.
    pub(super) changed: Notify,
}

struct MemberState {
    period: Duration,
    leaving: bool,
    threads: u32,
    objects: BTreeSet<ObjectId>,
    placed: Option<Placed>,
    /// The last reported load, and the requests for poses sent since.
    load: Load,
    sent_since: u32,
    announced: Instant,
    /// The last answer of any kind.
    heard: Instant,
    /// When it was probed, while it is out.
    probed: Option<Instant>,
    owed: BTreeMap<u64, Owed>,
    next: u64,
    paces: [Pace; 2],
    /// Clients that it refused.
    refused: BTreeMap<Option<Lane>, Refusal>,
}

/// A member refused a client: the share of its queue is used.
struct Refusal {
    /// When a request is tried again in any case.
    until: Instant,
    /// Answers to this client since then: each is a place that became free.
    freed: u32,
    retry_after: NonZeroU64,
}

/// A request to which the member owes an answer.
struct Owed {
    name: RequestIdBytes,
    object: ObjectId,
    lane: Option<Lane>,
    work: Work,
    sent: Instant,
    /// When it was sent, or the member last said that it has it; `None` before it was sent, so that no probe overtakes it.
    confirmed: Option<Instant>,
    lost: oneshot::Sender<()>,
}

/// Running mean of the time of a kind of work.
#[derive(Clone, Copy, Default)]
struct Pace {
    mean: Duration,
    at: Option<Instant>,
}

impl Pace {
    /// Zero before the first measurement.
    fn at(&self, now: Instant) -> Duration {
        let age = self.at.map_or(Duration::ZERO, |at| now.saturating_duration_since(at));
        self.mean.mul_f64(0.5_f64.powf(age.as_secs_f64() / PACE_HALF_LIFE.as_secs_f64()))
    }

    fn record(&mut self, took: Duration, now: Instant) {
        let mean = match self.at {
            Some(_) => (self.at(now) * PACE_MEMORY + took) / (PACE_MEMORY + 1),
            None => took,
        };
        *self = Self { mean, at: Some(now) };
    }
}

/// When a member is to be looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Due {
    Probe(Instant),
    Forget(Instant),
}

impl Due {
    pub(super) const fn at(self) -> Instant {
        match self {
            Self::Probe(at) | Self::Forget(at) => at,
        }
    }
}

/// Whether a member can be asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Availability {
    /// It takes requests; the expected time of an answer.
    Ready(Duration),
    /// Its queue is full, or it refused this client a moment ago; try again after these seconds.
    Full(NonZeroU64),
    /// It is out, is leaving, or does not hold the object.
    No,
}

impl Member {
    /// A member that was not probed yet, and so is out.
    pub(super) fn new(subject: Subject, announcement: &Announcement, now: Instant) -> Self {
        Self {
            id: announcement.member,
            subject,
            // Announcements without a common version are not read.
            version: FrameVersions::OWN.common(announcement.versions).unwrap_or(VERSION),
            out: watch::Sender::new(true),
            changed: Notify::new(),
            state: Mutex::new(MemberState {
                period: announcement.period,
                leaving: announcement.leaving,
                threads: announcement.threads,
                objects: announcement.objects.clone(),
                placed: announcement.placed.clone(),
                load: announcement.load,
                sent_since: 0,
                announced: now,
                heard: now,
                probed: None,
                owed: BTreeMap::new(),
                next: 0,
                paces: [Pace::default(); 2],
                refused: BTreeMap::new(),
            }),
        }
    }

    fn state(&self) -> MutexGuard<'_, MemberState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Where it receives requests.
    pub(crate) const fn subject(&self) -> &Subject {
        &self.subject
    }

    pub(crate) const fn id(&self) -> MemberId {
        self.id
    }

    /// The version of frames in which it is asked.
    pub(crate) const fn version(&self) -> u32 {
        self.version
    }

    /// Updates it; returns whether more than its load changed.
    pub(super) fn announced(&self, announcement: &Announcement, now: Instant) -> bool {
        let mut state = self.state();
        let changed = state.leaving != announcement.leaving
            || state.objects != announcement.objects
            || state.placed != announcement.placed;
        state.announced = now;
        state.period = announcement.period;
        state.leaving = announcement.leaving;
        state.threads = announcement.threads;
        state.report(announcement.load);
        if changed {
            state.objects.clone_from(&announcement.objects);
            state.placed.clone_from(&announcement.placed);
        }
        changed
    }

    pub(super) fn is_out(&self) -> bool {
        *self.out.borrow()
    }

    /// Puts it out, or takes it back; returns whether that changed anything.
    pub(super) fn set_out(&self, out: bool) -> bool {
        self.state().probed = None;
        self.out.send_replace(out) != out
    }

    /// Returns when it is out.
    pub(crate) async fn put_out(&self) {
        // Cannot fail: `self` holds the sender.
        let _ = self.out.subscribe().wait_for(|out| *out).await;
    }

    /// The objects for which it takes requests.
    pub(super) fn served(&self) -> BTreeSet<ObjectId> {
        let state = self.state();
        if state.leaving || self.is_out() { BTreeSet::new() } else { state.objects.clone() }
    }

    /// How it takes part in the placement of regions.
    pub(super) fn placed(&self) -> Option<Placed> {
        self.state().placed.clone()
    }

    pub(super) fn is_leaving(&self) -> bool {
        self.state().leaving
    }

    /// It refused as leaving.
    pub(crate) fn set_leaving(&self) {
        self.state().leaving = true;
        self.changed.notify_one();
    }

    /// It does not hold this object.
    pub(crate) fn set_not_held(&self, object: &ObjectId) {
        self.state().objects.remove(object);
    }

    /// The share of this client of its queue is used.
    pub(crate) fn set_refused(&self, lane: Option<Lane>, retry_after: NonZeroU64) {
        let now = Instant::now();
        let mut state = self.state();
        state.refused.retain(|_, refusal| refusal.until + REFUSED_FOR > now);
        state.refused.insert(lane, Refusal { until: now + REFUSED_FOR, freed: 0, retry_after });
    }

    pub(super) fn availability(&self, object: &ObjectId, lane: Option<Lane>, work: Work) -> Availability {
        let (now, state) = (Instant::now(), self.state());
        if self.is_out() || state.leaving || !state.objects.contains(object) {
            return Availability::No;
        }
        if work == Work::Pose {
            let refusal =
                state.refused.get(&lane).filter(|refusal| refusal.until > now && refusal.freed == 0);
            if let Some(refusal) = refusal {
                return Availability::Full(refusal.retry_after);
            }
            if !state.has_room() {
                return Availability::Full(NonZeroU64::MIN);
            }
        }
        Availability::Ready(state.expected(work, now))
    }

    /// Notes a request that is about to be sent.
    pub(crate) fn ask(
        self: &Arc<Self>,
        name: RequestIdBytes,
        object: ObjectId,
        lane: Option<Lane>,
        work: Work,
    ) -> Asked {
        let (lost, lost_notice) = oneshot::channel();
        let mut state = self.state();
        let (number, sent) = (state.next, Instant::now());
        state.next += 1;
        state.sent_since += u32::from(work == Work::Pose);
        if let Some(refusal) = state.refused.get_mut(&lane).filter(|_| work == Work::Pose) {
            // It uses a place that became free, or is the only one that tries for a while.
            refusal.freed = refusal.freed.saturating_sub(1);
            refusal.until = sent + REFUSED_FOR;
        }
        state.owed.insert(number, Owed { name, object, lane, work, sent, confirmed: None, lost });
        drop(state);
        Asked { member: self.clone(), number, lost: lost_notice }
    }

    /// The oldest requests that it owes, for a probe.
    pub(super) fn owed(&self) -> Vec<(u64, (RequestIdBytes, ObjectId))> {
        let state = self.state();
        let mut owed: Vec<_> = state.owed.iter().filter(|(_, owed)| owed.confirmed.is_some()).collect();
        owed.sort_by_key(|(number, request)| (request.confirmed, **number));
        let named = owed.into_iter().map(|(number, request)| (*number, (request.name, request.object)));
        named.take(MAX_PINGED).collect()
    }

    /// It answered a probe about these requests, and does not know the `unknown` ones. The probe was sent `at`.
    pub(super) fn answered_probe(&self, asked: &[u64], unknown: &[u64], load: Load, at: Instant) {
        let mut state = self.state();
        state.heard = Instant::now();
        state.report(load);
        for number in asked {
            if unknown.contains(number) {
                if let Some(lost) = state.owed.remove(number) {
                    // The requester may be gone.
                    let _ = lost.lost.send(());
                }
            } else if let Some(owed) = state.owed.get_mut(number) {
                owed.confirmed = Some(at);
            }
        }
    }

    /// It is probed now.
    pub(super) fn probing(&self) {
        self.state().probed = Some(Instant::now());
    }

    /// Begins to count its times anew: this process was suspended.
    pub(super) fn restart_clocks(&self) {
        let (now, mut state) = (Instant::now(), self.state());
        (state.announced, state.heard) = (now, now);
        state.owed.values_mut().for_each(|owed| owed.confirmed = owed.confirmed.map(|_| now));
    }

    /// When to probe or to forget it.
    pub(super) fn due(&self) -> Due {
        let is_out = self.is_out();
        let state = self.state();
        if state.leaving && state.owed.is_empty() {
            return Due::Forget(state.announced);
        }
        let forget = state.announced + state.period * FORGET_AFTER;
        let probe = if is_out {
            state.probed.map_or(state.announced, |probed| probed + PROBE_PAUSE)
        } else {
            let late = state.announced.max(state.heard) + state.period * LATE_AFTER / 2;
            let oldest = state.owed.values().filter_map(|owed| owed.confirmed).min();
            oldest.map_or(late, |oldest| late.min(oldest + PATIENCE))
        };
        if probe < forget { Due::Probe(probe) } else { Due::Forget(forget) }
    }

    /// When to forget it.
    pub(super) fn forget_at(&self) -> Due {
        let state = self.state();
        if state.leaving {
            return Due::Forget(state.announced);
        }
        Due::Forget(state.announced + state.period * FORGET_AFTER)
    }

    /// Its period of announcements.
    pub(super) fn period(&self) -> Duration {
        self.state().period
    }
}

impl MemberState {
    fn report(&mut self, load: Load) {
        self.load = load;
        self.sent_since = 0;
    }

    /// Whether one more request finds a free thread or a place in the queue.
    fn has_room(&self) -> bool {
        let idle = self.threads.saturating_sub(self.load.jobs);
        self.sent_since < self.load.free.saturating_add(idle)
    }

    /// Expected time of an answer: the usual time of this work, or that of the oldest request if it is longer, times the
    /// work before it.
    fn expected(&self, work: Work, now: Instant) -> Duration {
        let mut owed = 0_u32;
        let mut one = self.paces[work as usize].at(now).max(LEAST_TIME);
        for request in self.owed.values().filter(|owed| owed.work == work) {
            one = one.max(now.saturating_duration_since(request.sent));
            owed += 1;
        }
        let (jobs, threads) = match work {
            Work::Search => (owed, 1),
            Work::Pose => (owed.max(self.load.jobs + self.sent_since), self.threads),
        };
        one.mul_f64(1.0 + f64::from(jobs) / f64::from(threads))
    }
}

/// A request that was sent to a member. Dropping it ends the member's debt.
pub(crate) struct Asked {
    member: Arc<Member>,
    number: u64,
    lost: oneshot::Receiver<()>,
}

impl Asked {
    /// The request was sent. Returns when the member says that it never received it.
    pub(crate) async fn lost(&mut self) {
        if let Some(owed) = self.member.state().owed.get_mut(&self.number) {
            owed.confirmed = Some(Instant::now());
        }
        self.member.changed.notify_one();
        if (&mut self.lost).await.is_err() {
            // The debt ended otherwise.
            std::future::pending::<()>().await;
        }
    }

    /// The member answered, after computing this long.
    pub(crate) fn answered(self, worked: Duration, load: Load) {
        let (now, mut state) = (Instant::now(), self.member.state());
        state.heard = now;
        if let Some(owed) = state.owed.remove(&self.number) {
            state.paces[owed.work as usize].record(worked, now);
            if let Some(refusal) = state.refused.get_mut(&owed.lane).filter(|_| owed.work == Work::Pose) {
                refusal.freed += 1;
                if refusal.freed >= ENOUGH_PLACES {
                    state.refused.remove(&owed.lane);
                }
            }
        }
        state.report(load);
    }
}

impl Drop for Asked {
    fn drop(&mut self) {
        let mut state = self.member.state();
        state.owed.remove(&self.number);
        let has_left = state.leaving && state.owed.is_empty();
        drop(state);
        if has_left {
            self.member.changed.notify_one();
        }
    }
}
