//! An image to learn from: its colours on the grid, and its keypoints with descriptors.

use crate::EvalError;
use crate::inversion::network::{Grid, Placed, Sees};
use crate::inversion::pixels::{on_grid, to_bytes};
use crate::inversion::places;
use crate::inversion::task::InversionTask;
use rand::Rng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::Observation;
use veiloc_attacks::training::Matrix;
use veiloc_datasets::problem_files::KeypointImage;
use veiloc_features::ColourImage;
use veiloc_geometry::Pixel;
use veiloc_obfuscation::SealError;
use veiloc_obfuscation::audit::obfuscate_points;

/// By how much the larger version of an image exceeds the grid, in eighths: parts of it are drawn.
const LARGER: usize = 10;
/// Least share of the keypoints that is drawn.
const LEAST_SHARE: f64 = 0.4;

/// An image to learn from, or to judge by.
#[derive(Debug, Clone)]
pub struct Example {
    /// Width and height, pixels.
    size: [u32; 2],
    keypoints: Vec<Pixel>,
    /// `[N · dimension]`.
    descriptors: Vec<u8>,
    dimension: usize,
    grid: Grid,
    /// `[cells · 3]`, the whole image on the grid.
    whole: Vec<u8>,
    /// The same on a larger one.
    larger: (Grid, Vec<u8>),
}

/// What the network is given of an example, and what it is to answer, `[3, cells]`.
#[derive(Debug, Clone)]
pub(crate) struct Lesson {
    pub(crate) placed: Placed,
    /// `[N]`: which descriptors stand where they belong.
    pub(crate) right: Vec<bool>,
    pub(crate) truth: Matrix,
}

impl Example {
    /// Of an image and its keypoints with descriptors; the image may be larger than `keypoints` say that it is.
    ///
    /// # Errors
    /// [`EvalError::Descriptors`] when there are none, or they are of another length than the network takes.
    pub fn new(
        image: &ColourImage,
        keypoints: &KeypointImage,
        task: &InversionTask,
    ) -> Result<Self, EvalError> {
        let (descriptors, dimension) = descriptors(keypoints, task.shape.dimension)?;
        let size = [keypoints.width, keypoints.height];
        let grid = task.shape.grid(size);
        let wider = Grid { width: grid.width * LARGER / 8, height: grid.height * LARGER / 8 };
        Ok(Self {
            size,
            keypoints: keypoints.keypoints.clone(),
            descriptors: descriptors.to_vec(),
            dimension,
            grid,
            whole: to_bytes(&on_grid(image, grid)),
            larger: (wider, to_bytes(&on_grid(image, wider))),
        })
    }

    /// Feeds a hash all that a training depends on.
    pub(crate) fn feed(&self, feed: &mut dyn FnMut(&[u8])) {
        self.size.iter().for_each(|side| feed(&side.to_le_bytes()));
        for p in &self.keypoints {
            feed(&p.u.to_le_bytes());
            feed(&p.v.to_le_bytes());
        }
        feed(&self.descriptors);
        feed(&self.whole);
    }

    /// How many keypoints it has.
    pub fn keypoints(&self) -> usize {
        self.keypoints.len()
    }

    /// The whole image on the grid, `[cells · 3]`.
    pub(crate) fn colours(&self) -> &[u8] {
        &self.whole
    }

    /// Whether it can teach anything.
    pub(crate) fn is_empty(&self) -> bool {
        self.keypoints.is_empty()
    }

    /// The whole image with all its keypoints.
    pub(crate) fn whole(&self, task: &InversionTask, rng: &mut ChaCha8Rng) -> Result<Lesson, SealError> {
        let all: Vec<usize> = (0..self.keypoints.len()).collect();
        let placed = self.placed(&all, &self.keypoints, self.size, task, rng)?;
        Ok(Lesson { placed, right: vec![true; all.len()], truth: colours(&self.whole) })
    }

