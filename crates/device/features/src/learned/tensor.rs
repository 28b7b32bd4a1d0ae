//! Numbers with a shape.

/// Numbers by rows: the last side runs fastest.
#[derive(Clone, PartialEq)]
pub struct Tensor {
    /// Sides, the slowest first.
    pub shape: Vec<usize>,
    /// As many numbers as the product of the sides.
    pub data: Vec<f32>,
}

// The output of a network must not be logged (rule L8).
impl std::fmt::Debug for Tensor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Tensor({:?})", self.shape)
    }
}

impl Tensor {
    /// `[1, C, H, W]` as C, H and W; `None` for another shape.
    pub(crate) fn image(&self) -> Option<[usize; 3]> {
        match self.shape[..] {
            [1, channels, height, width] => Some([channels, height, width]),
            _ => None,
        }
    }

    /// `[1, H, W, C]` as `[1, C, H, W]`; `None` for another number of sides.
    pub(crate) fn channels_first(self) -> Option<Self> {
        let [1, height, width, channels] = self.shape[..] else { return None };
        let mut data = Vec::with_capacity(self.data.len());
        for channel in 0..channels {
            data.extend(self.data.iter().skip(channel).step_by(channels));
        }
        Some(Self { shape: vec![1, channels, height, width], data })
    }
}
