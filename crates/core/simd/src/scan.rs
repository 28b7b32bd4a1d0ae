//! Exact nearest neighbours: every query and every packed row, in one pass.

use crate::{
    PackedRows,
    backend::Kind,
    packed::PADDING,
    tile::{LANES, Lanes, Portable, STEP, TILE_PANELS, TILE_QUERIES, Tile, TileDots},
};

/// The nearest row of one query, and the distance of the second nearest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BestTwo {
    /// The nearest row; of several equally near, the one with the lowest index.
    pub index: u32,
    /// Its squared Euclidean distance.
    pub distance: u32,
    /// Squared distance of the nearest of the other rows; `None` when there is no other.
    pub second: Option<u32>,
}

/// For each packed row, the nearest query seen so far.
#[derive(Debug, Clone)]
pub struct ColumnBest {
    len: usize,
    distances: Vec<Lanes>,
    queries: Vec<Lanes>,
}

impl ColumnBest {
    /// Before any query.
    pub fn new(rows: &PackedRows) -> Self {
        let panels = rows.offsets().len();
        Self {
            len: rows.len(),
            distances: vec![Lanes([i32::MAX; LANES]); panels],
            queries: vec![Lanes([i32::MAX; LANES]); panels],
        }
    }

    /// The query nearest to `row`, and its squared distance; of several equally near, the one with the lowest index.
    /// `None` before any query, or without such a row.
    pub fn nearest(&self, row: usize) -> Option<(u32, u32)> {
        if row >= self.len {
            return None;
        }
        let (panel, lane) = (row / LANES, row % LANES);
        let distance = self.distances[panel].0[lane];
        (distance < PADDING).then(|| (self.queries[panel].0[lane] as u32, distance as u32))
    }

    /// Merges the results of another pass over the same rows. The order of merging does not matter.
    pub fn merge(&mut self, other: &Self) {
        let mine = self.distances.iter_mut().zip(&mut self.queries);
        for ((distances, queries), (d, q)) in mine.zip(other.distances.iter().zip(&other.queries)) {
            for lane in 0..LANES {
                if (d.0[lane], q.0[lane]) < (distances.0[lane], queries.0[lane]) {
                    distances.0[lane] = d.0[lane];
                    queries.0[lane] = q.0[lane];
                }
            }
        }
    }
}

/// The nearest row of each query, and the distance of the second nearest; `None` for every query when there are no
/// rows.
///
/// `queries` is `[N, dim]`, consecutive; bytes after the last whole query are ignored. Distances are exact.
pub fn best_two(queries: &[u8], rows: &PackedRows) -> Vec<Option<BestTwo>> {
    dispatch::<false>(
        queries,
        0,
        rows,
        &mut ColumnBest { len: 0, distances: Vec::new(), queries: Vec::new() },
    )
}

/// Like [`best_two`]; the same pass also updates the nearest query of each row.
///
/// The queries have the indices `first_query`, `first_query + 1` and so on in `columns`. Queries may be given in
/// several calls in ascending order, or to several [`ColumnBest`] that are merged afterwards.
///
/// # Panics
/// When `columns` is for other rows.
pub fn best_two_with_columns(
    queries: &[u8],
    first_query: u32,
    rows: &PackedRows,
    columns: &mut ColumnBest,
) -> Vec<Option<BestTwo>> {
    assert!(columns.len == rows.len(), "columns for {} rows, not {}", columns.len, rows.len());
    dispatch::<true>(queries, first_query, rows, columns)
}

