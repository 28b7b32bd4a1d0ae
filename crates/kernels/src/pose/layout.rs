//! How correspondences lie in memory: blocks of sixteen, one array a quantity.

/// Correspondences in a block.
pub const LANES: usize = 16;

/// One quantity of a block.
pub type Lanes = [f32; LANES];

/// What a lane is worth that belongs to no correspondence: it never counts.
pub const NEVER: f32 = -1e30;

/// Depth beyond which a pose is no pose: keeps infinities out of sums.
pub(super) const FARTHEST: f32 = 1e18;

/// Sixteen correspondences.
#[derive(Debug, Clone)]
#[repr(align(64))]
pub struct Block {
    /// The points, relative to any origin that the poses share.
    pub x: Lanes,
    /// See `x`.
    pub y: Lanes,
    /// See `x`.
    pub z: Lanes,
    /// Line coefficients of unit normal, or a pixel in `a` and `b`; pixels from the principal point.
    pub a: Lanes,
    /// See `a`.
    pub b: Lanes,
    /// See `a`.
    pub c: Lanes,
    /// What does not depend on the pose; [`NEVER`] for lanes that are not used.
    pub worth: Lanes,
}

impl Block {
    /// No correspondence in any lane.
    pub const EMPTY: Self = Self {
        x: [0.0; LANES],
        y: [0.0; LANES],
        z: [0.0; LANES],
        a: [0.0; LANES],
        b: [0.0; LANES],
        c: [0.0; LANES],
        worth: [NEVER; LANES],
    };
}

/// Correspondences that share an anchor, or all of them.
#[derive(Debug, Clone)]
pub struct Group {
    pub(super) blocks: Vec<Block>,
    /// Most that the blocks from here on can bring to a score, `[blocks + 1]`.
    pub(super) most: Vec<f32>,
    pub(super) anchor: [f32; 2],
    pub(super) side: [f32; 3],
}

impl Group {
    /// A group with its anchor (pixels from the principal point) and side: points may project where
    /// `side · (u, v, 1)` is not below minus the margin. Both count for anchored correspondences only.
    ///
    /// `extra` is the most that a likelihood gains over `worth`: the largest possible `log r` for anchored
    /// correspondences, 0 for others. Poor poses are dropped soonest when the blocks begin with what is worth most.
    pub fn new(blocks: Vec<Block>, anchor: [f32; 2], side: [f32; 3], extra: f32) -> Self {
        let mut most = vec![0.0_f32; blocks.len() + 1];
        for (k, block) in blocks.iter().enumerate().rev() {
            most[k] = most[k + 1] + block.worth.iter().map(|w| (w + extra).max(0.0)).sum::<f32>();
        }
        Self { blocks, most, anchor, side }
    }
}

/// What the observations are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Observed {
    /// Pixels.
    Points,
    /// Lines.
    Lines,
    /// Lines through the anchor of their group.
    Anchored,
}

/// The image that projections must lie in, pixels from the principal point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Image {
    /// Its middle.
    pub middle: [f32; 2],
    /// Half its size.
    pub half: [f32; 2],
    /// How far outside it, or over the dividing line, a projection may lie.
    pub margin: f32,
}

impl Image {
    #[inline(always)]
    pub(super) fn holds(&self, u: f32, v: f32) -> bool {
        ((u - self.middle[0]).abs() <= self.half[0] + self.margin)
            & ((v - self.middle[1]).abs() <= self.half[1] + self.margin)
    }
}

/// All correspondences of a problem, ready to be scored.
#[derive(Debug, Clone)]
pub struct PoseLanes {
    pub(super) observed: Observed,
    pub(super) groups: Vec<Group>,
    pub(super) image: Image,
}

impl PoseLanes {
    /// Correspondences of one kind in their groups.
    pub fn new(observed: Observed, groups: Vec<Group>, image: Image) -> Self {
        Self { observed, groups, image }
    }
}
