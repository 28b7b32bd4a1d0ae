//! Groups of images that share few points with the rest of a map, compared with how many they share among themselves.
//!
//! Images in another coordinate frame see the same surfaces as the rest, but no point is consistent with both frames. So they are
//! linked with each other and hardly with the rest. A group of another place is linked in the same way: only localization
//! distinguishes both.

use std::collections::HashMap;

use veiloc_map::MapModel;

use super::consensus::median;

/// A group of images, and its connection with the others.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LinkedGroup {
    /// Ascending; at most half of the connected images.
    pub(crate) images: Vec<usize>,
    /// The strongest link to an image outside over the median link inside: 0 for separate groups, about 1 for a part of
    /// an even map.
    pub(crate) ratio: f64,
}

/// Returns the groups of at least `min_images` images with a ratio below `max_ratio`, the most separate first. A group
/// and its own parts may both be returned.
///
/// The link of two images is the number of points that both observe over the smaller number that one of them observes.
/// Images are joined along the strongest links (a maximum spanning tree): each join of two groups names the smaller one.
pub(crate) fn weakly_linked(model: &MapModel, min_images: usize, max_ratio: f64) -> Vec<LinkedGroup> {
    let count = model.images.len();
    let mut observed = vec![0_u32; count];
    let mut shared: HashMap<(u32, u32), u32> = HashMap::new();
    for point in &model.points {
        // A track is ascending, and may contain two keypoints of one image.
        let mut images: Vec<u32> = point.track.iter().map(|o| o.image).collect();
        images.dedup();
        for (k, a) in images.iter().enumerate() {
            observed[*a as usize] += 1;
            for b in &images[k + 1..] {
                *shared.entry((*a, *b)).or_default() += 1;
            }
        }
    }
    let mut links: Vec<(f64, u32, u32)> = shared
        .into_iter()
        .map(|((a, b), both)| {
            let fewer = observed[a as usize].min(observed[b as usize]);
            (f64::from(both) / f64::from(fewer.max(1)), a, b)
        })
        .collect();
    links.sort_by(|x, y| y.0.total_cmp(&x.0).then((x.1, x.2).cmp(&(y.1, y.2))));

    // Each group: its images, and the links that joined them.
    let mut groups: Vec<(Vec<usize>, Vec<f64>)> = (0..count).map(|i| (vec![i], Vec::new())).collect();
    let mut group_of: Vec<usize> = (0..count).collect();
    let mut found = Vec::new();
    let mut note = |(images, links): &(Vec<usize>, Vec<f64>), link: f64| {
        let inside = median(links.clone());
        if images.len() >= min_images && link < max_ratio * inside {
            let mut images = images.clone();
            images.sort_unstable();
            found.push(LinkedGroup { images, ratio: link / inside });
        }
    };
    for (link, a, b) in links {
        let (a, b) = (group_of[a as usize], group_of[b as usize]);
        if a == b {
            continue;
        }
        let (large, small) = if groups[a].0.len() >= groups[b].0.len() { (a, b) } else { (b, a) };
        note(&groups[small], link);
        let (images, inside) = std::mem::take(&mut groups[small]);
        for image in &images {
            group_of[*image] = large;
        }
        groups[large].0.extend(images);
        groups[large].1.extend(inside);
        groups[large].1.push(link);
    }
    // The remaining groups have no link with each other.
    let largest = (0..count).max_by_key(|g| (groups[*g].0.len(), std::cmp::Reverse(*g)));
    (0..count).filter(|g| Some(*g) != largest).for_each(|g| note(&groups[g], 0.0));
    found.sort_by(|x, y| x.ratio.total_cmp(&y.ratio).then_with(|| x.images.cmp(&y.images)));
    found
}
