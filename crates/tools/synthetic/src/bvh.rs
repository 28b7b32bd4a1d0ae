//! Parallelograms in space, and a bounding volume hierarchy (BVH) to find the first one on a ray.

use nalgebra::Vector3;

/// Single precision: a room is a few metres, and a micrometre suffices.
pub(crate) type Vec3 = Vector3<f32>;

/// A flat rectangle, `origin + a · edge_u + b · edge_v`, `0 ≤ a, b ≤ 1`.
#[derive(Clone, Copy)]
pub(crate) struct Quad {
    pub(crate) origin: Vec3,
    pub(crate) edge_u: Vec3,
    pub(crate) edge_v: Vec3,
    /// Unit normal, `edge_u × edge_v`, on the visible side.
    pub(crate) normal: Vec3,
    /// Lengths of the edges, metres.
    pub(crate) size: [f32; 2],
    /// The edges divided by their squared lengths: their dot products with a point of the plane are its position `(a,
    /// b)`.
    dual: [Vec3; 2],
}

impl Quad {
    pub(crate) fn new(origin: Vec3, edge_u: Vec3, edge_v: Vec3) -> Self {
        let normal = edge_u.cross(&edge_v).normalize();
        let dual = [edge_u / edge_u.norm_squared(), edge_v / edge_v.norm_squared()];
        Self { origin, edge_u, edge_v, normal, size: [edge_u.norm(), edge_v.norm()], dual }
    }

    pub(crate) fn at(&self, a: f32, b: f32) -> Vec3 {
        self.origin + self.edge_u * a + self.edge_v * b
    }

    /// Distance along the ray to the plane, in units of `direction`, and the position `(a, b)` there, which may lie
    /// outside the rectangle.
    pub(crate) fn intersect(&self, from: Vec3, direction: Vec3) -> (f32, f32, f32) {
        let t = self.normal.dot(&(self.origin - from)) / self.normal.dot(&direction);
        let p = from + direction * t - self.origin;
        (t, p.dot(&self.dual[0]), p.dot(&self.dual[1]))
    }
}

/// The first intersection of a ray with a surface.
#[derive(Clone, Copy)]
pub(crate) struct Hit {
    /// Index of the surface.
    pub(crate) quad: u32,
    /// Distance in units of the ray's direction.
    pub(crate) t: f32,
    /// Position on the surface, 0 to 1 each.
    pub(crate) a: f32,
    pub(crate) b: f32,
}

struct Node {
    low: Vec3,
    high: Vec3,
    /// A leaf contains `order[first..first + count]`; an inner node (`count` 0) has its children at `first` and `first
    /// + 1`.
    first: u32,
    count: u32,
}

/// Bounding volume hierarchy.
pub(crate) struct Bvh {
    nodes: Vec<Node>,
    order: Vec<u32>,
}

impl Bvh {
    pub(crate) fn new(quads: &[Quad]) -> Self {
        let mut tree = Self {
            nodes: vec![Node { low: Vec3::zeros(), high: Vec3::zeros(), first: 0, count: 0 }],
            order: (0..quads.len() as u32).collect(),
        };
        tree.split(quads, 0, 0, quads.len());
        tree
    }

    fn split(&mut self, quads: &[Quad], node: usize, begin: usize, end: usize) {
        let corners = |q: &Quad| [q.at(0.0, 0.0), q.at(1.0, 0.0), q.at(0.0, 1.0), q.at(1.0, 1.0)];
        let (mut low, mut high) = (Vec3::repeat(f32::INFINITY), Vec3::repeat(f32::NEG_INFINITY));
        for &q in &self.order[begin..end] {
            for c in corners(&quads[q as usize]) {
                low = low.inf(&c);
                high = high.sup(&c);
            }
        }
        // A flat box needs a nonzero thickness.
        (self.nodes[node].low, self.nodes[node].high) = (low.add_scalar(-1e-5), high.add_scalar(1e-5));
        if end - begin <= 3 {
            (self.nodes[node].first, self.nodes[node].count) = (begin as u32, (end - begin) as u32);
            return;
        }
        let axis = self.cheapest_axis(quads, begin, end);
        let key = |q: &u32| quads[*q as usize].at(0.5, 0.5)[axis.0];
        self.order[begin..end].sort_by(|a, b| key(a).total_cmp(&key(b)).then(a.cmp(b)));
        let middle = begin + axis.1;
        let child = self.nodes.len();
        for _ in 0..2 {
            self.nodes.push(Node { low, high, first: 0, count: 0 });
        }
        self.nodes[node].first = child as u32;
        self.split(quads, child, begin, middle);
        self.split(quads, child + 1, middle, end);
    }

