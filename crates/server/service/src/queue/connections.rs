//! Limits of open connections: in total, per address, and slots reserved for authenticated clients.
//!
//! A connection is unauthenticated until a request carries a known token. Unauthenticated connections get only a part
//! of all slots, and each address only a part of these. When no slot is free for a new connection, it evicts the
//! oldest unauthenticated connection without a request in flight, so every client gets the chance to authenticate.
//! Authenticated connections no longer count against the unauthenticated part. A connection with a request in flight
//! is never evicted.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{Notify, watch};

use crate::auth::TokenKey;

/// Maximum numbers of open connections.
#[derive(Debug, Clone, Copy)]
pub struct ConnectionLimits {
    /// In total.
    pub total: usize,
    /// Unauthenticated connections per address.
    pub per_address: usize,
    /// Slots of the total that are reserved for authenticated connections.
    pub reserved: usize,
}

/// Addresses that share one limit: a single IPv4 address, or an IPv6 /64, which one customer usually has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct AddressGroup(u128);

impl AddressGroup {
    /// Connections without an address; no IPv6 /64 has all bits set.
    const PROXY: Self = Self(u128::MAX);

    /// `None`: connections through a local proxy.
    fn of(address: Option<IpAddr>) -> Self {
        let Some(address) = address else { return Self::PROXY };
        Self(match address.to_canonical() {
            IpAddr::V4(v4) => u32::from(v4).into(),
            // At least 2^63, so it cannot collide with an IPv4 address.
            IpAddr::V6(v6) => u128::from(v6) >> 64 << 64 | 1 << 63,
        })
    }
}

/// No request in progress.
const IDLE: u32 = 0;
/// A part of a request's head has arrived.
const READING: u32 = 1;
/// The response is complete, but not yet written.
const ANSWERED: u32 = 2;
/// One request in flight; several add up. The states above apply only when there is none.
const BUSY: u32 = 4;

/// An open connection.
pub struct Connection {
    id: u64,
    group: AddressGroup,
    /// The last known token; `None` while unauthenticated.
    token: Mutex<Option<TokenKey>>,
    state: AtomicU32,
    evict: Notify,
    /// Becomes true when the service closes all connections.
    force_closed: watch::Receiver<bool>,
    registry: Arc<Connections>,
}

impl Connection {
    /// Bytes were received; without a request in progress they begin a head.
    pub fn received(&self) {
        let _ = self.state.compare_exchange(IDLE, READING, Ordering::Relaxed, Ordering::Relaxed);
    }

    /// A request was received completely and is in flight.
    pub fn request_started(&self) {
        self.state.fetch_add(BUSY, Ordering::Relaxed);
    }

    /// Its response is complete.
    pub fn request_answered(&self) {
        self.request_ended(|_| ANSWERED);
    }

    /// The request was aborted; no response will be written.
    pub fn request_aborted(&self) {
        self.request_ended(|before| if before == READING { IDLE } else { before });
    }

    /// Ends one request; when it was the last one, the new state is `rest` of the old.
    fn request_ended(&self, rest: impl Fn(u32) -> u32) {
        let _ = self.state.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |state| {
            let left = state.checked_sub(BUSY)?;
            Some(if left < BUSY { rest(left) } else { left })
        });
    }

    /// All output was written.
    pub fn flushed(&self) {
        let _ = self.state.compare_exchange(ANSWERED, IDLE, Ordering::Relaxed, Ordering::Relaxed);
    }

    /// Whether no request is in progress, a partial head included.
    pub fn is_idle(&self) -> bool {
        self.state.load(Ordering::Relaxed) == IDLE
    }

    /// Whether a request is in flight.
    pub fn is_busy(&self) -> bool {
        self.state.load(Ordering::Relaxed) >= BUSY
    }

    /// Whether it may be evicted; a partial head does not prevent this.
    pub fn is_evictable(&self) -> bool {
        self.state.load(Ordering::Relaxed) <= READING
    }

    /// Whether its last token was known.
    pub fn is_authenticated(&self) -> bool {
        self.token.lock().unwrap_or_else(PoisonError::into_inner).is_some()
    }

    /// Records the token of a request; `None` for an unknown token.
    pub fn authenticate(&self, token: Option<TokenKey>) {
        let mut slots = self.registry.slots();
        let before = {
            let mut own = self.token.lock().unwrap_or_else(PoisonError::into_inner);
            std::mem::replace(&mut *own, token)
        };
        // An evicted connection has no slot any more.
        if slots.all.contains_key(&self.id) {
            match (before.is_some(), token.is_some()) {
                (false, true) => slots.adjust_unauthenticated(self.group, -1),
                (true, false) => slots.adjust_unauthenticated(self.group, 1),
                _ => {}
            }
        }
    }

    /// Returns when the connection is evicted.
    pub async fn evicted(&self) {
        self.evict.notified().await;
    }

    /// Returns when the service closes all connections.
    pub async fn force_closed(&self) {
        // The sender lives as long as `registry`.
        let _ = self.force_closed.clone().wait_for(|out| *out).await;
    }
}

