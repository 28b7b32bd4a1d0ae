//! A queue that is fair between clients: each client has a lane of its own, and lanes take turns by the time that their
//! work took (start-time fair queueing: Goyal, Vin and Cheng, SIGCOMM 1996).
//!
//! The time of a job is known only when it is done: queries of equal size differ by an order of magnitude. So a job is
//! charged an estimate when it starts, and its lane the difference when it ends ([`FairQueue::record`]). A lane whose
//! work took longer than estimated waits until the others have had as much, also when it was empty in between. The
//! estimate is the lane's own mean time per unit of size, so the times of one client do not change what is expected of
//! another.
//!
//! A lane may hold at most as many items as there are free slots (dynamic thresholds: Choudhury and Hahne, 1998): one
//! lane half of the queue, two lanes a third each. So there is always a slot for a new client. Within a lane, small work
//! goes before large work, but a large item waits for at most `STREAK` small ones.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::num::NonZeroUsize;
use std::time::Duration;

/// Largest size of small work: that of a query of 1024 rows.
const SMALL: u64 = 1024 + 256;

/// Maximum number of small items in a row while large work waits in the same lane.
const STREAK: u32 = 3;

/// Nanoseconds per unit of size before the first measurement: about 15 ms for a query of 1024 rows.
const FIRST_PACE: u64 = 12_000;

/// Weight of all earlier times against a new one in a pace.
const PACE_MEMORY: u64 = 7;

/// Lanes that are kept while they are empty, for their pace. More are forgotten, those with the least debt first.
const KEPT_LANES: usize = 4096;

struct Lane<T> {
    small: VecDeque<(u64, T)>,
    large: VecDeque<(u64, T)>,
    /// Small items in a row.
    streak: u32,
    /// Virtual time, nanoseconds: when the work that it was charged ends, which is the start of its next item. That of an
    /// empty lane may be in the past.
    finish: u64,
    /// Number of its arrival among the lanes that became non-empty.
    arrival: u64,
    /// Total size of its items.
    size: u64,
    /// Nanoseconds per unit of size, a running mean; `None` before the first measurement.
    pace: Option<u64>,
}

impl<T> Default for Lane<T> {
    fn default() -> Self {
        let (small, large) = (VecDeque::new(), VecDeque::new());
        Self { small, large, streak: 0, finish: 0, arrival: 0, size: 0, pace: None }
    }
}

impl<T> Lane<T> {
    fn len(&self) -> usize {
        self.small.len() + self.large.len()
    }

    /// Pops its next item that is allowed.
    fn pop_if(&mut self, is_allowed: impl Fn(&T) -> bool) -> Option<(u64, T)> {
        let first = |items: &VecDeque<(u64, T)>| items.iter().position(|(_, work)| is_allowed(work));
        let popped = match (first(&self.small), first(&self.large)) {
            (Some(at), large) if large.is_none() || self.streak < STREAK => {
                self.streak += 1;
                self.small.remove(at)
            }
            (_, Some(at)) => {
                self.streak = 0;
                self.large.remove(at)
            }
            _ => None,
        };
        self.size -= popped.as_ref().map_or(0, |(size, _)| *size);
        popped
    }

    fn largest(&self) -> u64 {
        self.small.iter().chain(&self.large).map(|(size, _)| *size).max().unwrap_or(0)
    }
}

/// A queue with one lane per key. `None` is the lane of clients that are not distinguished; it may fill the queue.
pub struct FairQueue<K, T> {
    lanes: BTreeMap<Option<K>, Lane<T>>,
    /// The lanes with items, by the virtual time at which their next item starts, and by when they got their first one.
    turns: BTreeSet<(u64, u64, Option<K>)>,
    /// Virtual time, nanoseconds: the start of the item that was popped last.
    now: u64,
    /// Counts the lanes that became non-empty.
    arrivals: u64,
    capacity: usize,
    len: usize,
}

