//! The rows of one level while it is made: some of them stay, of the others the last ones.

/// The rows of one level that are at hand.
pub(super) struct Rows<'a> {
    pub(super) stride: usize,
    /// The rows from `first` on, to stay.
    pub(super) own: &'a mut [f32],
    pub(super) first: usize,
    /// The last ones of the others.
    pub(super) ring: Vec<f32>,
    /// The row that is written next.
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

    /// Whether a row is one of those that stay, and where it begins.
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
