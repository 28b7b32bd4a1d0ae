//! Which connections may be open: so many in all, so many of one address, and slots that only known tokens take.
//!
//! Who connects is unknown until a request brings a token. Unknown connections have a share of all slots only, and each
//! address a share of that; where there is no room for a new one, the one that has been unknown and idle for longest
//! makes room. So a newcomer always gets to say its token, however many others sit there and say nothing, and with it
//! leaves the places that unknown ones fight over. A connection with a request being answered is never closed for another.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{Notify, watch};

use crate::auth::TokenKey;

/// How many connections may be open.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// All of them.
    pub total: usize,
    /// Unknown ones of one address.
    pub per_address: usize,
    /// Of the total, slots that unknown ones do not get.
    pub reserved: usize,
}

/// Addresses that count as one: an IPv4 address, or the /64 that one IPv6 customer usually has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Group(u128);

impl Group {
    /// No address: of no IPv6 /64 are all bits set.
    const PROXY: Self = Self(u128::MAX);

    /// `None` is everybody who comes by way of a proxy of this machine.
    fn of(address: Option<IpAddr>) -> Self {
        let Some(address) = address else { return Self::PROXY };
        Self(match address.to_canonical() {
            IpAddr::V4(v4) => u32::from(v4).into(),
            // Never below 2^64, so no IPv4 address.
            IpAddr::V6(v6) => u128::from(v6) >> 64 << 64 | 1 << 63,
        })
    }
}

/// Nothing is going on.
const IDLE: u32 = 0;
/// Some of a request's head is here.
const READING: u32 = 1;
/// The answer is made, and not yet on its way.
const ANSWERED: u32 = 2;
/// A request is being answered; there may be several, and the states above count when there is none.
const BUSY: u32 = 4;

/// An open connection.
pub struct Guest {
    id: u64,
    group: Group,
    /// The token it brought last; `None` while it is unknown.
    token: Mutex<Option<TokenKey>>,
    state: AtomicU32,
    leave: Notify,
    /// The service gives up on everybody.
    thrown_out: watch::Receiver<bool>,
    home: Arc<Connections>,
}

impl Guest {
    /// Bytes came in: if nothing was going on, the head of a request.
    pub fn received(&self) {
        let _ = self.state.compare_exchange(IDLE, READING, Ordering::Relaxed, Ordering::Relaxed);
    }

    /// A request is being answered.
    pub fn begin(&self) {
        self.state.fetch_add(BUSY, Ordering::Relaxed);
    }

    /// Its answer is made.
    pub fn answered(&self) {
        self.done(|_| ANSWERED);
    }

    /// It is not answered any more, and nothing will be written for it.
    pub fn gave_up(&self) {
        self.done(|before| if before == READING { IDLE } else { before });
    }

    /// One request less; with the last one the state is what `rest` makes of it.
    fn done(&self, rest: impl Fn(u32) -> u32) {
        let _ = self.state.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |state| {
            let left = state.checked_sub(BUSY)?;
            Some(if left < BUSY { rest(left) } else { left })
        });
    }

    /// What was to be written is written.
    pub fn flushed(&self) {
        let _ = self.state.compare_exchange(ANSWERED, IDLE, Ordering::Relaxed, Ordering::Relaxed);
    }

    /// Whether closing it would break off a request that came, a half head included.
    pub fn is_idle(&self) -> bool {
        self.state.load(Ordering::Relaxed) == IDLE
    }

    /// Whether a request is being answered.
    pub fn is_busy(&self) -> bool {
        self.state.load(Ordering::Relaxed) >= BUSY
    }

    /// Whether it may be closed for another: a half head is no reason to stay.
    pub fn can_go(&self) -> bool {
        self.state.load(Ordering::Relaxed) <= READING
    }

    /// Whether it brought a known token last.
    pub fn is_known(&self) -> bool {
        self.token.lock().unwrap_or_else(PoisonError::into_inner).is_some()
    }

    /// It brought this token, or one that nobody knows.
    pub fn brought(&self, token: Option<TokenKey>) {
        let mut places = self.home.places();
        let before = {
            let mut own = self.token.lock().unwrap_or_else(PoisonError::into_inner);
            std::mem::replace(&mut *own, token)
        };
        // One that was told to leave has no place any more.
        if places.all.contains_key(&self.id) {
            match (before.is_some(), token.is_some()) {
                (false, true) => places.unknown(self.group, -1),
                (true, false) => places.unknown(self.group, 1),
                _ => {}
            }
        }
    }

    /// Waits until it has to make room for another.
    pub async fn told_to_leave(&self) {
        self.leave.notified().await;
    }

    /// Waits until the service gives up on everybody.
    pub async fn thrown_out(&self) {
        // The sender lives as long as the home that this guest keeps.
        let _ = self.thrown_out.clone().wait_for(|out| *out).await;
    }
}