    /// Some of the keypoints, of the whole image or of a part as an image of its own; some of them in wrong places, where the
    /// task says so.
    pub(crate) fn draw(&self, task: &InversionTask, rng: &mut ChaCha8Rng) -> Result<Lesson, SealError> {
        let mut kept: Vec<usize> = (0..self.keypoints.len()).collect();
        let (mut places, mut size, mut truth) = (self.keypoints.clone(), self.size, None);
        if rng.random::<bool>() {
            let (wider, bytes) = &self.larger;
            let x = rng.random_range(0..=wider.width - self.grid.width);
            let y = rng.random_range(0..=wider.height - self.grid.height);
            let scale =
                [f64::from(self.size[0]) / wider.width as f64, f64::from(self.size[1]) / wider.height as f64];
            // Sides of an image are whole pixels; places are stretched by less than one.
            let sides = [scale[0] * self.grid.width as f64, scale[1] * self.grid.height as f64];
            size = sides.map(|side| (side.round() as u32).max(1));
            let part = |p: &Pixel| {
                let along = |at: f64, first: usize, axis: usize| {
                    (at - scale[axis] * first as f64) * f64::from(size[axis]) / sides[axis]
                };
                Pixel::new(along(p.u, x, 0), along(p.v, y, 1))
            };
            places = self.keypoints.iter().map(part).collect();
            kept.retain(|i| places::cell(places[*i], size, self.grid).is_some());
            let rows = bytes.chunks_exact(3 * wider.width).skip(y).take(self.grid.height);
            truth = Some(
                rows.flat_map(|row| &row[3 * x..3 * (x + self.grid.width)]).copied().collect::<Vec<u8>>(),
            );
        }
        let share = rng.random_range(LEAST_SHARE..1.0);
        let count = (share * kept.len() as f64).ceil() as usize;
        let (drawn, _) = kept.partial_shuffle(rng, count);
        let drawn = drawn.to_vec();
        let mut chosen: Vec<Pixel> = drawn.iter().map(|i| places[*i]).collect();
        let right = places::misplace(&mut chosen, size, self.grid, task.most_wrong(), rng);
        let placed = self.placed(&drawn, &chosen, size, task, rng)?;
        Ok(Lesson { placed, right, truth: colours(truth.as_ref().unwrap_or(&self.whole)) })
    }

    fn placed(
        &self,
        which: &[usize],
        at: &[Pixel],
        size: [u32; 2],
        task: &InversionTask,
        rng: &mut ChaCha8Rng,
    ) -> Result<Placed, SealError> {
        let shares = match task.shape.sees {
            Sees::Places => places::at(at, size, self.grid),
            Sees::Lines => {
                let sent = obfuscate_points(at, size[0], size[1], &task.scheme, task.angle_bits, rng)?;
                places::along(&Observation::of_sent(&sent), size, self.grid)
            }
            Sees::Bag => Vec::new(),
        };
        let rows = which.iter().map(|i| &self.descriptors[i * self.dimension..(i + 1) * self.dimension]);
        Ok(Placed { grid: self.grid, descriptors: columns(rows, self.dimension, which.len()), shares })
    }
}

/// Descriptors of an image and their length, which must be this.
pub(crate) fn descriptors(image: &KeypointImage, expected: usize) -> Result<(&[u8], usize), EvalError> {
    match &image.descriptors {
        Some((bytes, dimension)) if *dimension == expected => Ok((bytes, *dimension)),
        other => Err(EvalError::Descriptors {
            image: image.name.clone(),
            found: other.as_ref().map_or(0, |(_, dimension)| *dimension),
            expected,
        }),
    }
}

/// Descriptors as the network takes them, `[dimension, N]`: the squares of a column sum up to its length, so that its numbers
/// are near one; a column of zeros stays zero.
pub(crate) fn columns<'a>(rows: impl Iterator<Item = &'a [u8]>, dimension: usize, count: usize) -> Matrix {
    let mut columns = Matrix::zeros(dimension, count);
    for (mut column, row) in columns.column_iter_mut().zip(rows) {
        column.iter_mut().zip(row).for_each(|(c, byte)| *c = f32::from(*byte));
        let norm = column.norm();
        if norm > 0.0 {
            column *= (dimension as f32).sqrt() / norm;
        }
    }
    columns
}

fn colours(bytes: &[u8]) -> Matrix {
    Matrix::from_iterator(3, bytes.len() / 3, bytes.iter().map(|b| f32::from(*b) / 255.0))
}
