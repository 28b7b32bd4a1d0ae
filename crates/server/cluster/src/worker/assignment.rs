//! What a worker should hold: a fixed share of the regions, or what is placed on it.

use std::collections::{BTreeMap, BTreeSet};
use std::num::{NonZeroU32, NonZeroUsize};
use std::time::Duration;

use veiloc_map::regions::{Manifest, ObjectId, ObjectRef};

use super::WorkerOptions;
use crate::announcement::MemberId;
use crate::members::{Members, PlacedMember};
use crate::placement::{Placed, Placement};
use crate::share::RegionShare;

/// Options of a worker on which regions are placed.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct PlacementOptions {
    /// What the others must know.
    pub placed: Placed,
    /// How long the regions of a worker that left or died stay assigned to it, because it may come back, as long as
    /// another worker has each of them. Default 30 s.
    pub settle: Duration,
}

impl PlacementOptions {
    /// Default options for this name: no limit.
    pub const fn new(name: String, replicas: NonZeroU32) -> Self {
        let placed = Placed { name, replicas, max_regions: None };
        Self { placed, settle: Duration::from_secs(30) }
    }
}

/// An object to hold, and its number if it is a region.
pub(super) type Assigned = (ObjectRef, Option<usize>);

/// Decides what this worker should hold.
pub(super) struct Assigner {
    share: RegionShare,
    index: bool,
    placement: Option<PlacementOptions>,
    member: MemberId,
    members: Members,
}

/// What a worker should hold of a manifest.
pub(super) struct Assignment {
    pub(super) objects: Vec<Assigned>,
    /// Regions that are placed on other workers which all have them.
    pub(super) taken_over: BTreeSet<ObjectId>,
    /// Copies of regions for which no worker has space.
    pub(super) unplaced: usize,
}

impl Assignment {
    pub(super) fn contains(&self, id: &ObjectId) -> bool {
        self.objects.iter().any(|(object, _)| object.sha256 == *id)
    }
}

impl Assigner {
    pub(super) fn new(options: &WorkerOptions, member: MemberId, members: Members) -> Self {
        let (share, index) = (options.share.clone(), options.index);
        Self { share, index, placement: options.placement.clone(), member, members }
    }

    /// What this worker should hold now.
    pub(super) fn assign(&self, manifest: &Manifest) -> Assignment {
        let index = self.index.then_some((manifest.index, None)).into_iter();
        let regions =
            manifest.regions.iter().enumerate().map(|(number, region)| (region.object(), Some(number)));
        let Some(placement) = &self.placement else {
            let regions =
                regions.filter(|(_, number)| number.is_none_or(|number| self.share.contains(number)));
            return Assignment {
                objects: index.chain(regions).collect(),
                taken_over: BTreeSet::new(),
                unplaced: 0,
            };
        };
        let own = &placement.placed;
        let others = self.members.placed(placement.settle);
        let others: Vec<PlacedMember> =
            others.into_iter().filter(|other| other.id != Some(self.member)).collect();
        let ids = || manifest.regions.iter().map(|region| region.sha256);
        let replicas = others.iter().map(|other| other.placed.replicas).fold(own.replicas, NonZeroU32::max);
        let replicas = NonZeroUsize::try_from(replicas).unwrap_or(NonZeroUsize::MAX);
        let place = |with_departed: bool| {
            let known = others.iter().filter(|other| with_departed || !other.is_departed);
            let mut workers: BTreeMap<String, Option<NonZeroU32>> =
                known.map(|other| (other.placed.name.clone(), other.placed.max_regions)).collect();
            workers.insert(own.name.clone(), own.max_regions);
            Placement::of(ids(), &workers, replicas)
        };
        // With the workers that may come back, and without them.
        let (settled, present) = (place(true), place(false));
        let serves = |name: &str, region: &ObjectId| {
            others.iter().any(|other| other.placed.name == name && other.served.contains(region))
        };
        let mut space = own.max_regions.map_or(usize::MAX, |most| most.get() as usize);
        let mut take = |is_mine: bool| {
            let taken = is_mine && space > 0;
            space -= usize::from(taken);
            taken
        };
        let mut mine: BTreeSet<ObjectId> =
            ids().filter(|region| take(settled.is_holder(region, &own.name))).collect();
        // Regions that no other worker has do not wait for one that may come back.
        let is_urgent = |region: &ObjectId| {
            present.is_holder(region, &own.name) && !others.iter().any(|other| other.served.contains(region))
        };
        let urgent: Vec<ObjectId> =
            ids().filter(|region| !mine.contains(region) && take(is_urgent(region))).collect();
        mine.extend(urgent);
        let is_taken_over = |region: &ObjectId| {
            let holders = present.holders(region);
            !holders.is_empty() && holders.iter().all(|holder| *holder != own.name && serves(holder, region))
        };
        Assignment {
            taken_over: ids().filter(|region| !mine.contains(region) && is_taken_over(region)).collect(),
            objects: index.chain(regions.filter(|(object, _)| mine.contains(&object.sha256))).collect(),
            unplaced: present.missing,
        }
    }
}