fn dispatch<const COLUMNS: bool>(
    queries: &[u8],
    first_query: u32,
    rows: &PackedRows,
    columns: &mut ColumnBest,
) -> Vec<Option<BestTwo>> {
    #[cfg(target_arch = "aarch64")]
    if rows.backend().has_dotprod() {
        // SAFETY: the rows contain a backend value, which proves that the CPU has this feature.
        return unsafe { scan_dotprod::<COLUMNS>(queries, first_query, rows, columns) };
    }
    match rows.backend().kind() {
        // SAFETY: needs no CPU feature.
        Kind::Portable => unsafe { scan::<Portable, COLUMNS>(queries, first_query, rows, columns) },
        // SAFETY: the rows contain a backend value, which proves that the CPU has these features.
        #[cfg(target_arch = "x86_64")]
        Kind::Avx2 => unsafe { scan_avx2::<COLUMNS>(queries, first_query, rows, columns) },
        // SAFETY: as above.
        #[cfg(target_arch = "x86_64")]
        Kind::Avx512Vnni => unsafe { scan_avx512::<COLUMNS>(queries, first_query, rows, columns) },
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn scan_avx2<const COLUMNS: bool>(
    queries: &[u8],
    first_query: u32,
    rows: &PackedRows,
    columns: &mut ColumnBest,
) -> Vec<Option<BestTwo>> {
    // SAFETY: this function is compiled for, and so only called with, the features of the tile.
    unsafe { scan::<crate::tile::Avx2, COLUMNS>(queries, first_query, rows, columns) }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,avx512f,avx512bw,avx512vl,avx512vnni")]
fn scan_avx512<const COLUMNS: bool>(
    queries: &[u8],
    first_query: u32,
    rows: &PackedRows,
    columns: &mut ColumnBest,
) -> Vec<Option<BestTwo>> {
    // SAFETY: this function is compiled for, and so only called with, the features of the tile.
    unsafe { scan::<crate::tile::Avx512Vnni, COLUMNS>(queries, first_query, rows, columns) }
}

#[cfg(target_arch = "aarch64")]
#[target_feature(enable = "dotprod")]
fn scan_dotprod<const COLUMNS: bool>(
    queries: &[u8],
    first_query: u32,
    rows: &PackedRows,
    columns: &mut ColumnBest,
) -> Vec<Option<BestTwo>> {
    // SAFETY: this function is compiled for, and so only called with, the features of the tile.
    unsafe { scan::<crate::tile::DotProd, COLUMNS>(queries, first_query, rows, columns) }
}

/// Panels visited by all queries before the next ones: 512 rows of 128 bytes are 64 KiB, well inside a second-level
/// cache.
const BLOCK_BYTES: usize = 1 << 16;

/// The pass itself, compiled once per instruction set.
///
/// # Safety
/// The CPU must have the features of `T`.
#[inline(always)]
unsafe fn scan<T: Tile, const COLUMNS: bool>(
    queries: &[u8],
    first_query: u32,
    rows: &PackedRows,
    columns: &mut ColumnBest,
) -> Vec<Option<BestTwo>> {
    let packed = PackedQueries::new::<T>(queries, rows.dim());
    let mut best = vec![LaneBest::NONE; packed.count];
    let tile_bytes = rows.panel_bytes() * TILE_PANELS;
    let tile_queries = packed.padded_dim * TILE_QUERIES;
    let block_tiles = (BLOCK_BYTES / tile_bytes).max(1);
    let mut dots: TileDots = [[Lanes([0; LANES]); TILE_QUERIES]; TILE_PANELS];
    for (block, block_panels) in rows.panels().chunks(block_tiles * tile_bytes).enumerate() {
        for (group, queries) in packed.components.chunks_exact(tile_queries).enumerate() {
            let here = group * TILE_QUERIES..packed.count.min((group + 1) * TILE_QUERIES);
            let (norms, best) = (&packed.norms[here.clone()], &mut best[here.clone()]);
            for (tile, panels) in block_panels.chunks_exact(tile_bytes).enumerate() {
                // SAFETY: the caller guarantees the features.
                unsafe { T::dots(queries, panels, &mut dots) };
                for (p, dots) in dots.iter().enumerate() {
                    let panel = (block * block_tiles + tile) * TILE_PANELS + p;
                    let offsets = &rows.offsets()[panel];
                    for ((dots, &norm), best) in dots.iter().zip(norms).zip(best.iter_mut()) {
                        best.update(&distances(dots, norm, offsets), panel as i32);
                    }
                    if COLUMNS {
                        let (mut nearest, mut query) = (columns.distances[panel], columns.queries[panel]);
                        for ((dots, &norm), index) in dots.iter().zip(norms).zip(here.clone()) {
                            let index = (first_query as usize + index) as i32;
                            let distances = distances(dots, norm, offsets);
                            for lane in 0..LANES {
                                let nearer = distances.0[lane] < nearest.0[lane];
                                nearest.0[lane] = if nearer { distances.0[lane] } else { nearest.0[lane] };
                                query.0[lane] = if nearer { index } else { query.0[lane] };
                            }
                        }
                        (columns.distances[panel], columns.queries[panel]) = (nearest, query);
                    }
                }
            }
        }
    }
    best.iter().map(LaneBest::reduce).collect()
}

/// Squared distances of one query to the rows of one panel, `|q|^2 + offset - 2 dot`.
///
/// Single terms may exceed 32 bits for the longest rows, the result never does: hence the wrapping sums.
#[inline(always)]
fn distances(dots: &Lanes, norm: i32, offsets: &Lanes) -> Lanes {
    Lanes(std::array::from_fn(|lane| {
        norm.wrapping_add(offsets.0[lane]).wrapping_sub(dots.0[lane].wrapping_mul(2))
    }))
}

/// Queries in the layout of the tile, `[tile][step][TILE_QUERIES][4]`, padded with zeros, and their squared norms
/// `[N]`.
struct PackedQueries<C> {
    count: usize,
    padded_dim: usize,
    components: Vec<C>,
    norms: Vec<i32>,
}

impl<C: Copy> PackedQueries<C> {
    #[inline(always)]
    fn new<T: Tile<Component = C>>(queries: &[u8], dim: usize) -> Self {
        let count = queries.len() / dim;
        let padded_dim = dim.next_multiple_of(STEP);
        let mut components = vec![T::component(0); count.next_multiple_of(TILE_QUERIES) * padded_dim];
        let mut norms = Vec::with_capacity(count);
        let tiles = components.chunks_exact_mut(TILE_QUERIES * padded_dim);
        for (queries, tile) in queries.chunks(TILE_QUERIES * dim).zip(tiles) {
            for (q, query) in queries.chunks_exact(dim).enumerate() {
                let slots = tile.chunks_exact_mut(STEP).skip(q).step_by(TILE_QUERIES);
                for (values, slot) in query.chunks(STEP).zip(slots) {
                    for (&value, slot) in values.iter().zip(slot) {
                        *slot = T::component(value);
                    }
                }
                norms.push(query.iter().map(|&v| i32::from(v) * i32::from(v)).sum());
            }
        }
        Self { count, padded_dim, components, norms }
    }
}

/// The running two best of one query, per lane.
#[derive(Clone, Copy)]
struct LaneBest {
    distance: Lanes,
    panel: Lanes,
    second: Lanes,
}

impl LaneBest {
    const NONE: Self = Self {
        distance: Lanes([i32::MAX; LANES]),
        panel: Lanes([0; LANES]),
        second: Lanes([i32::MAX; LANES]),
    };

    #[inline(always)]
    fn update(&mut self, distances: &Lanes, panel: i32) {
        for lane in 0..LANES {
            let (d, best) = (distances.0[lane], self.distance.0[lane]);
            let nearer = d < best;
            self.second.0[lane] = self.second.0[lane].min(d.max(best));
            self.distance.0[lane] = d.min(best);
            self.panel.0[lane] = if nearer { panel } else { self.panel.0[lane] };
        }
    }

    /// Combines the lanes; padding rows are excluded by their distance.
    fn reduce(&self) -> Option<BestTwo> {
        let key = |lane: usize| (self.distance.0[lane], self.panel.0[lane] as usize * LANES + lane);
        let winner = (0..LANES).min_by_key(|&lane| key(lane))?;
        let (distance, index) = key(winner);
        let others = (0..LANES).filter(|&lane| lane != winner).map(|lane| self.distance.0[lane]);
        let second = others.chain([self.second.0[winner]]).min()?;
        let real = |d: i32| (d < PADDING).then_some(d as u32);
        Some(BestTwo { index: index as u32, distance: real(distance)?, second: real(second) })
    }
}

#[cfg(test)]
mod tests;
