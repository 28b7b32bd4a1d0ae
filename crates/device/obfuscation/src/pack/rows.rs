//! The rows of an image that a place explains, and what is sent of them.

use std::collections::BTreeMap;

use rand::Rng;
use veiloc_descriptor::{Descriptors, GlobalDescriptor};
use veiloc_features::Features;
use veiloc_protocol::{Candidate, RowMatches, SentContent, SizeClass};

use super::find::{ExplainedRow, FoundRows, MIN_MATCHES};
use super::{KnownPlace, PackUse};
use crate::SealError;
use crate::seal::SelectedKeypoint;

/// The rows that are left of an image.
pub(crate) struct PlaceRows<'a> {
    place: &'a KnownPlace,
    found: FoundRows,
    count: usize,
    /// By feature, where matches are sent instead of descriptors.
    candidates: Option<BTreeMap<usize, Candidate>>,
}

impl<'a> PlaceRows<'a> {
    /// Removes from `usable` what the place does not explain; what is left is in the order in which it is sent when not
    /// all can be.
    pub(crate) fn select(
        place: &'a KnownPlace,
        usage: PackUse,
        features: &Features,
        usable: &mut Vec<SelectedKeypoint>,
    ) -> Result<Self, SealError> {
        let descriptors = features.descriptors.select(usable.iter().map(|selected| selected.source));
        let found = place.find(&descriptors)?;
        let extracted = usable.len();
        let candidates = match usage {
            PackUse::Explained => {
                let mut explained = found.rows.iter().map(ExplainedRow::is_explained);
                usable.retain(|_| explained.next().expect("one for each"));
                if size_of(usable.len()).rows() > usable.len() {
                    // Decoys fill the class. They have a position each, so rows that share one would be known as real.
                    merge_by_position(usable, |_, _| ());
                }
                None
            }
            PackUse::Matches => {
                let of_sources = usable.iter().map(|selected| selected.source).zip(&found.rows);
                let mut candidates: BTreeMap<usize, Candidate> = of_sources
                    .filter(|(_, row)| row.is_explained())
                    .filter_map(|(source, row)| Some((source, row.candidate?)))
                    .collect();
                usable.retain(|selected| candidates.contains_key(&selected.source));
                // Of the features at one position the most probable match is sent.
                merge_by_position(usable, |kept, merged| {
                    if candidates[&merged].weight > candidates[&kept].weight {
                        candidates.insert(kept, candidates[&merged]);
                    }
                });
                usable.sort_by_key(|selected| std::cmp::Reverse(candidates[&selected.source].weight));
                Some(candidates)
            }
        };
        let count = usable.len();
        if count < MIN_MATCHES {
            return Err(SealError::NotThisPlace { matching: count, extracted });
        }
        Ok(Self { place, found, count, candidates })
    }

    /// How many rows are sent.
    pub(crate) fn size(&self) -> SizeClass {
        size_of(self.count)
    }

    /// What is sent of these rows and of `decoys` after them.
    pub(crate) fn content<R: Rng + ?Sized>(
        self,
        features: &Features,
        usable: &[SelectedKeypoint],
        decoys: usize,
        rng: &mut R,
    ) -> RowContent {
        let Some(candidates) = self.candidates else {
            let mut rows = features.descriptors.select(usable.iter().map(|selected| selected.source));
            let invented = self.place.decoy_rows(&self.found.images, decoys, rng);
            (0..invented.len()).for_each(|row| rows.push(invented.row(row)).expect("of one kind"));
            return RowContent::Descriptors(rows);
        };
        let mut of_rows: Vec<Candidate> =
            usable.iter().map(|selected| candidates[&selected.source]).collect();
        of_rows.extend(self.place.decoy_candidates(&self.found, decoys, rng));
        RowContent::Matches { place: self.place.clone(), candidates: of_rows }
    }
}

/// The class of this many real rows: decoys fill a class of which at least two thirds are real.
fn size_of(count: usize) -> SizeClass {
    let is_filled = |class: &SizeClass| class.rows() >= count && 3 * count >= 2 * class.rows();
    SizeClass::ALL.into_iter().find(is_filled).unwrap_or_else(|| SizeClass::for_count(count))
}

/// Keeps the first keypoint of each position; `merge` gets its source and that of each other one there.
fn merge_by_position(usable: &mut Vec<SelectedKeypoint>, mut merge: impl FnMut(usize, usize)) {
    let mut first: BTreeMap<[u64; 2], usize> = BTreeMap::new();
    usable.retain(|selected| {
        let pixel = selected.pixel;
        let known = *first.entry([pixel.u.to_bits(), pixel.v.to_bits()]).or_insert(selected.source);
        if known != selected.source {
            merge(known, selected.source);
        }
        known == selected.source
    });
}

/// What the rows of a query show, before they are shuffled.
pub(crate) enum RowContent {
    Descriptors(Descriptors),
    Matches { place: KnownPlace, candidates: Vec<Candidate> },
}

impl RowContent {
    /// Whether descriptors are sent.
    pub(crate) const fn is_described(&self) -> bool {
        matches!(self, Self::Descriptors(_))
    }

    /// In the order in which it is sent.
    pub(crate) fn in_order(
        self,
        order: &[usize],
        image_global: Option<GlobalDescriptor>,
    ) -> Result<SentContent, SealError> {
        Ok(match self {
            Self::Descriptors(rows) => {
                SentContent::Described { descriptors: rows.select(order.iter().copied()), image_global }
            }
            Self::Matches { place, candidates } => {
                let rows = order.iter().map(|row| candidates[*row]).collect();
                let matches = RowMatches::new(place.pack().point_count(), rows)?;
                SentContent::Matched { pack: place.pack().id(), matches }
            }
        })
    }
}