/// Leaves when dropped.
pub struct Place(Arc<Guest>);

impl Place {
    /// Who has it.
    pub fn guest(&self) -> &Arc<Guest> {
        &self.0
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.0.home.places().remove(self.0.id);
        self.0.home.open.send_modify(|open| *open -= 1);
    }
}

#[derive(Default)]
struct Places {
    next: u64,
    /// By age, oldest first.
    all: BTreeMap<u64, Arc<Guest>>,
    unknown: usize,
    unknown_of: BTreeMap<Group, usize>,
}

impl Places {
    fn unknown(&mut self, group: Group, change: isize) {
        self.unknown = self.unknown.saturating_add_signed(change);
        let of = self.unknown_of.entry(group).or_default();
        *of = of.saturating_add_signed(change);
        if *of == 0 {
            self.unknown_of.remove(&group);
        }
    }

    fn remove(&mut self, id: u64) {
        if let Some(guest) = self.all.remove(&id)
            && !guest.is_known()
        {
            self.unknown(guest.group, -1);
        }
    }

    /// The oldest that may go among those.
    fn oldest(&self, among: impl Fn(&Guest) -> bool) -> Option<u64> {
        self.all.values().find(|guest| guest.can_go() && among(guest)).map(|guest| guest.id)
    }

    /// The oldest unknown one that may go, of the address that has most of them.
    fn oldest_of_the_largest_address(&self) -> Option<u64> {
        let mut addresses: Vec<(usize, Group)> =
            self.unknown_of.iter().map(|(group, n)| (*n, *group)).collect();
        addresses.sort_unstable_by(|a, b| b.cmp(a));
        addresses
            .into_iter()
            .find_map(|(_, group)| self.oldest(|guest| guest.group == group && !guest.is_known()))
    }

    /// The oldest idle one of the token that holds most.
    fn oldest_of_the_largest_token(&self) -> Option<u64> {
        let mut held: BTreeMap<TokenKey, usize> = BTreeMap::new();
        let token = |guest: &Guest| *guest.token.lock().unwrap_or_else(PoisonError::into_inner);
        for key in self.all.values().filter_map(|guest| token(guest)) {
            *held.entry(key).or_default() += 1;
        }
        let mut tokens: Vec<(usize, TokenKey)> = held.into_iter().map(|(key, n)| (n, key)).collect();
        tokens.sort_unstable_by(|a, b| b.cmp(a));
        tokens.into_iter().find_map(|(_, key)| self.oldest(|guest| token(guest) == Some(key)))
    }
}

/// What became of a new connection.
pub enum Entry {
    /// It has a place.
    Taken(Place),
    /// It has the place of one that was closed for it.
    Exchanged(Place),
    /// Everybody else is being answered.
    Refused,
}

/// All open connections.
pub struct Connections {
    limits: Limits,
    places: Mutex<Places>,
    /// Connections not closed yet, those told to leave included.
    open: watch::Sender<usize>,
    throw_out: watch::Sender<bool>,
}

impl Connections {
    /// None yet.
    pub fn new(limits: Limits) -> Arc<Self> {
        Arc::new(Self {
            limits,
            places: Mutex::default(),
            open: watch::Sender::new(0),
            throw_out: watch::Sender::new(false),
        })
    }

    fn places(&self) -> std::sync::MutexGuard<'_, Places> {
        self.places.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How many are open.
    pub fn open(&self) -> usize {
        *self.open.borrow()
    }