/// The slot of a connection; dropping it frees the slot.
pub struct Slot(Arc<Connection>);

impl Slot {
    /// The connection.
    pub fn connection(&self) -> &Arc<Connection> {
        &self.0
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        self.0.registry.slots().remove(self.0.id);
        self.0.registry.open.send_modify(|open| *open -= 1);
    }
}

#[derive(Default)]
struct SlotTable {
    next: u64,
    /// All connections by age, oldest first.
    all: BTreeMap<u64, Arc<Connection>>,
    unauthenticated: usize,
    unauthenticated_of: BTreeMap<AddressGroup, usize>,
}

impl SlotTable {
    fn adjust_unauthenticated(&mut self, group: AddressGroup, change: isize) {
        self.unauthenticated = self.unauthenticated.saturating_add_signed(change);
        let of = self.unauthenticated_of.entry(group).or_default();
        *of = of.saturating_add_signed(change);
        if *of == 0 {
            self.unauthenticated_of.remove(&group);
        }
    }

    fn remove(&mut self, id: u64) {
        if let Some(connection) = self.all.remove(&id)
            && !connection.is_authenticated()
        {
            self.adjust_unauthenticated(connection.group, -1);
        }
    }

    /// The oldest evictable connection that passes the filter.
    fn oldest(&self, filter: impl Fn(&Connection) -> bool) -> Option<u64> {
        self.all
            .values()
            .find(|connection| connection.is_evictable() && filter(connection))
            .map(|connection| connection.id)
    }

    /// The oldest evictable unauthenticated connection of the address that has most of them.
    fn oldest_of_largest_address(&self) -> Option<u64> {
        let mut addresses: Vec<(usize, AddressGroup)> =
            self.unauthenticated_of.iter().map(|(group, n)| (*n, *group)).collect();
        addresses.sort_unstable_by(|a, b| b.cmp(a));
        addresses.into_iter().find_map(|(_, group)| {
            self.oldest(|connection| connection.group == group && !connection.is_authenticated())
        })
    }

    /// The oldest evictable connection of the token that has most connections.
    fn oldest_of_largest_token(&self) -> Option<u64> {
        let mut held: BTreeMap<TokenKey, usize> = BTreeMap::new();
        let token =
            |connection: &Connection| *connection.token.lock().unwrap_or_else(PoisonError::into_inner);
        for key in self.all.values().filter_map(|connection| token(connection)) {
            *held.entry(key).or_default() += 1;
        }
        let mut tokens: Vec<(usize, TokenKey)> = held.into_iter().map(|(key, n)| (n, key)).collect();
        tokens.sort_unstable_by(|a, b| b.cmp(a));
        tokens.into_iter().find_map(|(_, key)| self.oldest(|connection| token(connection) == Some(key)))
    }
}

/// Result of admitting a connection.
pub enum Admission {
    /// A free slot.
    Admitted(Slot),
    /// The slot of an evicted connection.
    AdmittedByEviction(Slot),
    /// Rejected: no other connection is evictable.
    Rejected,
}

/// All open connections.
pub struct Connections {
    limits: ConnectionLimits,
    slots: Mutex<SlotTable>,
    /// Number of open connections, including evicted ones that are still closing.
    open: watch::Sender<usize>,
    force_close: watch::Sender<bool>,
}

impl Connections {
    /// Without connections.
    pub fn new(limits: ConnectionLimits) -> Arc<Self> {
        Arc::new(Self {
            limits,
            slots: Mutex::default(),
            open: watch::Sender::new(0),
            force_close: watch::Sender::new(false),
        })
    }