impl<K: Ord + Copy, T> FairQueue<K, T> {
    /// An empty queue for at most `capacity` items.
    pub fn new(capacity: NonZeroUsize) -> Self {
        Self {
            lanes: BTreeMap::new(),
            turns: BTreeSet::new(),
            now: 0,
            arrivals: 0,
            capacity: capacity.get(),
            len: 0,
        }
    }

    /// Number of items.
    pub const fn len(&self) -> usize {
        self.len
    }

    /// Whether the queue is empty.
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Whether this lane may take one more item.
    pub fn has_room(&self, key: Option<K>) -> bool {
        let free = self.capacity - self.len;
        let held = self.lanes.get(&key).map_or(0, Lane::len);
        if key.is_none() { free > 0 } else { held < free }
    }

    /// Estimated time of work of this size in this lane; zero before the first measurement of any lane.
    pub fn estimate(&self, key: Option<K>, size: u64) -> Duration {
        let known = || self.lanes.values().filter_map(|lane| lane.pace).min();
        let pace = self.lanes.get(&key).and_then(|lane| lane.pace).or_else(known).unwrap_or(0);
        Duration::from_nanos(pace.saturating_mul(size))
    }

    /// Estimated upper bound of the time of the work that is done before work pushed to this lane now, by one thread:
    /// all of this lane, and of every other lane what it can use in the meantime.
    pub fn ahead(&self, key: Option<K>, size: u64) -> Duration {
        let size_of = |key: &Option<K>| self.lanes.get(key).map_or(0, |lane| lane.size);
        let own = self.estimate(key, size_of(&key));
        let debt = self.lanes.get(&key).map_or(0, |lane| lane.finish.saturating_sub(self.now));
        let turns = own + self.estimate(key, size) + Duration::from_nanos(debt);
        let others = self.lanes.iter().filter(|(other, _)| **other != key);
        // A lane may be ahead by its largest item.
        let ahead = |(other, lane): (&Option<K>, &Lane<T>)| {
            self.estimate(*other, lane.size).min(turns + self.estimate(*other, lane.largest()))
        };
        own + others.map(ahead).sum::<Duration>()
    }

    /// Pushes an item without checking the limit, see [`Self::has_room`].
    pub fn push(&mut self, key: Option<K>, size: u64, work: T) {
        let lane = self.lanes.entry(key).or_default();
        if lane.len() == 0 {
            // An empty lane keeps its debt, and no unused time.
            lane.finish = lane.finish.max(self.now);
            self.arrivals += 1;
            lane.arrival = self.arrivals;
            self.turns.insert((lane.finish, lane.arrival, key));
        }
        lane.size += size;
        let items = if size <= SMALL { &mut lane.small } else { &mut lane.large };
        items.push_back((size, work));
        self.len += 1;
    }

    /// Removes the items for which `keep` is false; the order of turns does not change.
    pub fn retain(&mut self, keep: impl Fn(&T) -> bool) {
        for lane in self.lanes.values_mut() {
            lane.small.retain(|(_, work)| keep(work));
            lane.large.retain(|(_, work)| keep(work));
            lane.size = lane.small.iter().chain(&lane.large).map(|(size, _)| size).sum();
        }
        self.turns.retain(|(_, _, key)| self.lanes.get(key).is_some_and(|lane| lane.len() > 0));
        self.len = self.lanes.values().map(Lane::len).sum();
    }

    /// Pops the next item, with what to [`record`](Self::record) when it is done.
    pub fn pop(&mut self) -> Option<(Charge<K>, T)> {
        self.pop_if(|_| true)
    }

    /// As [`Self::pop`], the next item that is allowed. Items that are not keep their lane's turn.
    pub fn pop_if(&mut self, is_allowed: impl Fn(&T) -> bool) -> Option<(Charge<K>, T)> {
        let lanes = &mut self.lanes;
        let taken = self.turns.iter().find_map(|turn| {
            let (size, work) = lanes.get_mut(&turn.2)?.pop_if(&is_allowed)?;
            Some((*turn, size, work))
        });
        let (turn, size, work) = taken?;
        self.turns.remove(&turn);
        let (start, arrival, key) = turn;
        // A lane whose items were not allowed may start in the past.
        self.now = self.now.max(start);
        let lane = self.lanes.get_mut(&key)?;
        self.len -= 1;
        let charged = lane.pace.unwrap_or(FIRST_PACE).saturating_mul(size);
        lane.finish = start.saturating_add(charged);
        if lane.len() > 0 {
            self.turns.insert((lane.finish, arrival, key));
        }
        Some((Charge { key, size, charged }, work))
    }

