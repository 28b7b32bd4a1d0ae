//! Which workers hold which regions: rendezvous hashing with several copies and a limit for each worker (decision 0057).
//!
//! Each pair of a region and a worker has a weight, a hash of both. A region belongs to the workers of its highest weights, as
//! long as they have space: pairs are taken in the order of their weights, first for one copy of every region, then for the
//! second, and so on. So every worker computes the same from the same list of workers, and a worker that joins or leaves
//! changes only what it takes or had, and what a full worker could not take.

use std::collections::BTreeMap;
use std::num::{NonZeroU32, NonZeroUsize};

use veiloc_map::regions::ObjectId;

/// How a worker takes part in the placement of regions.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Placed {
    /// Name that stays the same when the worker is started again, so that it gets the same regions. Workers of equal names
    /// get equal regions.
    pub name: String,
    /// Number of workers that should hold each region. If workers differ, the largest number counts.
    pub replicas: NonZeroU32,
    /// Maximum number of regions that it takes; `None`: no limit.
    pub max_regions: Option<NonZeroU32>,
}

impl Placed {
    /// Maximum length of a name, bytes.
    pub const MAX_NAME: usize = 128;
}

/// The workers of each region.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct Placement {
    by_region: BTreeMap<ObjectId, Vec<String>>,
    /// Copies for which no worker has space.
    pub(crate) missing: usize,
}

impl Placement {
    /// Places these regions on the workers of these names, with their limits.
    pub(crate) fn of(
        regions: impl IntoIterator<Item = ObjectId>,
        workers: &BTreeMap<String, Option<NonZeroU32>>,
        replicas: NonZeroUsize,
    ) -> Self {
        let mut by_region: BTreeMap<ObjectId, Vec<String>> =
            regions.into_iter().map(|region| (region, Vec::new())).collect();
        let keys: Vec<(&String, u64)> = workers.keys().map(|name| (name, key_of(name))).collect();
        let mut pairs: Vec<(u64, ObjectId, &String)> = Vec::with_capacity(by_region.len() * keys.len());
        for region in by_region.keys() {
            pairs.extend(keys.iter().map(|(name, key)| (weight(region, *key), *region, *name)));
        }
        pairs.sort_unstable_by(|a, b| b.cmp(a));
        let mut space: BTreeMap<&String, usize> = workers
            .iter()
            .map(|(name, most)| (name, most.map_or(usize::MAX, |most| most.get() as usize)))
            .collect();
        let wanted = replicas.get().min(workers.len());
        for copies in 1..=wanted {
            // Those of the next copy are fewer: a pair is used once.
            pairs.retain(|(_, region, name)| {
                let (Some(holders), Some(space)) = (by_region.get_mut(region), space.get_mut(name)) else {
                    return false;
                };
                if holders.len() >= copies || *space == 0 {
                    return *space > 0;
                }
                holders.push((*name).clone());
                *space -= 1;
                false
            });
        }
        let missing = by_region.values().map(|holders| wanted - holders.len()).sum();
        Self { by_region, missing }
    }

    /// The workers that should hold this region.
    pub(crate) fn holders(&self, region: &ObjectId) -> &[String] {
        self.by_region.get(region).map_or(&[], Vec::as_slice)
    }

    /// Whether this worker should hold the region.
    pub(crate) fn is_holder(&self, region: &ObjectId, name: &str) -> bool {
        self.holders(region).iter().any(|holder| holder == name)
    }
}

/// A number for a worker, from its name.
fn key_of(name: &str) -> u64 {
    first_eight(&ObjectId::of(name.as_bytes()))
}

/// The ids of objects are hashes already, so mixing their beginning with that of the worker is enough.
fn weight(region: &ObjectId, worker: u64) -> u64 {
    mix(mix(first_eight(region)) ^ worker)
}

fn first_eight(id: &ObjectId) -> u64 {
    let [a, b, c, d, e, f, g, h, ..] = *id.as_bytes();
    u64::from_be_bytes([a, b, c, d, e, f, g, h])
}