    fn slots(&self) -> std::sync::MutexGuard<'_, SlotTable> {
        self.slots.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Number of open connections.
    pub fn open(&self) -> usize {
        *self.open.borrow()
    }

    /// Closes all connections at once.
    pub fn close_all(&self) {
        self.force_close.send_replace(true);
    }

    /// Returns when all connections are closed.
    pub async fn all_closed(&self) {
        // Cannot fail: `self` holds the sender.
        let _ = self.open.subscribe().wait_for(|open| *open == 0).await;
    }

    /// Admits a new connection and evicts another if necessary. `from` is `None` for a proxy, to which the limit per
    /// address does not apply, because it forwards many clients.
    pub fn admit(self: &Arc<Self>, from: Option<IpAddr>) -> Admission {
        let ConnectionLimits { total, per_address, reserved } = self.limits;
        let group = AddressGroup::of(from);
        let mut slots = self.slots();
        let own = slots.unauthenticated_of.get(&group).copied().unwrap_or(0);
        let victim = if own >= per_address && group != AddressGroup::PROXY {
            Some(slots.oldest(|connection| connection.group == group && !connection.is_authenticated()))
        } else if slots.unauthenticated >= total.saturating_sub(reserved).max(1) {
            Some(slots.oldest_of_largest_address())
        } else if slots.all.len() >= total {
            Some(slots.oldest_of_largest_address().or_else(|| slots.oldest_of_largest_token()))
        } else {
            None
        };
        let evicted = victim.is_some();
        match victim {
            Some(None) => return Admission::Rejected,
            Some(Some(id)) => {
                if let Some(connection) = slots.all.get(&id).cloned() {
                    slots.remove(id);
                    connection.evict.notify_one();
                }
            }
            None => {}
        }
        let id = slots.next;
        slots.next += 1;
        let connection = Arc::new(Connection {
            id,
            group,
            token: Mutex::new(None),
            state: AtomicU32::new(IDLE),
            evict: Notify::new(),
            force_closed: self.force_close.subscribe(),
            registry: self.clone(),
        });
        slots.all.insert(id, connection.clone());
        slots.adjust_unauthenticated(group, 1);
        drop(slots);
        self.open.send_modify(|open| *open += 1);
        let slot = Slot(connection);
        if evicted { Admission::AdmittedByEviction(slot) } else { Admission::Admitted(slot) }
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
        Connections::new(ConnectionLimits { total, per_address, reserved })
    }

    fn enter(connections: &Arc<Connections>, from: u8) -> Slot {
        match connections.admit(Some(address(from))) {
            Admission::Admitted(slot) | Admission::AdmittedByEviction(slot) => slot,
            Admission::Rejected => panic!("refused"),
        }
    }

    /// Whether it was evicted.
    fn is_evicted(slot: &Slot) -> bool {
        !slot.0.registry.slots().all.contains_key(&slot.0.id)
    }

    #[test]
    fn idle_unauthenticated_connections_do_not_block_tokens() {
        let connections = connections(100, 60, 50);
        let unauthenticated: Vec<Slot> = (0..200).map(|i| enter(&connections, i % 4)).collect();
        assert_eq!(
            unauthenticated.iter().filter(|slot| !is_evicted(slot)).count(),
            50,
            "the other half is reserved"
        );
        assert!(
            !is_evicted(&unauthenticated[199]) && is_evicted(&unauthenticated[0]),
            "the oldest were evicted"
        );
        // Each authenticates at once and then keeps its slot.
        let known: Vec<Slot> = (0..50)
            .map(|_| {
                let slot = enter(&connections, 9);
                slot.connection().authenticate(Some(token(1)));
                slot
            })
            .collect();
        let more: Vec<Slot> = (0..200).map(|i| enter(&connections, i % 4)).collect();
        assert!(known.iter().all(|slot| !is_evicted(slot)));
        assert_eq!(more.iter().filter(|slot| !is_evicted(slot)).count(), 50);
        drop((unauthenticated, known, more));
        assert_eq!((connections.open(), connections.slots().unauthenticated), (0, 0));
        assert!(connections.slots().unauthenticated_of.is_empty());
    }