    /// Charges a lane the time that its item took, in place of the estimate; `None` if it was not begun.
    pub fn record(&mut self, charge: &Charge<K>, took: Option<Duration>) {
        let Charge { key, size, charged } = *charge;
        let took_ns = took.map_or(0, |took| u64::try_from(took.as_nanos()).unwrap_or(u64::MAX));
        let lane = self.lanes.entry(key).or_default();
        let is_waiting = self.turns.remove(&(lane.finish, lane.arrival, key));
        lane.finish = lane.finish.saturating_sub(charged).saturating_add(took_ns);
        if is_waiting {
            lane.finish = lane.finish.max(self.now);
            self.turns.insert((lane.finish, lane.arrival, key));
        }
        if took.is_some() {
            let pace = took_ns / size.max(1);
            let mean =
                |mean: u64| (mean.saturating_mul(PACE_MEMORY).saturating_add(pace)) / (PACE_MEMORY + 1);
            lane.pace = Some(lane.pace.map_or(pace, mean));
        }
        self.forget();
    }

    /// Drops empty lanes beyond [`KEPT_LANES`].
    fn forget(&mut self) {
        if self.lanes.len() <= KEPT_LANES {
            return;
        }
        let empty = self.lanes.iter().filter(|(_, lane)| lane.len() == 0);
        let least = empty.min_by_key(|(_, lane)| lane.finish).map(|(key, _)| *key);
        if let Some(key) = least {
            self.lanes.remove(&key);
        }
    }
}

/// What an item was charged when it was popped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Charge<K> {
    key: Option<K>,
    size: u64,
    /// Nanoseconds.
    charged: u64,
}