    /// Ends all of them, whatever they are at.
    pub fn close_all(&self) {
        self.throw_out.send_replace(true);
    }

    /// Waits until all are closed.
    pub async fn all_closed(&self) {
        // The sender is here, so it is never closed.
        let _ = self.open.subscribe().wait_for(|open| *open == 0).await;
    }

    /// Takes a new connection in, if need be for another. One without address is a proxy's: it brings requests of many, so
    /// what one address may have does not bind it.
    pub fn enter(self: &Arc<Self>, from: Option<IpAddr>) -> Entry {
        let Limits { total, per_address, reserved } = self.limits;
        let group = Group::of(from);
        let mut places = self.places();
        let own = places.unknown_of.get(&group).copied().unwrap_or(0);
        let leaves = if own >= per_address && group != Group::PROXY {
            Some(places.oldest(|guest| guest.group == group && !guest.is_known()))
        } else if places.unknown >= total.saturating_sub(reserved).max(1) {
            Some(places.oldest_of_the_largest_address())
        } else if places.all.len() >= total {
            Some(places.oldest_of_the_largest_address().or_else(|| places.oldest_of_the_largest_token()))
        } else {
            None
        };
        let exchanged = leaves.is_some();
        match leaves {
            Some(None) => return Entry::Refused,
            Some(Some(id)) => {
                if let Some(guest) = places.all.get(&id).cloned() {
                    places.remove(id);
                    guest.leave.notify_one();
                }
            }
            None => {}
        }
        let id = places.next;
        places.next += 1;
        let guest = Arc::new(Guest {
            id,
            group,
            token: Mutex::new(None),
            state: AtomicU32::new(IDLE),
            leave: Notify::new(),
            thrown_out: self.throw_out.subscribe(),
            home: self.clone(),
        });
        places.all.insert(id, guest.clone());
        places.unknown(group, 1);
        drop(places);
        self.open.send_modify(|open| *open += 1);
        let place = Place(guest);
        if exchanged { Entry::Exchanged(place) } else { Entry::Taken(place) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(n: u8) -> IpAddr {
        IpAddr::from([192, 0, 2, n])
    }

    fn token(n: u8) -> TokenKey {
        TokenKey::of_digest([n; 32])
    }

    fn connections(total: usize, per_address: usize, reserved: usize) -> Arc<Connections> {
        Connections::new(Limits { total, per_address, reserved })
    }

    fn enter(connections: &Arc<Connections>, from: u8) -> Place {
        match connections.enter(Some(address(from))) {
            Entry::Taken(place) | Entry::Exchanged(place) => place,
            Entry::Refused => panic!("refused"),
        }
    }

    /// Whether it was told to leave.
    fn leaves(place: &Place) -> bool {
        !place.0.home.places().all.contains_key(&place.0.id)
    }

    #[test]
    fn unknown_ones_that_sit_there_block_nobody_with_a_token() {
        let connections = connections(100, 60, 50);
        let unknown: Vec<Place> = (0..200).map(|i| enter(&connections, i % 4)).collect();
        assert_eq!(unknown.iter().filter(|place| !leaves(place)).count(), 50, "the other half is reserved");
        assert!(!leaves(&unknown[199]) && leaves(&unknown[0]), "the oldest left");
        // Each says its token as soon as it is in, and then stays whatever unknown ones do.
        let known: Vec<Place> = (0..50)
            .map(|_| {
                let place = enter(&connections, 9);
                place.guest().brought(Some(token(1)));
                place
            })
            .collect();
        let more: Vec<Place> = (0..200).map(|i| enter(&connections, i % 4)).collect();
        assert!(known.iter().all(|place| !leaves(place)));
        assert_eq!(more.iter().filter(|place| !leaves(place)).count(), 50);
        drop((unknown, known, more));
        assert_eq!((connections.open(), connections.places().unknown), (0, 0));
        assert!(connections.places().unknown_of.is_empty());
    }

    #[test]
    fn one_address_gets_its_share_and_no_other_pays_for_it() {
        let connections = connections(100, 10, 0);
        let other = enter(&connections, 1);
        let greedy: Vec<Place> = (0..30).map(|_| enter(&connections, 2)).collect();
        assert!(!leaves(&other));
        assert_eq!(greedy.iter().filter(|place| !leaves(place)).count(), 10);
        // All of one network of IPv6 count as one address.
        let of = |text: &str| Group::of(Some(text.parse().expect("an address")));
        assert_eq!(of("2001:db8::1"), of("2001:db8::ffff:1"));
        assert_ne!(of("2001:db8::1"), of("2001:db8:0:1::1"));
        assert_eq!(of("::ffff:192.0.2.7"), of("192.0.2.7"));
    }

    #[test]
    fn who_is_being_answered_is_not_closed_for_another() {
        let connections = connections(2, 2, 0);
        let places = [enter(&connections, 1), enter(&connections, 2)];
        for place in &places {
            place.guest().received();
            place.guest().begin();
        }
        assert!(matches!(connections.enter(Some(address(3))), Entry::Refused));
        places[1].guest().answered();
        assert!(
            matches!(connections.enter(Some(address(3))), Entry::Refused),
            "the answer is not on its way yet"
        );
        places[1].guest().flushed();
        assert!(places[1].guest().is_idle());
        // Half a head does not count.
        places[1].guest().received();
        let _third = enter(&connections, 3);
        assert!(leaves(&places[1]) && !leaves(&places[0]));
    }

    /// Tokens may fill everything, then the one that has most gives way.
    #[test]
    fn one_token_does_not_keep_out_the_others() {
        let connections = connections(10, 10, 5);
        let greedy: Vec<Place> = (0..9)
            .map(|_| {
                let place = enter(&connections, 1);
                place.guest().brought(Some(token(1)));
                place
            })
            .collect();
        let modest = enter(&connections, 2);
        modest.guest().brought(Some(token(2)));
        let third = enter(&connections, 3);
        assert!(leaves(&greedy[0]) && !leaves(&modest) && !leaves(&third));
        // A token that is not known any more protects nobody.
        greedy[1].guest().brought(None);
        third.guest().brought(Some(token(3)));
        let _fourth = enter(&connections, 4);
        assert!(leaves(&greedy[1]) && !leaves(&greedy[2]));
    }

    /// What one address may have does not bind a proxy; what all may have does.
    #[test]
    fn a_proxy_brings_many() {
        let connections = connections(10, 2, 5);
        let places: Vec<Place> = (0..6)
            .map(|_| match connections.enter(None) {
                Entry::Taken(place) | Entry::Exchanged(place) => place,
                Entry::Refused => panic!("refused"),
            })
            .collect();
        assert_eq!(places.iter().filter(|place| leaves(place)).count(), 1, "five are for the unknown");
    }

    /// Of several requests on one connection it is busy until the last one is done, however that one ends.
    #[test]
    fn several_requests_at_a_time_are_counted() {
        let connections = connections(1, 1, 0);
        let place = enter(&connections, 1);
        let guest = place.guest();
        guest.received();
        guest.begin();
        guest.begin();
        guest.answered();
        assert!(guest.is_busy() && !guest.is_idle() && !guest.can_go());
        guest.flushed();
        assert!(guest.is_busy(), "the other one is still being answered");
        guest.gave_up();
        assert!(!guest.is_busy() && guest.is_idle(), "nothing is to be written for what was given up");
        guest.begin();
        guest.answered();
        assert!(!guest.is_busy() && !guest.can_go(), "the answer is not on its way yet");
        guest.flushed();
        assert!(guest.is_idle());
        guest.gave_up();
        assert!(guest.is_idle(), "one too many does no harm");
    }

    #[tokio::test]
    async fn who_has_to_leave_is_told_and_the_last_one_is_noticed() {
        let connections = connections(1, 1, 0);
        let first = enter(&connections, 1);
        let second = enter(&connections, 1);
        first.guest().told_to_leave().await;
        assert_eq!(connections.open(), 2, "not closed yet");
        drop(first);
        drop(second);
        connections.all_closed().await;
    }
}
