//! A queue that is fair between clients: each client has a lane of its own, and lanes take turns by the cost of their
//! work (deficit round robin: Shreedhar and Varghese, SIGCOMM 1995).
//!
//! A client that sends much fills only its own lane. A lane may hold at most as many items as there are free slots
//! (dynamic thresholds: Choudhury and Hahne, 1998): one lane half of the queue, two lanes a third each. So there is
//! always a slot for a new client. Within a lane, small work goes before large work, but a large item waits for at
//! most `STREAK` small ones.

use std::collections::{BTreeMap, VecDeque};
use std::num::NonZeroUsize;

/// Budget of a lane per turn: the cost of a query of 1024 rows.
const QUANTUM: u64 = 1024;

/// Largest cost of small work.
const SMALL: u64 = 1024 + 256;

/// Maximum number of small items in a row while large work waits in the same lane.
const STREAK: u32 = 3;

struct Lane<T> {
    small: VecDeque<(u64, T)>,
    large: VecDeque<(u64, T)>,
    /// Small items in a row.
    streak: u32,
    /// Unused budget.
    deficit: u64,
    /// Total cost of its items.
    cost: u64,
}

impl<T> Default for Lane<T> {
    fn default() -> Self {
        Self { small: VecDeque::new(), large: VecDeque::new(), streak: 0, deficit: 0, cost: 0 }
    }
}

impl<T> Lane<T> {
    fn len(&self) -> usize {
        self.small.len() + self.large.len()
    }

    fn next_is_small(&self) -> bool {
        !self.small.is_empty() && (self.large.is_empty() || self.streak < STREAK)
    }

    fn next_cost(&self) -> Option<u64> {
        let next = if self.next_is_small() { &self.small } else { &self.large };
        next.front().map(|(cost, _)| *cost)
    }

    fn pop(&mut self) -> Option<(u64, T)> {
        let small = self.next_is_small();
        self.streak = if small { self.streak + 1 } else { 0 };
        let popped = if small { self.small.pop_front() } else { self.large.pop_front() };
        self.cost -= popped.as_ref().map_or(0, |(cost, _)| *cost);
        popped
    }
}

/// A queue with one lane per key. `None` is the lane of clients that are not distinguished; it may fill the queue.
pub struct FairQueue<K, T> {
    lanes: BTreeMap<Option<K>, Lane<T>>,
    /// Keys of all non-empty lanes, in order of their turns.
    turns: VecDeque<Option<K>>,
    capacity: usize,
    len: usize,
}

