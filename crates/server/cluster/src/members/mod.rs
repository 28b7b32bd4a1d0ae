//! The workers of a map, as a gateway or another worker knows them from their announcements.
//!
//! - [`Members`]: the table; [`Members::choose`] names the member to ask for an object, [`Members::copies`] counts the
//!   members that hold each object.
//! - [`Member`]: one of them, with its load and what it owes.
//!
//! A gateway sends a member no request before it answered a probe, and puts it out when it misses one (`watch.rs`). A
//! worker, which only counts copies, does not probe.

mod member;
mod watch;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::num::NonZeroU64;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

use tokio::time::Instant;
use veiloc_map::regions::{Manifest, ObjectId};
use veiloc_service::auth::Lane;

use self::member::Availability;
use crate::ClusterError;
use crate::announcement::{Announced, Announcement, MemberId};
use crate::bus::{Bus, Listener};
use crate::frame_version::FrameVersions;
use crate::placement::Placed;
use crate::subjects;

pub(crate) use member::{Member, Work};

/// The second of two members is asked if its answer is expected in less than this part of the time of the first.
const LESS_BUSY: f64 = 0.75;

/// How long a worker that is gone is remembered at most.
const LONG_GONE: Duration = Duration::from_secs(3600);

/// The members of a map. Clones share them.
#[derive(Clone)]
pub(crate) struct Members(Arc<Table>);

/// Who sends requests to members probes them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Role {
    Gateway,
    Worker,
}

struct Table {
    bus: Bus,
    map: String,
    role: Role,
    members: Mutex<BTreeMap<MemberId, Arc<Member>>>,
    /// Workers with which this program has no version of frames in common, and until when they are known.
    foreign: Mutex<BTreeMap<MemberId, Instant>>,
    /// Workers that are gone and took part in the placement of regions, by name, and since when.
    departed: Mutex<BTreeMap<String, (Placed, Instant)>>,
    /// Counts changes of the members, and of what they hold.
    changes: tokio::sync::watch::Sender<u64>,
    /// Number of choices.
    turn: AtomicUsize,
}

/// The member to ask.
pub(crate) enum Choice {
    Ask(Arc<Member>),
    /// All members that hold the object are full, or refused this client a moment ago.
    Full {
        retry_after: NonZeroU64,
    },
    /// No member holds it.
    NoMember,
}

/// A worker among which regions are placed.
pub(crate) struct PlacedMember {
    /// `None` if it is gone.
    pub(crate) id: Option<MemberId>,
    pub(crate) placed: Placed,
    /// The objects for which it takes requests.
    pub(crate) served: BTreeSet<ObjectId>,
    /// It left or died; it may come back.
    pub(crate) is_departed: bool,
}

/// Number of members that hold each object of a manifest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Copies {
    /// Of the object that fewest members hold.
    pub(crate) least: usize,
    /// Number of objects without a member.
    pub(crate) missing: usize,
}

impl Members {
    /// Listens to the announcements of the workers of this map.
    ///
    /// # Errors
    /// [`ClusterError`]: an invalid name, or the bus is closed.
    pub(crate) async fn listen(bus: &Bus, map: &str, role: Role) -> Result<Self, ClusterError> {
        let announcements = bus.listen(&subjects::of_members(map)?).await?;
        let table = Arc::new(Table {
            bus: bus.clone(),
            map: map.to_owned(),
            role,
            members: Mutex::default(),
            foreign: Mutex::default(),
            departed: Mutex::default(),
            changes: tokio::sync::watch::Sender::new(0),
            turn: AtomicUsize::new(0),
        });
        tokio::spawn(receive(announcements, Arc::downgrade(&table)));
        Ok(Self(table))
    }

    /// Follows the changes of members and of what they hold.
    pub(crate) fn changes(&self) -> tokio::sync::watch::Receiver<u64> {
        self.0.changes.subscribe()
    }