impl<K> Charge<K> {
    /// Estimated time of the item.
    pub const fn estimate(&self) -> Duration {
        Duration::from_nanos(self.charged)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn queue(capacity: usize) -> FairQueue<u8, u64> {
        FairQueue::new(NonZeroUsize::new(capacity).expect("not zero"))
    }

    const fn ns(size: u64) -> Duration {
        Duration::from_nanos(size * FIRST_PACE)
    }

    /// Pops an item and records that it took this long.
    fn work(queue: &mut FairQueue<u8, u64>, took: impl Fn(u64, u64) -> Duration) -> Option<u64> {
        let (charge, work) = queue.pop()?;
        queue.record(&charge, Some(took(work, charge.size)));
        Some(work)
    }

    /// Over any stretch, no lane with work is behind another by more than the largest item of each.
    #[test]
    fn lanes_share_by_time() {
        let mut queue = queue(10_000);
        for (key, size, count) in [(1, 4096, 500), (2, 512, 4000), (3, 1024, 2000)] {
            (0..count).for_each(|_| queue.push(Some(key), size, u64::from(key)));
        }
        let mut done: BTreeMap<u64, Duration> = BTreeMap::new();
        // Work of the second lane takes ten times as long as its size says.
        let took = |key: u64, size: u64| ns(size) * if key == 2 { 10 } else { 1 };
        for _ in 0..2000 {
            let (charge, key) = queue.pop().expect("work");
            let took = took(key, charge.size);
            queue.record(&charge, Some(took));
            *done.entry(key).or_default() += took;
            let (least, most) = (done.values().min().expect("some"), done.values().max().expect("some"));
            assert!(done.len() < 3 || most.saturating_sub(*least) <= ns(2 * 5120), "{done:?}");
        }
        assert!(done.values().all(|time| *time > ns(500_000)), "{done:?}");
    }

    /// A client that sends one expensive query at a time pays for it, although its lane is empty in between.
    #[test]
    fn debt_outlasts_an_empty_lane() {
        let mut queue = queue(100);
        let took = |key: u64, size: u64| ns(size) * if key == 1 { 30 } else { 1 };
        queue.push(Some(1), 500, 1);
        assert_eq!(work(&mut queue, took), Some(1));
        (0..40).for_each(|_| queue.push(Some(2), 500, 2));
        queue.push(Some(1), 500, 1);
        let order: Vec<u64> = std::iter::from_fn(|| work(&mut queue, took)).collect();
        let at = order.iter().position(|key| *key == 1).expect("done");
        assert!((29..=31).contains(&at), "after {at} of the other client");
        // Time that a client did not use is not saved up.
        (0..50).for_each(|_| queue.push(Some(3), 500, 3));
        while work(&mut queue, took).is_some() {}
        (0..10).for_each(|_| queue.push(Some(2), 500, 2));
        (0..10).for_each(|_| queue.push(Some(3), 500, 3));
        let order: Vec<u64> = std::iter::from_fn(|| work(&mut queue, took)).collect();
        assert!(order.windows(3).all(|w| w[0] != w[1] || w[1] != w[2]), "{order:?}");
    }

    #[test]
    fn times_of_one_client_are_not_expected_of_another() {
        let mut queue = queue(100);
        for _ in 0..50 {
            queue.push(Some(1), 500, 1);
            queue.push(Some(2), 500, 2);
            for _ in 0..2 {
                work(&mut queue, |key, size| ns(size) * if key == 1 { 100 } else { 1 });
            }
        }
        assert_eq!(queue.estimate(Some(1), 500), ns(50_000));
        assert_eq!(queue.estimate(Some(2), 500), ns(500));
        assert_eq!(queue.estimate(Some(3), 500), ns(500), "a new client is not refused for it");
    }

    #[test]
    fn work_that_was_not_begun_costs_nothing() {
        let mut queue = queue(100);
        (0..20).for_each(|i| queue.push(Some(1), 500, i));
        for _ in 0..10 {
            let (charge, _) = queue.pop().expect("work");
            queue.record(&charge, None);
        }
        queue.push(Some(2), 500, 100);
        assert_eq!(queue.estimate(Some(1), 1), Duration::ZERO, "nothing was measured");
        let order: Vec<u64> = std::iter::from_fn(|| work(&mut queue, |_, size| ns(size))).collect();
        assert_eq!(order[1], 100, "{order:?}");
    }

    /// What is not allowed keeps its turn and delays nothing else, in its own lane neither.
    #[test]
    fn items_that_are_not_allowed_are_passed_over() {
        let mut queue = queue(100);
        for (key, size, work) in [(1, 5000, 100), (1, 500, 1), (2, 5000, 101), (3, 500, 2), (3, 500, 3)] {
            queue.push(Some(key), size, work);
        }
        let short = |work: &u64| *work < 100;
        let mut order = Vec::new();
        while let Some((charge, work)) = queue.pop_if(short) {
            queue.record(&charge, Some(ns(charge.size)));
            order.push(work);
        }
        assert_eq!((order, queue.len()), (vec![1, 2, 3], 2));
        queue.push(Some(3), 500, 4);
        let rest: Vec<u64> = std::iter::from_fn(|| work(&mut queue, |_, size| ns(size))).collect();
        assert_eq!(rest, [101, 100, 4], "they waited longest");
    }

    #[test]
    fn lanes_have_dynamic_thresholds() {
        let mut queue = queue(32);
        let mut sent = 0;
        while queue.has_room(Some(1)) {
            queue.push(Some(1), 4096, 1);
            sent += 1;
        }
        assert_eq!(sent, 16, "half of the queue");
        let mut second = 0;
        while queue.has_room(Some(2)) {
            queue.push(Some(2), 512, 2);
            second += 1;
        }
        assert_eq!(second, 8, "half of the rest");
        assert!(queue.has_room(Some(3)), "there is a slot for a new client");
        // Small items of the second lane do not wait for all of the first.
        let order: Vec<u64> = std::iter::from_fn(|| queue.pop()).map(|(_, lane)| lane).collect();
        let last_of_second = order.iter().rposition(|lane| *lane == 2).expect("done");
        assert!(last_of_second < 10, "{order:?}");
        assert_eq!((order.len(), queue.len()), (24, 0));
    }

    #[test]
    fn small_work_first_without_starving_large_work() {
        let mut queue = queue(100);
        (0..3).for_each(|i| queue.push(None, 4000, 100 + i));
        (0..9).for_each(|i| queue.push(None, 500, i));
        let order: Vec<u64> = std::iter::from_fn(|| queue.pop()).map(|(_, work)| work).collect();
        assert_eq!(order, [0, 1, 2, 100, 3, 4, 5, 101, 6, 7, 8, 102]);
    }

    #[test]
    fn anonymous_lane_may_fill_the_queue() {
        let mut queue = queue(3);
        for i in 0..3 {
            assert!(queue.has_room(None));
            queue.push(None, 1, i);
        }
        assert!(!queue.has_room(None) && !queue.has_room(Some(1)));
    }

    #[test]
    fn removed_items_free_slots_and_size() {
        let mut queue = queue(6);
        for (key, size, work) in
            [(1, 500, 0), (1, 4000, 1), (2, 500, 2), (2, 4000, 3), (3, 500, 4), (3, 500, 6)]
        {
            queue.push(Some(key), size, work);
        }
        assert!(!queue.has_room(Some(4)));
        queue.retain(|work| work % 2 == 1);
        assert!(queue.has_room(Some(3)) && queue.len() == 2);
        queue.push(Some(3), 500, 5);
        let order: Vec<u64> = std::iter::from_fn(|| queue.pop()).map(|(_, work)| work).collect();
        assert_eq!((order.len(), queue.len(), queue.is_empty()), (3, 0, true));
        assert!([1, 3, 5].iter().all(|work| order.contains(work)), "{order:?}");
        queue.retain(|_| false);
        assert!(queue.pop().is_none());
    }

    /// `ahead` is an upper bound, for lanes of different pace and with debt.
    #[test]
    fn ahead_is_an_upper_bound() {
        let took = |key: u64, size: u64| ns(size) * [1, 8, 1, 2][key as usize];
        for (own, debt) in [(0, 0), (1, 0), (5, 0), (0, 3), (5, 3)] {
            let mut queue = queue(1000);
            for key in [1_u8, 2, 3] {
                queue.push(Some(key), 600, u64::from(key));
                work(&mut queue, took);
            }
            (0..debt).for_each(|_| queue.push(Some(2), 4096, 2));
            for _ in 0..debt {
                work(&mut queue, took);
            }
            (0..40).for_each(|_| queue.push(Some(1), 4096, 1));
            (0..7).for_each(|_| queue.push(Some(3), 600, 3));
            (0..own).for_each(|_| queue.push(Some(2), 600, 2));
            let ahead = queue.ahead(Some(2), 600);
            queue.push(Some(2), 600, 0);
            let mut before = Duration::ZERO;
            while let Some((charge, key)) = queue.pop() {
                if key == 0 {
                    break;
                }
                let took = took(key, charge.size);
                queue.record(&charge, Some(took));
                before += took;
            }
            assert!(
                before <= ahead && ahead <= 3 * before + ns(3 * 4096 * 8),
                "{own}, {debt}: {before:?} of {ahead:?}"
            );
        }
    }

    #[test]
    fn lanes_of_clients_that_left_are_forgotten() {
        let mut queue: FairQueue<u32, u32> = FairQueue::new(NonZeroUsize::MIN);
        for key in 0..2 * KEPT_LANES as u32 {
            queue.push(Some(key), 500, key);
            let (charge, _) = queue.pop().expect("work");
            queue.record(&charge, Some(ns(500)));
        }
        assert_eq!(queue.lanes.len(), KEPT_LANES);
        assert!(queue.lanes.contains_key(&Some(2 * KEPT_LANES as u32 - 1)));
    }
}