    #[test]
    fn connections_per_address_are_limited() {
        let connections = connections(100, 10, 0);
        let other = enter(&connections, 1);
        let greedy: Vec<Slot> = (0..30).map(|_| enter(&connections, 2)).collect();
        assert!(!is_evicted(&other));
        assert_eq!(greedy.iter().filter(|slot| !is_evicted(slot)).count(), 10);
        // An IPv6 /64 counts as one address.
        let of = |text: &str| AddressGroup::of(Some(text.parse().expect("an address")));
        assert_eq!(of("2001:db8::1"), of("2001:db8::ffff:1"));
        assert_ne!(of("2001:db8::1"), of("2001:db8:0:1::1"));
        assert_eq!(of("::ffff:192.0.2.7"), of("192.0.2.7"));
    }

    #[test]
    fn busy_connections_are_not_evicted() {
        let connections = connections(2, 2, 0);
        let slots = [enter(&connections, 1), enter(&connections, 2)];
        for slot in &slots {
            slot.connection().received();
            slot.connection().request_started();
        }
        assert!(matches!(connections.admit(Some(address(3))), Admission::Rejected));
        slots[1].connection().request_answered();
        assert!(
            matches!(connections.admit(Some(address(3))), Admission::Rejected),
            "the response is not written yet"
        );
        slots[1].connection().flushed();
        assert!(slots[1].connection().is_idle());
        // A partial head does not prevent eviction.
        slots[1].connection().received();
        let _third = enter(&connections, 3);
        assert!(is_evicted(&slots[1]) && !is_evicted(&slots[0]));
    }

    /// Authenticated connections may fill all slots; then the token with most connections loses one.
    #[test]
    fn largest_token_loses_a_connection() {
        let connections = connections(10, 10, 5);
        let greedy: Vec<Slot> = (0..9)
            .map(|_| {
                let slot = enter(&connections, 1);
                slot.connection().authenticate(Some(token(1)));
                slot
            })
            .collect();
        let modest = enter(&connections, 2);
        modest.connection().authenticate(Some(token(2)));
        let third = enter(&connections, 3);
        assert!(is_evicted(&greedy[0]) && !is_evicted(&modest) && !is_evicted(&third));
        // A revoked token does not protect its connection.
        greedy[1].connection().authenticate(None);
        third.connection().authenticate(Some(token(3)));
        let _fourth = enter(&connections, 4);
        assert!(is_evicted(&greedy[1]) && !is_evicted(&greedy[2]));
    }

    /// The limit per address does not apply to a proxy, the limit of unauthenticated connections does.
    #[test]
    fn limit_per_address_does_not_apply_to_a_proxy() {
        let connections = connections(10, 2, 5);
        let slots: Vec<Slot> = (0..6)
            .map(|_| match connections.admit(None) {
                Admission::Admitted(slot) | Admission::AdmittedByEviction(slot) => slot,
                Admission::Rejected => panic!("refused"),
            })
            .collect();
        assert_eq!(
            slots.iter().filter(|slot| is_evicted(slot)).count(),
            1,
            "five slots are for unauthenticated connections"
        );
    }

    /// A connection stays busy until its last request ends.
    #[test]
    fn concurrent_requests_are_counted() {
        let connections = connections(1, 1, 0);
        let slot = enter(&connections, 1);
        let connection = slot.connection();
        connection.received();
        connection.request_started();
        connection.request_started();
        connection.request_answered();
        assert!(connection.is_busy() && !connection.is_idle() && !connection.is_evictable());
        connection.flushed();
        assert!(connection.is_busy(), "the other request is in flight");
        connection.request_aborted();
        assert!(!connection.is_busy() && connection.is_idle(), "nothing is written for an aborted request");
        connection.request_started();
        connection.request_answered();
        assert!(!connection.is_busy() && !connection.is_evictable(), "the response is not written yet");
        connection.flushed();
        assert!(connection.is_idle());
        connection.request_aborted();
        assert!(connection.is_idle(), "a surplus call has no effect");
    }

    #[tokio::test]
    async fn eviction_is_signalled_and_all_closed_returns() {
        let connections = connections(1, 1, 0);
        let first = enter(&connections, 1);
        let second = enter(&connections, 1);
        first.connection().evicted().await;
        assert_eq!(connections.open(), 2, "not closed yet");
        drop(first);
        drop(second);
        connections.all_closed().await;
    }
}