/// The finalizer of SplitMix64 (Steele, Lea and Flood, 2014).
const fn mix(mut x: u64) -> u64 {
    x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    fn regions(count: u32) -> Vec<ObjectId> {
        (0..count).map(|region| ObjectId::of(&region.to_be_bytes())).collect()
    }

    fn workers(numbers: impl IntoIterator<Item = u32>, most: u32) -> BTreeMap<String, Option<NonZeroU32>> {
        numbers.into_iter().map(|number| (format!("worker-{number}"), NonZeroU32::new(most))).collect()
    }

    fn replicas(count: usize) -> NonZeroUsize {
        NonZeroUsize::new(count).expect("not zero")
    }

    fn place(count: u32, workers: &BTreeMap<String, Option<NonZeroU32>>, copies: usize) -> Placement {
        Placement::of(regions(count), workers, replicas(copies))
    }

    /// Pairs of region and worker.
    fn pairs(placement: &Placement) -> BTreeSet<(ObjectId, String)> {
        let of = |(region, holders): (&ObjectId, &Vec<String>)| {
            holders.iter().map(|holder| (*region, holder.clone())).collect::<Vec<_>>()
        };
        placement.by_region.iter().flat_map(of).collect()
    }

    #[test]
    fn every_region_has_its_copies_on_different_workers() {
        for (count, copies) in [(1, 1), (3, 2), (5, 3), (2, 3)] {
            let placement = place(200, &workers(0..count, 0), copies);
            assert_eq!(placement.missing, 0);
            for region in regions(200) {
                let holders: BTreeSet<_> = placement.holders(&region).iter().collect();
                assert_eq!(holders.len(), copies.min(count as usize));
            }
        }
    }

    #[test]
    fn shares_are_even() {
        let placement = place(2000, &workers(0..8, 0), 2);
        for name in workers(0..8, 0).keys() {
            let held = regions(2000).iter().filter(|region| placement.is_holder(region, name)).count();
            // 500 each; the standard deviation is 20.
            assert!((420..=580).contains(&held), "{name} holds {held}");
        }
    }

    #[test]
    fn joining_and_leaving_move_only_what_they_must() {
        for copies in [1, 2, 3] {
            let (seven, eight) =
                (place(500, &workers(0..7, 0), copies), place(500, &workers(0..8, 0), copies));
            let (before, after) = (pairs(&seven), pairs(&eight));
            assert!(after.difference(&before).all(|(_, holder)| holder == "worker-7"));
            assert!(before.difference(&after).count() == after.difference(&before).count());
            // The other direction: the copies of the one that leaves, and no others.
            assert!(before.difference(&after).all(|(region, _)| eight.is_holder(region, "worker-7")));
        }
    }

    #[test]
    fn limits_hold_and_first_copies_come_first() {
        // 3 workers with 40 regions each, 100 regions, two copies: one each, and 20 second ones.
        let placement = place(100, &workers(0..3, 40), 2);
        assert_eq!(placement.missing, 80);
        let held = pairs(&placement);
        for name in workers(0..3, 40).keys() {
            assert_eq!(held.iter().filter(|(_, holder)| holder == name).count(), 40);
        }
        assert!(regions(100).iter().all(|region| !placement.holders(region).is_empty()));
        // Without space for one of each.
        let placement = place(100, &workers(0..1, 40), 2);
        assert_eq!((placement.missing, pairs(&placement).len()), (60, 40));
        assert_eq!(place(100, &BTreeMap::new(), 2).missing, 0, "no worker is wanted where there is none");
    }

    #[test]
    fn limits_that_are_not_reached_change_nothing() {
        assert_eq!(place(300, &workers(0..5, 300), 2), place(300, &workers(0..5, 0), 2));
    }

    /// With limits, a worker that joins takes over from full ones; others move little beside it.
    #[test]
    fn joining_a_cluster_at_its_limits_moves_little_more() {
        let (before, after) =
            (pairs(&place(400, &workers(0..7, 120), 2)), pairs(&place(400, &workers(0..8, 120), 2)));
        let loaded = after.difference(&before).count();
        let by_new = after.iter().filter(|(_, holder)| holder == "worker-7").count();
        assert!(by_new >= 80 && loaded <= by_new * 5 / 4, "{loaded} loads, {by_new} of the new one");
    }
}
