//! The rows of one level during its computation: some are stored, of the others only the last ones.

/// The available rows of one level.
pub(super) struct Rows<'a> {
    pub(super) stride: usize,
    /// The stored rows, from `first` on.
    pub(super) own: &'a mut [f32],
    pub(super) first: usize,
    /// The last ones of the other rows.
    pub(super) ring: Vec<f32>,
    /// The next row to write.
    pub(super) next: usize,
}

impl Rows<'_> {
    #[inline]
    pub(super) fn row(&self, y: usize) -> &[f32] {
        match self.at(y) {
            (true, at) => &self.own[at..][..self.stride],
            (false, at) => &self.ring[at..][..self.stride],
        }
    }

    pub(super) fn row_mut(&mut self, y: usize) -> &mut [f32] {
        match self.at(y) {
            (true, at) => &mut self.own[at..][..self.stride],
            (false, at) => &mut self.ring[at..][..self.stride],
        }
    }

    /// Whether a row is stored, and where it begins.
    #[inline]
    fn at(&self, y: usize) -> (bool, usize) {
        let own = y.wrapping_sub(self.first).wrapping_mul(self.stride);
        if y >= self.first && own < self.own.len() {
            return (true, own);
        }
        let ring = self.ring.len() / self.stride;
        (false, (y & (ring - 1)) * self.stride)
    }
}
