//! The grid of cells that an inversion network is given.

/// Size of a grid, cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Grid {
    /// The grid with about `side` cells along the longer side for an image of this size; both sides are multiples of
    /// `multiple`.
    pub(super) fn of_image([width, height]: [u32; 2], side: usize, multiple: usize) -> Self {
        let scale = side as f64 / f64::from(width.max(height).max(1));
        let along = |pixels: u32| {
            let whole = (f64::from(pixels) * scale / multiple as f64).round() as usize;
            whole.max(1) * multiple
        };
        Self { width: along(width), height: along(height) }
    }

    /// Number of cells.
    pub fn cells(self) -> usize {
        self.width * self.height
    }
}