    /// Chooses the less busy of two members that hold this object and are not among `asked`.
    pub(crate) fn choose(
        &self,
        object: &ObjectId,
        lane: Option<Lane>,
        work: Work,
        asked: &[MemberId],
    ) -> Choice {
        let (mut ready, mut full) = (Vec::new(), None);
        for member in self.0.members().values().filter(|member| !asked.contains(&member.id())) {
            match member.availability(object, lane, work) {
                Availability::Ready(expected) => ready.push((expected, member.clone())),
                Availability::Full(after) => {
                    full = Some(full.map_or(after, |least: NonZeroU64| least.min(after)));
                }
                Availability::No => {}
            }
        }
        if ready.is_empty() {
            return full.map_or(Choice::NoMember, |retry_after| Choice::Full { retry_after });
        }
        let (first, second) = pair(self.0.turn.fetch_add(1, Ordering::Relaxed), ready.len());
        let is_less_busy = ready[second].0 < ready[first].0.mul_f64(LESS_BUSY);
        Choice::Ask(ready.swap_remove(if is_less_busy { second } else { first }).1)
    }

    /// How many members hold the objects of this manifest.
    pub(crate) fn copies(&self, manifest: &Manifest) -> Copies {
        let mut held: HashMap<ObjectId, usize> = HashMap::new();
        for member in self.0.members().values() {
            for object in member.served() {
                *held.entry(object).or_default() += 1;
            }
        }
        let objects =
            std::iter::once(manifest.index.sha256).chain(manifest.regions.iter().map(|region| region.sha256));
        let counts = objects.map(|object| held.get(&object).copied().unwrap_or(0));
        let (mut least, mut missing) = (usize::MAX, 0);
        for count in counts {
            least = least.min(count);
            missing += usize::from(count == 0);
        }
        Copies { least, missing }
    }

    /// The workers among which regions are placed; those that left or died less than `settle` ago are `departed`. Some of equal
    /// names may be among them.
    pub(crate) fn placed(&self, settle: Duration) -> Vec<PlacedMember> {
        let now = Instant::now();
        let mut all: Vec<PlacedMember> = Vec::new();
        for member in self.0.members().values() {
            if let Some(placed) = member.placed() {
                let is_departed = member.is_leaving();
                all.push(PlacedMember { id: Some(member.id), placed, served: member.served(), is_departed });
            }
        }
        let mut departed = self.0.departed();
        departed.retain(|name, (_, since)| {
            let is_back = all.iter().any(|member| member.placed.name == *name && !member.is_departed);
            !is_back && now < *since + settle
        });
        all.extend(departed.values().map(|(placed, _)| PlacedMember {
            id: None,
            placed: placed.clone(),
            served: BTreeSet::new(),
            is_departed: true,
        }));
        all
    }

    /// Workers with which this program has no version of frames in common.
    pub(crate) fn foreign_count(&self) -> usize {
        let now = Instant::now();
        let mut foreign = self.0.foreign();
        foreign.retain(|_, known_until| now < *known_until);
        foreign.len()
    }

    /// Members that can be asked, and members that are out.
    pub(crate) fn counts(&self) -> [usize; 2] {
        let members = self.0.members();
        let out = members.values().filter(|member| member.is_out()).count();
        [members.len() - out, out]
    }

    /// It misses an answer, or sent an invalid one: it gets no requests until it answers a probe.
    pub(crate) fn put_out(&self, member: &Arc<Member>) {
        self.0.set_out(member, true);
    }

    /// It has left the bus.
    pub(crate) fn remove(&self, member: &Arc<Member>) {
        self.0.remove(member);
    }
}

/// A pair of different numbers below `count`; over time all pairs come equally often. With one member, it is both.
const fn pair(turn: usize, count: usize) -> (usize, usize) {
    let first = turn % count;
    if count == 1 {
        return (0, 0);
    }
    (first, (first + 1 + turn / count % (count - 1)) % count)
}

