//! Tracks: sets of keypoints connected by matches, at most one per image.

/// A keypoint: image, index in the image.
pub(crate) type Node = (u32, u32);

/// Joins keypoints along edges, in their order, and skips every edge that would put two keypoints of one image into one
/// track: such a track contains two points, and the better edges decide how it is split.
///
/// Returns tracks of at least two keypoints, each ascending, in the order of their first keypoints.
pub(crate) fn build_tracks(edges: impl IntoIterator<Item = (Node, Node)>) -> Vec<Vec<Node>> {
    let edges: Vec<(Node, Node)> = edges.into_iter().collect();
    let mut nodes: Vec<Node> = edges.iter().flat_map(|(a, b)| [*a, *b]).collect();
    nodes.sort_unstable();
    nodes.dedup();
    let index = |node: Node| nodes.binary_search(&node).expect("every end of an edge is a node");
    let mut sets = DisjointSets::new(nodes.len());
    for (a, b) in edges {
        let (a, b) = (sets.find(index(a)), sets.find(index(b)));
        if a != b && !share_an_image(&sets.members[a], &sets.members[b], &nodes) {
            sets.join(a, b);
        }
    }
    let mut tracks: Vec<Vec<Node>> = sets
        .members
        .into_iter()
        .filter(|m| m.len() > 1)
        .map(|m| m.into_iter().map(|i| nodes[i as usize]).collect())
        .collect();
    tracks.sort_unstable();
    tracks
}

/// Members and nodes are sorted, so both are in the order of images.
fn share_an_image(a: &[u32], b: &[u32], nodes: &[Node]) -> bool {
    let (mut a, mut b) = (a.iter().peekable(), b.iter().peekable());
    while let (Some(x), Some(y)) = (a.peek(), b.peek()) {
        match nodes[**x as usize].0.cmp(&nodes[**y as usize].0) {
            std::cmp::Ordering::Equal => return true,
            std::cmp::Ordering::Less => a.next(),
            std::cmp::Ordering::Greater => b.next(),
        };
    }
    false
}

/// Union-find with the members of every set.
struct DisjointSets {
    parent: Vec<u32>,
    /// Sorted; empty for nodes that are no longer a root.
    members: Vec<Vec<u32>>,
}

impl DisjointSets {
    fn new(count: usize) -> Self {
        let all = 0..u32::try_from(count).expect("fewer keypoints than 32-bit numbers can count");
        Self { parent: all.clone().collect(), members: all.map(|i| vec![i]).collect() }
    }

    fn find(&mut self, mut node: usize) -> usize {
        while self.parent[node] as usize != node {
            let grandparent = self.parent[self.parent[node] as usize];
            self.parent[node] = grandparent;
            node = grandparent as usize;
        }
        node
    }

    /// Joins two roots; the smaller set is appended to the larger one.
    fn join(&mut self, a: usize, b: usize) {
        let (large, small) = if self.members[a].len() >= self.members[b].len() { (a, b) } else { (b, a) };
        let taken = std::mem::take(&mut self.members[small]);
        self.members[large].extend(taken);
        self.members[large].sort_unstable();
        self.parent[small] = large as u32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chains_become_tracks() {
        let tracks = build_tracks([((2, 0), (3, 7)), ((0, 5), (1, 5)), ((1, 5), (2, 0)), ((4, 1), (5, 1))]);
        assert_eq!(tracks, [vec![(0, 5), (1, 5), (2, 0), (3, 7)], vec![(4, 1), (5, 1)]]);
        assert!(build_tracks([]).is_empty());
    }

    #[test]
    fn first_edges_decide_conflicts() {
        // (0,0)-(1,0)-(2,0) and (0,1)-(1,1)-(2,1), with a wrong edge between them in last position.
        let good = [((0, 0), (1, 0)), ((1, 0), (2, 0)), ((0, 1), (1, 1)), ((1, 1), (2, 1))];
        let wrong = ((1, 0), (2, 1));
        let expected = [vec![(0, 0), (1, 0), (2, 0)], vec![(0, 1), (1, 1), (2, 1)]];
        assert_eq!(build_tracks(good.into_iter().chain([wrong])), expected);
        // In first position it joins the keypoints that fit, and the others form the rest.
        let tracks = build_tracks([wrong].into_iter().chain(good));
        assert_eq!(tracks, [vec![(0, 0), (1, 0), (2, 1)], vec![(0, 1), (1, 1)]]);
    }

    #[test]
    fn tracks_have_one_keypoint_per_image() {
        let tracks = build_tracks([((0, 0), (1, 0)), ((0, 1), (1, 0))]);
        assert_eq!(tracks, [vec![(0, 0), (1, 0)]]);
    }
}