    /// Axis and number of surfaces on the left with the lowest cost of visiting the two boxes (surface area heuristic).
    fn cheapest_axis(&self, quads: &[Quad], begin: usize, end: usize) -> (usize, usize) {
        let mut best = (f32::INFINITY, 0, (end - begin) / 2);
        for axis in 0..3 {
            let mut sorted: Vec<&Quad> = self.order[begin..end].iter().map(|&q| &quads[q as usize]).collect();
            sorted.sort_by(|a, b| a.at(0.5, 0.5)[axis].total_cmp(&b.at(0.5, 0.5)[axis]));
            let areas = |list: &mut dyn Iterator<Item = &&Quad>| -> Vec<f32> {
                let (mut low, mut high) = (Vec3::repeat(f32::INFINITY), Vec3::repeat(f32::NEG_INFINITY));
                list.map(|q| {
                    for (a, b) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
                        low = low.inf(&q.at(a, b));
                        high = high.sup(&q.at(a, b));
                    }
                    let d = high - low;
                    d.x * d.y + d.y * d.z + d.z * d.x
                })
                .collect()
            };
            let left = areas(&mut sorted.iter());
            let right = areas(&mut sorted.iter().rev());
            for k in 1..sorted.len() {
                let cost = left[k - 1] * k as f32 + right[sorted.len() - k - 1] * (sorted.len() - k) as f32;
                if cost < best.0 {
                    best = (cost, axis, k);
                }
            }
        }
        (best.1, best.2)
    }

    /// Returns the first surface on the ray before `farthest`. `hint`: a likely surface, tested first.
    pub(crate) fn first_hit(
        &self,
        quads: &[Quad],
        from: Vec3,
        direction: Vec3,
        farthest: f32,
        hint: u32,
    ) -> Option<Hit> {
        let inverse = direction.map(|d| 1.0 / d);
        let mut best = Hit { quad: u32::MAX, t: farthest, a: 0.0, b: 0.0 };
        let consider = |q: u32, best: &mut Hit| {
            let (t, a, b) = quads[q as usize].intersect(from, direction);
            if t > 1e-4 && t < best.t && (0.0..=1.0).contains(&a) && (0.0..=1.0).contains(&b) {
                *best = Hit { quad: q, t, a, b };
            }
        };
        if (hint as usize) < quads.len() {
            consider(hint, &mut best);
        }
        // A node and the entry parameter of the ray. 64 levels are far more than the tree of a room has.
        let mut stack = [(0u32, 0.0f32); 64];
        let mut depth = usize::from(entry(&self.nodes[0], from, inverse, best.t).is_some());
        while depth > 0 {
            depth -= 1;
            let (at, enters) = stack[depth];
            if enters > best.t {
                continue;
            }
            let node = &self.nodes[at as usize];
            if node.count > 0 {
                for &q in &self.order[node.first as usize..(node.first + node.count) as usize] {
                    consider(q, &mut best);
                }
                continue;
            }
            let way = |n: u32| entry(&self.nodes[n as usize], from, inverse, best.t).map(|t| (n, t));
            let order = match (way(node.first), way(node.first + 1)) {
                (Some(a), Some(b)) if a.1 <= b.1 => [Some(b), Some(a)],
                both => [both.0, both.1],
            };
            for next in order.into_iter().flatten().take(64 - depth) {
                stack[depth] = next;
                depth += 1;
            }
        }
        (best.quad != u32::MAX).then_some(best)
    }
}

/// Returns the entry parameter of the ray into the box of a node, if it is before `farthest`.
fn entry(node: &Node, from: Vec3, inverse: Vec3, farthest: f32) -> Option<f32> {
    let a = (node.low - from).component_mul(&inverse);
    let b = (node.high - from).component_mul(&inverse);
    let near = a.x.min(b.x).max(a.y.min(b.y)).max(a.z.min(b.z)).max(0.0);
    let far = a.x.max(b.x).min(a.y.max(b.y)).min(a.z.max(b.z)).min(farthest);
    (near <= far).then_some(near)
}
