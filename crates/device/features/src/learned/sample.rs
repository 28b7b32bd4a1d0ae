//! Descriptors at keypoints: interpolated between the cells of a network's map, with length 1.

use veiloc_descriptor::DescriptorKind;

use crate::FeatureError;
use crate::learned::Tensor;
use crate::learned::description::{Descriptors, Grid, Interpolation};

/// A map of vectors, each normalized to length 1 on access. It may have one per pixel, so vectors are computed only
/// when needed.
pub(crate) struct DescriptorMap {
    rows: usize,
    columns: usize,
    /// `[rows, columns, numbers]`, or `[numbers, rows, columns]`.
    data: Vec<f32>,
    channels_last: bool,
}

impl DescriptorMap {
    /// # Errors
    /// [`FeatureError::NetworkRun`] when the layer does not match the description, or contains NaN or infinity.
    pub(crate) fn of(map: Tensor, described: &Descriptors) -> Result<Self, FeatureError> {
        let broken = |reason: &str| FeatureError::NetworkRun { reason: format!("its descriptors {reason}") };
        let ((true, &[1, rows, columns, numbers]) | (false, &[1, numbers, rows, columns])) =
            (described.channels_last, &map.shape[..])
        else {
            return Err(broken("are not a map"));
        };
        if numbers != described.numbers {
            return Err(broken(&format!("have {numbers} numbers instead of {}", described.numbers)));
        }
        if map.data.iter().any(|number| !number.is_finite()) {
            return Err(broken("contain NaN or infinity"));
        }
        Ok(Self { rows, columns, data: map.data, channels_last: described.channels_last })
    }

    /// The vector of a cell, of length 1, into `out`.
    fn cell(&self, row: usize, column: usize, out: &mut [f32]) {
        let cell = row * self.columns + column;
        let (first, step) =
            if self.channels_last { (cell * out.len(), 1) } else { (cell, self.rows * self.columns) };
        out.iter_mut().zip(self.data[first..].iter().step_by(step)).for_each(|(out, value)| *out = *value);
        normalize(out);
    }

    /// The descriptor at a position of the network's input of this width and height, into `out`, of length 1.
    pub(crate) fn at(&self, position: [f64; 2], size: [usize; 2], described: &Descriptors, out: &mut [f32]) {
        let cells = [self.columns, self.rows];
        let [x, y] = [0, 1].map(|axis| {
            let (at, side, cells) = (position[axis], size[axis] as f64, cells[axis] as f64);
            let stride = described.stride as f64;
            match described.grid {
                Grid::Centers => (at + 0.5) / stride - 0.5,
                Grid::Corners => at / (side - 1.0).max(1.0) * (cells - 1.0),
                Grid::Superpoint => (at - stride / 2.0 + 0.5) / (side - stride / 2.0 - 0.5) * (cells - 1.0),
                Grid::Xfeat => at / (side - 1.0).max(1.0) * cells - 0.5,
            }
        });
        let ([columns, across], [rows, down]) =
            (weights(x, described.interpolation), weights(y, described.interpolation));
        let mut own = vec![0.0; out.len()];
        out.fill(0.0);
        for (row, down) in rows.iter().zip(down) {
            for (column, across) in columns.iter().zip(across) {
                let (row, column, weight) = (*row as usize, *column as usize, (down * across) as f32);
                // Cells outside count as zeros.
                if weight != 0.0 && row < self.rows && column < self.columns {
                    self.cell(row, column, &mut own);
                    for (out, value) in out.iter_mut().zip(&own) {
                        *out += weight * value;
                    }
                }
            }
        }
        normalize(out);
    }
}

/// Four cells along an axis with their weights. A cell below the first wraps to a large index beyond the last one.
fn weights(at: f64, interpolation: Interpolation) -> [[f64; 4]; 2] {
    let first = at.floor();
    let part = at - first;
    let cells =
        [-1.0, 0.0, 1.0, 2.0].map(|step| if first + step < 0.0 { f64::from(u32::MAX) } else { first + step });
    let counts = match interpolation {
        Interpolation::Linear => [0.0, 1.0 - part, part, 0.0],
        Interpolation::Cubic => {
            // Keys' convolution with a = -0.75, as PyTorch's `grid_sample`.
            let a = -0.75;
            let near = |t: f64| ((a + 2.0) * t - (a + 3.0)) * t * t + 1.0;
            let far = |t: f64| ((a * t - 5.0 * a) * t + 8.0 * a) * t - 4.0 * a;
            [far(part + 1.0), near(part), near(1.0 - part), far(2.0 - part)]
        }
    };
    [cells, counts]
}

/// A unit vector in bytes of a kind: each component times the kind's length, rounded, clipped to the range of a byte.
pub(crate) fn bytes(vector: &[f32], kind: DescriptorKind) -> impl Iterator<Item = u8> {
    let length = f64::from(kind.norm());
    vector.iter().map(move |number| kind.encoding().byte(f64::from(*number) * length))
}

/// Normalizes to length 1; a zero vector stays zero.
pub(crate) fn normalize(vector: &mut [f32]) {
    let length = vector.iter().map(|number| number * number).sum::<f32>().sqrt();
    if length > 1e-12 {
        for number in vector {
            *number /= length;
        }
    }
}