impl<K: Ord + Copy, T> FairQueue<K, T> {
    /// An empty queue for at most `capacity` items.
    pub fn new(capacity: NonZeroUsize) -> Self {
        Self { lanes: BTreeMap::new(), turns: VecDeque::new(), capacity: capacity.get(), len: 0 }
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

    /// Upper bound of the cost that is done before work pushed to this lane now: all of this lane, and of every other
    /// lane what it can spend in the meantime.
    pub fn ahead(&self, key: Option<K>, cost: u64) -> u64 {
        let own = self.lanes.get(&key).map_or(0, |lane| lane.cost);
        // A lane may be ahead by the cost of the largest item.
        let turns = own + cost + 5 * QUANTUM;
        let others = self.lanes.iter().filter(|(other, _)| **other != key);
        own + others.map(|(_, lane)| lane.cost.min(turns)).sum::<u64>()
    }

    /// Pushes an item without checking the limit, see [`Self::has_room`].
    pub fn push(&mut self, key: Option<K>, cost: u64, work: T) {
        let lane = self.lanes.entry(key).or_default();
        if lane.len() == 0 {
            self.turns.push_back(key);
        }
        lane.cost += cost;
        if cost <= SMALL {
            lane.small.push_back((cost, work));
        } else {
            lane.large.push_back((cost, work));
        }
        self.len += 1;
    }

    /// Removes the items for which `keep` is false; the order of turns does not change.
    pub fn retain(&mut self, keep: impl Fn(&T) -> bool) {
        for lane in self.lanes.values_mut() {
            lane.small.retain(|(_, work)| keep(work));
            lane.large.retain(|(_, work)| keep(work));
            lane.cost = lane.small.iter().chain(&lane.large).map(|(cost, _)| cost).sum();
        }
        self.lanes.retain(|_, lane| lane.len() > 0);
        self.turns.retain(|key| self.lanes.contains_key(key));
        self.len = self.lanes.values().map(Lane::len).sum();
    }

    /// Pops the next item and its cost.
    pub fn pop(&mut self) -> Option<(u64, T)> {
        loop {
            let key = *self.turns.front()?;
            let lane = self.lanes.get_mut(&key)?;
            match lane.next_cost() {
                Some(cost) if cost <= lane.deficit => {
                    lane.deficit -= cost;
                    let popped = lane.pop();
                    self.len -= 1;
                    if lane.len() == 0 {
                        // An empty lane keeps no unused budget.
                        self.turns.pop_front();
                        self.lanes.remove(&key);
                    }
                    return popped;
                }
                Some(_) => {
                    lane.deficit += QUANTUM;
                    self.turns.rotate_left(1);
                }
                None => {
                    self.turns.pop_front();
                    self.lanes.remove(&key);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn queue(capacity: usize) -> FairQueue<u8, u64> {
        FairQueue::new(NonZeroUsize::new(capacity).expect("not zero"))
    }

    /// Over any stretch, no lane with work is behind another by more than one turn and one item.
    #[test]
    fn lanes_share_by_cost() {
        let mut queue = queue(10_000);
        for (key, cost, count) in [(1, 4096, 500), (2, 512, 4000), (3, 1024, 2000)] {
            (0..count).for_each(|_| queue.push(Some(key), cost, u64::from(key)));
        }
        let mut done: BTreeMap<u64, u64> = BTreeMap::new();
        for _ in 0..4000 {
            let (cost, key) = queue.pop().expect("work");
            *done.entry(key).or_default() += cost;
            let (least, most) = (done.values().min().expect("some"), done.values().max().expect("some"));
            let seen = done.len() == 3;
            assert!(!seen || most - least <= 2 * (4096 + QUANTUM), "{done:?}");
        }
        assert!(done.values().all(|cost| *cost > 500_000), "{done:?}");
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
    fn removed_items_free_slots_and_cost() {
        let mut queue = queue(6);
        for (key, cost, work) in
            [(1, 500, 0), (1, 4000, 1), (2, 500, 2), (2, 4000, 3), (3, 500, 4), (3, 500, 6)]
        {
            queue.push(Some(key), cost, work);
        }
        assert!(!queue.has_room(Some(4)));
        queue.retain(|work| work % 2 == 1);
        assert!(queue.has_room(Some(3)) && queue.len() == 2);
        assert_eq!(queue.ahead(Some(3), 1), 8000);
        queue.push(Some(3), 500, 5);
        let order: Vec<u64> = std::iter::from_fn(|| queue.pop()).map(|(_, work)| work).collect();
        assert_eq!((order.len(), queue.len(), queue.is_empty()), (3, 0, true));
        assert!([1, 3, 5].iter().all(|work| order.contains(work)), "{order:?}");
        queue.retain(|_| false);
        assert_eq!(queue.pop(), None);
    }

    /// `ahead` is an upper bound.
    #[test]
    fn ahead_is_an_upper_bound() {
        for own in [0, 1, 5] {
            let mut queue = queue(1000);
            (0..40).for_each(|_| queue.push(Some(1), 4096, 0));
            (0..7).for_each(|_| queue.push(Some(3), 600, 0));
            (0..own).for_each(|_| queue.push(Some(2), 600, 0));
            let ahead = queue.ahead(Some(2), 600);
            queue.push(Some(2), 600, 1);
            let before: u64 =
                std::iter::from_fn(|| queue.pop()).take_while(|(_, w)| *w == 0).map(|(c, _)| c).sum();
            assert!(before <= ahead && ahead <= 3 * before + 3 * 4096, "{own}: {before} of {ahead}");
        }
    }
}