impl Table {
    fn members(&self) -> MutexGuard<'_, BTreeMap<MemberId, Arc<Member>>> {
        self.members.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn foreign(&self) -> MutexGuard<'_, BTreeMap<MemberId, Instant>> {
        self.foreign.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn departed(&self) -> MutexGuard<'_, BTreeMap<String, (Placed, Instant)>> {
        self.departed.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A worker announced itself with which this program has no version in common.
    fn announced_foreign(&self, member: MemberId, versions: FrameVersions, known_until: Option<Instant>) {
        let before = match known_until {
            Some(known_until) => self.foreign().insert(member, known_until),
            None => self.foreign().remove(&member),
        };
        if before.is_some() != known_until.is_some() {
            if known_until.is_some() {
                let (map, own) = (&self.map, FrameVersions::OWN);
                tracing::warn!(map, %member, %versions, %own, "a worker has no version of frames in common with this program; it gets no queries");
            }
            self.change();
        }
    }

    fn has(&self, member: &Arc<Member>) -> bool {
        self.members().get(&member.id).is_some_and(|known| Arc::ptr_eq(known, member))
    }

    fn change(&self) {
        self.changes.send_modify(|changes| *changes += 1);
    }

    fn set_out(&self, member: &Arc<Member>, out: bool) {
        if member.set_out(out) {
            if self.has(member) {
                let (map, member) = (&self.map, member.id);
                if out {
                    tracing::warn!(map, %member, "a worker misses an answer; it gets no queries until it answers a probe");
                } else {
                    tracing::info!(map, %member, "a worker answers");
                }
            }
            member.changed.notify_one();
            self.change();
        }
    }

    fn remove(&self, member: &Arc<Member>) {
        if self.has(member) {
            self.members().remove(&member.id);
            if let Some(placed) = member.placed().filter(|_| self.role == Role::Worker) {
                // Who places no regions does not read them.
                self.departed().retain(|_, (_, since)| since.elapsed() < LONG_GONE);
                self.departed().insert(placed.name.clone(), (placed, Instant::now()));
            }
            let (map, id) = (&self.map, member.id);
            if member.is_leaving() {
                tracing::info!(map, member = %id, "a worker has left");
            } else {
                tracing::warn!(map, member = %id, "a worker is gone");
            }
        }
        member.set_out(true);
        self.change();
    }

    fn announced(self: &Arc<Self>, announcement: &Announcement) -> Result<(), ClusterError> {
        let now = Instant::now();
        let known = self.members().get(&announcement.member).cloned();
        let is_changed = match known {
            Some(member) => {
                let is_changed = member.announced(announcement, now);
                member.changed.notify_one();
                is_changed
            }
            // It left, and says so.
            None if announcement.leaving => false,
            None => {
                let subject = subjects::of_member(&self.map, &announcement.member)?;
                let member = Arc::new(Member::new(subject, announcement, now));
                if self.role == Role::Worker {
                    member.set_out(false);
                }
                self.members().insert(member.id, member.clone());
                tokio::spawn(watch::watch(Arc::downgrade(self), member));
                true
            }
        };
        if is_changed {
            self.change();
        }
        Ok(())
    }
}

/// Receives announcements until the table is dropped. The first invalid announcement is a warning; further ones would fill the
/// log.
async fn receive(mut announcements: Listener, table: Weak<Table>) {
    let mut has_warned = false;
    while let Some(message) = announcements.next().await {
        let Some(table) = table.upgrade() else { return };
        let read = Announcement::decode(message).and_then(|announced| match announced {
            Announced::Known(announcement) => table.announced(&announcement),
            Announced::Foreign { versions, member, period, leaving } => {
                let known_until = (!leaving).then(|| Instant::now() + period * member::FORGET_AFTER);
                table.announced_foreign(member, versions, known_until);
                Ok(())
            }
        });
        if let (Err(error), false) = (&read, has_warned) {
            tracing::warn!(map = table.map, %error, "an invalid announcement was received; further ones are not logged");
            has_warned = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn pairs_differ_and_come_equally_often() {
        assert_eq!(pair(5, 1), (0, 0));
        for count in 2..6 {
            let mut seen: BTreeMap<(usize, usize), usize> = BTreeMap::new();
            for turn in 0..3 * count * (count - 1) {
                *seen.entry(pair(turn, count)).or_default() += 1;
            }
            assert_eq!(seen.len(), count * (count - 1));
            assert!(seen.iter().all(|((first, second), times)| first != second && *times == 3), "{seen:?}");
        }
    }
}
