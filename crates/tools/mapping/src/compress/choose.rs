//! Which points a small map keeps: those that cover all parts of all images, by the bytes they take.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BinaryHeap};

use veiloc_map::{MapModel, MapPoint, PointId};

/// Parts of an image along each side. Points that lie together tell less of a pose than points far apart.
const CELLS: u32 = 4;

/// Chooses points until the bytes are spent, the most useful first; each will keep at most `descriptors` keypoints.
///
/// Greedy on a sum that saturates: a part of an image that has `n` points is worth `log(1 + n)`, a point what it adds over
/// all images that see it, weighed by how sure it is to be seen again ([`sureness`]). Greedy comes within `1 − 1/e` of the
/// best choice of a submodular sum (Nemhauser, Wolsey and Fisher, 1978). Gains only fall, so that a gain computed before is
/// a bound, and most are never computed again.
pub(super) fn choose(model: &MapModel, descriptors: usize, bytes: u64) -> Vec<PointId> {
    let cell_of = |image: u32, keypoint: u32| {
        let image_of = &model.images[image as usize];
        let camera = &model.cameras[image_of.camera];
        let along = |c: f32, size: u32| {
            let at = f64::from(c) / f64::from(size.max(1)) * f64::from(CELLS);
            (at.max(0.0) as u32).min(CELLS - 1)
        };
        let [u, v] = image_of.keypoints[keypoint as usize];
        image * CELLS * CELLS + along(v, camera.height) * CELLS + along(u, camera.width)
    };
    let row = model.profile.descriptor_kind().packed_len() as u64;
    let bytes_of =
        |point: &MapPoint| POINT_BYTES + (KEYPOINT_BYTES + row) * point.track.len().min(descriptors) as u64;
    let mut filled: BTreeMap<u32, u32> = BTreeMap::new();
    let gain = |point: &MapPoint, filled: &BTreeMap<u32, u32>| {
        let of_cell = |cell: u32| {
            let there = f64::from(filled.get(&cell).copied().unwrap_or(0));
            f64::ln((2.0 + there) / (1.0 + there))
        };
        let added: f64 = point.track.iter().map(|o| of_cell(cell_of(o.image, o.keypoint))).sum();
        sureness(point.track.len()) * added / bytes_of(point) as f64
    };
    let mut queue: BinaryHeap<Candidate> = (0_u32..)
        .zip(&model.points)
        .map(|(id, point)| Candidate { gain: gain(point, &filled), id: PointId(id) })
        .collect();
    let (mut chosen, mut left) = (Vec::new(), bytes);
    while let Some(best) = queue.pop() {
        let point = &model.points[best.id.index()];
        let now = Candidate { gain: gain(point, &filled), id: best.id };
        if queue.peek().is_some_and(|next| now < *next) {
            queue.push(now);
            continue;
        }
        // One that is too large may be followed by one that is not.
        let Some(rest) = left.checked_sub(bytes_of(point)) else { continue };
        left = rest;
        for o in &point.track {
            *filled.entry(cell_of(o.image, o.keypoint)).or_default() += 1;
        }
        chosen.push(best.id);
    }
    chosen.sort_unstable();
    chosen
}

/// How sure a point that so many images see is to be seen by another one: of `n` images that found it, one more is as
/// likely as `(n − 1) / n`, the share of them that one of them would have found foretold.
fn sureness(images: usize) -> f64 {
    images.saturating_sub(1) as f64 / images.max(1) as f64
}

/// A point that may be chosen next; the greatest is the one that adds most, of equals the first.
struct Candidate {
    gain: f64,
    id: PointId,
}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        self.gain.total_cmp(&other.gain).then(other.id.cmp(&self.id))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Candidate {}

/// Bytes of a point in the file (`docs/reference/map-format.md`, section 16).
const POINT_BYTES: u64 = 28;
/// Bytes of a keypoint that sees a point, its descriptor aside.
const KEYPOINT_BYTES: u64 = 8;
