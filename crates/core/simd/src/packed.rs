//! Database rows in the memory layout of the kernels.

use crate::{
    Backend,
    backend::Kind,
    tile::{LANES, Lanes, STEP, TILE_PANELS},
};

/// Maximum row length: squared distances stay below [`PADDING`].
pub const MAX_DIM: usize = 16_384;

/// Distance offset of padding rows in a panel: no true distance is as large.
pub(crate) const PADDING: i32 = 1 << 30;

/// Rows of bytes `[N, dim]`, rearranged so that one vector register contains the same four components of 16 rows.
///
/// ```text
/// panels[panel][step][lane][4] = rows[16 panel + lane][4 step .. 4 step + 4]
/// ```
///
/// A dot product then needs no sum across a register. `dim` is padded with zero components to a multiple of 4 and the
/// number of panels to a multiple of the tile. Packing costs about as much as searching for 70 queries (`packing` in
/// `benches/matching.rs`).
#[derive(Clone)]
pub struct PackedRows {
    backend: Backend,
    dim: usize,
    len: usize,
    panels: Vec<u8>,
    offsets: Vec<Lanes>,
}

impl std::fmt::Debug for PackedRows {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "PackedRows({}, {} x {})", self.backend.name(), self.len, self.dim)
    }
}

impl PackedRows {
    /// Packs consecutive rows `[N, dim]`; bytes after the last whole row are ignored.
    ///
    /// # Panics
    /// When `dim` is 0 or more than [`MAX_DIM`].
    pub fn new(backend: Backend, rows: &[u8], dim: usize) -> Self {
        assert!((1..=MAX_DIM).contains(&dim), "rows of {dim} bytes, supported are 1 to {MAX_DIM}");
        let len = rows.len() / dim;
        let panel_count = len.div_ceil(LANES).next_multiple_of(TILE_PANELS);
        let panel_bytes = panel_bytes(dim);
        let mut panels = vec![0; panel_count * panel_bytes];
        let mut offsets = vec![Lanes([PADDING; LANES]); panel_count];
        for (index, row) in rows.chunks_exact(dim).enumerate() {
            let (panel, lane) = (index / LANES, index % LANES);
            let panel_rows = &mut panels[panel * panel_bytes..][..panel_bytes];
            let (whole, tail) = row.as_chunks::<STEP>();
            let (slots, _) = panel_rows.as_chunks_mut::<STEP>();
            let mut slots = slots.iter_mut().skip(lane).step_by(LANES);
            for (components, slot) in whole.iter().zip(slots.by_ref()) {
                *slot = *components;
            }
            if let (false, Some(slot)) = (tail.is_empty(), slots.next()) {
                slot[..tail.len()].copy_from_slice(tail);
            }
            offsets[panel].0[lane] = offset(backend, row);
        }
        Self { backend, dim, len, panels, offsets }
    }

    /// The instruction set that the rows are packed for.
    pub const fn backend(&self) -> Backend {
        self.backend
    }

    /// Number of rows.
    pub const fn len(&self) -> usize {
        self.len
    }

    /// True when there are no rows.
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Bytes of one row.
    pub const fn dim(&self) -> usize {
        self.dim
    }

    /// Bytes of one panel: 16 rows of padded length.
    pub(crate) const fn panel_bytes(&self) -> usize {
        panel_bytes(self.dim)
    }

    /// All panels, one after another.
    pub(crate) fn panels(&self) -> &[u8] {
        &self.panels
    }

    /// Per panel and lane, the number that is added to a squared distance: see [`offset`].
    pub(crate) fn offsets(&self) -> &[Lanes] {
        &self.offsets
    }
}

const fn panel_bytes(dim: usize) -> usize {
    dim.next_multiple_of(STEP) * LANES
}

/// `o` in `|q - b|^2 = |q|^2 + o - 2 dot`.
///
/// With the plain dot product it is `|b|^2`. The VNNI instruction multiplies unsigned by signed bytes, so there the
/// query is stored as `q - 128`, and `b q = b (q - 128) + 128 b` moves `-256 sum(b)` into the offset.
fn offset(backend: Backend, row: &[u8]) -> i32 {
    let norm: i32 = row.iter().map(|&b| i32::from(b) * i32::from(b)).sum();
    match backend.kind() {
        Kind::Portable => norm,
        #[cfg(target_arch = "x86_64")]
        Kind::Avx2 => norm,
        #[cfg(target_arch = "x86_64")]
        Kind::Avx512Vnni => norm - 256 * row.iter().map(|&b| i32::from(b)).sum::<i32>(),
    }
}
