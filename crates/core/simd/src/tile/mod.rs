//! Dot products of a few queries with a few packed panels: the one inner loop that differs by instruction set.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
#[cfg(target_arch = "aarch64")]
mod dotprod;
mod portable;

#[cfg(target_arch = "aarch64")]
pub(crate) use dotprod::DotProd;
pub(crate) use portable::Portable;
#[cfg(target_arch = "x86_64")]
pub(crate) use {avx2::Avx2, avx512::Avx512Vnni};

/// Rows of one panel.
pub(crate) const LANES: usize = 16;
/// Adjacent components of a row in a panel.
pub(crate) const STEP: usize = 4;
/// Queries of one tile.
pub(crate) const TILE_QUERIES: usize = 8;
/// Panels of one tile. With 8 queries, 16 accumulators of 16 lanes, half of the AVX-512 registers.
pub(crate) const TILE_PANELS: usize = 2;

/// One number for each row of a panel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(align(64))]
pub(crate) struct Lanes(pub(crate) [i32; LANES]);

/// Dot products of a tile, `[panel][query][lane]`.
pub(crate) type TileDots = [[Lanes; TILE_QUERIES]; TILE_PANELS];

/// One instruction set.
pub(crate) trait Tile {
    /// How one component of a query is stored.
    type Component: Copy;

    /// Stores one component.
    fn component(value: u8) -> Self::Component;

    /// Dot products of [`TILE_QUERIES`] queries with [`TILE_PANELS`] panels, in the backend's own representation of the
    /// query (the packed rows' offsets compensate for it).
    ///
    /// `queries` is `[padded dim / 4, TILE_QUERIES, 4]`, `panels` is `[TILE_PANELS, padded dim / 4, 16, 4]`.
    ///
    /// # Safety
    /// The CPU must have the features of the implementation. The slices' lengths are checked.
    unsafe fn dots(queries: &[Self::Component], panels: &[u8], dots: &mut TileDots);
}
