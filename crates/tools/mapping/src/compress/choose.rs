//! Chooses the points of a compressed map: they cover all parts of all images within the byte budget.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BinaryHeap};

use veiloc_map::{MapModel, MapPoint, PointId};

/// Cells of an image along each side. Close points constrain a pose less than distant ones.
const CELLS: u32 = 4;

/// Chooses points until the byte budget is used, the most useful first; each keeps at most `descriptors` keypoints.
///
/// Greedy maximization of a submodular sum: an image cell with `n` points counts `log(1 + n)`; the gain of a point is
/// its increase over all images that observe it, weighted by the probability of seeing it again
/// ([`redetection_probability`]). Greedy selection reaches `1 − 1/e` of the optimum (Nemhauser, Wolsey and Fisher,
/// 1978). Gains only decrease, so an old gain is an upper bound, and most gains are never recomputed.
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
        redetection_probability(point.track.len()) * added / bytes_of(point) as f64
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
        // A smaller point may still fit.
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

/// Probability that another image sees a point with this many observing images: `(n − 1) / n`, the leave-one-out
/// estimate from `n` images.
fn redetection_probability(images: usize) -> f64 {
    images.saturating_sub(1) as f64 / images.max(1) as f64
}

/// A candidate for the next point; the greatest has the largest gain, and ties go to the first point.
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
/// Bytes of a keypoint with a point, without its descriptor.
const KEYPOINT_BYTES: u64 = 8;
