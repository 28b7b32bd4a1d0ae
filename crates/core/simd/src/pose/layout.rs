//! Memory layout of correspondences: blocks of sixteen, one array per quantity.

use crate::approx::{atan2, from_nearest_integer};

/// Correspondences in a block.
pub const LANES: usize = 16;

/// One quantity of a block.
pub type Lanes = [f32; LANES];

/// Score offset of unused lanes: they never count.
pub const UNUSED_LANE_OFFSET: f32 = -1e30;

/// Maximum plausible depth: avoids infinities in sums.
pub(super) const MAX_DEPTH: f32 = 1e18;

/// Sixteen correspondences.
#[derive(Debug, Clone)]
#[repr(align(64))]
pub struct Block {
    /// The points, relative to any origin shared with the poses.
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
    /// The part of the score that does not depend on the pose; [`UNUSED_LANE_OFFSET`] for unused lanes.
    pub score_offset: Lanes,
}

impl Block {
    /// All lanes unused.
    pub const EMPTY: Self = Self {
        x: [0.0; LANES],
        y: [0.0; LANES],
        z: [0.0; LANES],
        a: [0.0; LANES],
        b: [0.0; LANES],
        c: [0.0; LANES],
        score_offset: [UNUSED_LANE_OFFSET; LANES],
    };
}

/// Correspondences that share an anchor, or all of them.
#[derive(Debug, Clone)]
pub struct Group {
    pub(super) blocks: Vec<Block>,
    /// Maximum score of the blocks from here on, `[blocks + 1]`.
    pub(super) most: Vec<f32>,
    pub(super) anchor: [f32; 3],
    pub(super) index: f32,
}

impl Group {
    /// A group with its anchor, `(x, y, w)` with distances `‖w (u, v) − (x, y)‖`, and the index of its pencil. Both are
    /// used for anchored correspondences only.
    ///
    /// `extra` is the maximum of a likelihood minus `score_offset`: the largest possible `log r` for anchored
    /// correspondences, 0 for others. Poor poses are dropped soonest when the blocks are sorted by falling
    /// `score_offset`.
    pub fn new(blocks: Vec<Block>, anchor: [f32; 3], index: usize, extra: f32) -> Self {
        let mut most = vec![0.0_f32; blocks.len() + 1];
        for (k, block) in blocks.iter().enumerate().rev() {
            most[k] = most[k + 1] + block.score_offset.iter().map(|w| (w + extra).max(0.0)).sum::<f32>();
        }
        Self { blocks, most, anchor, index: index as f32 }
    }
}

/// The type of the observations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ObservationType {
    /// Pixels.
    Points,
    /// Lines.
    Lines,
    /// Lines through the anchor of their group.
    Anchored,
}

/// The image that contains the projections, pixels from the principal point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Image {
    /// Its middle.
    pub middle: [f32; 2],
    /// Half its size.
    pub half: [f32; 2],
    /// Maximum distance of a projection outside it.
    pub margin: f32,
}

impl Image {
    #[inline(always)]
    pub(super) fn holds(&self, u: f32, v: f32) -> bool {
        ((u - self.middle[0]).abs() <= self.half[0] + self.margin)
            & ((v - self.middle[1]).abs() <= self.half[1] + self.margin)
    }
}

/// A family of sectors about an axis; functionals act on `(u, v, 1)`, pixels from the principal point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sectors {
    /// The cosine of the angle about the axis, times a positive factor.
    pub zero: [f32; 3],
    /// The sine, times the same factor.
    pub quarter: [f32; 3],
    /// Sectors per radian.
    pub per_radian: f32,
    /// Start of the first, in sectors.
    pub shift: f32,
    /// Maximum distance of a projection over its border, in sectors.
    pub margin: f32,
}

impl Sectors {
    /// Position of a projection, in sectors.
    #[inline(always)]
    pub(super) fn position(&self, u: f32, v: f32) -> f32 {
        let on = |f: &[f32; 3]| f[0] * u + f[1] * v + f[2];
        atan2(on(&self.quarter), on(&self.zero)) * self.per_radian + self.shift
    }
}

/// The pencil of a projection: `⌊own⌋ + ⌊across⌋` modulo their number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Partition {
    /// Number of pencils.
    pub pencils: f32,
    /// The sectors.
    pub own: Sectors,
    /// The second family.
    pub across: Option<Sectors>,
}

impl Partition {
    /// Whether a row of this pencil can be observed there.
    #[inline(always)]
    pub(super) fn admits<const ACROSS: bool>(&self, index: f32, u: f32, v: f32) -> bool {
        let position = self.own.position(u, v) - index - 0.5;
        let reach = (0.5 + self.own.margin) / self.pencils;
        let within = |sector: f32| from_nearest_integer((position + sector) / self.pencils).abs() <= reach;
        match &self.across {
            Some(across) if ACROSS => {
                let (position, margin) = (across.position(u, v), across.margin);
                let floor = |x: f32| (x - 0.5) - from_nearest_integer(x - 0.5);
                within(floor(position + margin)) | within(floor(position - margin))
            }
            _ => within(0.0),
        }
    }
}

/// All correspondences of a problem, ready for scoring.
#[derive(Debug, Clone)]
pub struct PoseLanes {
    pub(super) observed: ObservationType,
    pub(super) groups: Vec<Group>,
    pub(super) image: Image,
    pub(super) partition: Option<Partition>,
}

impl PoseLanes {
    /// Correspondences of one kind in their groups. Anchored ones need a partition.
    pub fn new(
        observed: ObservationType,
        groups: Vec<Group>,
        image: Image,
        partition: Option<Partition>,
    ) -> Self {
        Self { observed, groups, image, partition }
    }

    /// The partition of anchored correspondences, and whether it has a second family of sectors.
    pub(super) fn crossed(&self) -> bool {
        self.partition.is_some_and(|p| p.across.is_some())
    }
}
