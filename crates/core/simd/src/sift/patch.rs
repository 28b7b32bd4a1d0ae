//! The surroundings of a keypoint: the directions of its gradients, and the histogram that describes it.

use super::grid::{BlurredImage, Placement, ROUND, Samples};
use super::lanes::{LANES, Lanes, Side};
use crate::approx::{cos_sin, exp_of_negative};
use crate::{Backend, dispatch};

/// Bytes of a descriptor: `[CELLS rows, CELLS columns, TURNS]`.
pub const DESCRIPTOR: usize = CELLS * CELLS * TURNS;
/// Bins of a full turn in the histogram of directions around a keypoint.
pub const BINS: usize = 36;

/// Cells along one side.
const CELLS: usize = 4;
/// Directions per cell.
const TURNS: usize = 8;
/// Resolution of directions in a full turn, a power of two: 1.4 degrees.
const TURN_STEPS: usize = 32 * TURNS;
/// Side of a cell, in sigmas of the keypoint.
const CELL_SIDE: f32 = 3.0;
/// Standard deviation of the Gaussian weight of gradients, in cells.
const WINDOW: f32 = 2.0;
/// Maximum of a bin, as a share of the length of the whole vector.
const CLIP: f32 = 0.2;
/// Samples along the side of a cell.
const PER_CELL: usize = 5;
/// Samples along the side of the square that is used: the cells, and half a cell around them.
const SIDE: usize = (CELLS + 1) * PER_CELL;
/// One more on each side, for gradients.
const PITCH: usize = SIDE + 2;
/// All samples, with padding to the end of the last vector of gradients.
const SAMPLES: usize = (FIRST + COUNTED + PITCH).next_multiple_of(LANES);
/// The first sample of the square, and the number of samples to its end.
const FIRST: usize = PITCH + 1;
const COUNTED: usize = (SIDE * PITCH - 2).next_multiple_of(LANES);

/// Radius around a keypoint of the samples that its descriptor uses, for every orientation, in its sigmas: to the
/// corner of the grid.
pub const PATCH_RADIUS: f32 =
    std::f32::consts::SQRT_2 * CELL_SIDE / PER_CELL as f32 * ((SIDE - 1) as f32 / 2.0 + 1.0);

/// Radius of the circle for directions, in samples and in sigmas of the keypoint.
const ROUND_RADIUS: usize = 8;
const ROUND_REACH: f32 = 4.5;
/// Samples along the side of the square around it, and with one more on each side for gradients.
const ROUND_SIDE: usize = 2 * ROUND_RADIUS + 1;
const ROUND_PITCH: usize = ROUND_SIDE + 2;
/// The first sample of that square, the number to its end, and of all samples, as for the descriptor.
const ROUND_FIRST: usize = ROUND_PITCH + 1;
const ROUND_COUNTED: usize = (ROUND_SIDE * ROUND_PITCH - 2).next_multiple_of(LANES);
const ROUND_SAMPLES: usize = (ROUND_FIRST + ROUND_COUNTED + ROUND_PITCH).next_multiple_of(LANES);
/// The window of directions is a Gaussian this many times as wide as the keypoint's own blur.
const ROUND_WINDOW: f32 = 1.5;
/// Step of their grid, in sigmas of the keypoint.
const ROUND_STEP: f32 = ROUND_REACH / ROUND_RADIUS as f32;
/// Rounds of smoothing of the directions over three bins.
const SMOOTHINGS: usize = 6;

/// Constants for all keypoints: grids and the weights of their samples.
#[derive(Debug, Clone)]
pub struct Patches {
    backend: Backend,
    round_steps: Box<[[f32; ROUND_SAMPLES]; 2]>,
    round_weights: Box<[f32; ROUND_COUNTED]>,
    /// The nonzero ones.
    round_members: Vec<u16>,
    steps: Box<[[f32; SAMPLES]; 2]>,
    weights: Box<[f32; COUNTED]>,
    shares: Box<[Side<TURNS>; TURN_STEPS]>,
}

/// Scratch memory, shared by consecutive keypoints.
pub struct PatchMemory {
    round: Samples<ROUND_SAMPLES>,
    round_votes: [[f32; 2]; ROUND_COUNTED],
    square: Samples<SAMPLES>,
    turns: [u32; COUNTED],
    votes: [f32; COUNTED],
}

impl PatchMemory {
    /// Empty.
    pub fn new() -> Box<Self> {
        Box::new(Self {
            round: Samples::EMPTY,
            round_votes: [[0.0; 2]; ROUND_COUNTED],
            square: Samples::EMPTY,
            turns: [0; COUNTED],
            votes: [0.0; COUNTED],
        })
    }
}

impl Patches {
    /// Grids and weights for `backend`.
    pub fn new(backend: Backend) -> Self {
        let gaussian = |square: f32, sigma: f32| exp_of_negative(-square / (2.0 * sigma * sigma));
        let mut round_steps = Box::new([[0.0; ROUND_SAMPLES]; 2]);
        let mut round_weights = Box::new([0.0; ROUND_COUNTED]);
        let mut round_members = Vec::new();
        for k in 0..ROUND_PITCH * ROUND_PITCH {
            let [x, y] = [k % ROUND_PITCH, k / ROUND_PITCH].map(|at| at as f32 - (ROUND_RADIUS + 1) as f32);
            (round_steps[0][k], round_steps[1][k]) = (x, y);
            let square = x * x + y * y;
            if square <= (ROUND_RADIUS * ROUND_RADIUS) as f32 {
                round_weights[k - ROUND_FIRST] = gaussian(square, ROUND_WINDOW / ROUND_STEP);
                round_members.push((k - ROUND_FIRST) as u16);
            }
        }
        let mut steps = Box::new([[0.0; SAMPLES]; 2]);
        let mut weights = Box::new([0.0; COUNTED]);
        let from_middle = |at: usize| at as f32 - (PITCH - 1) as f32 / 2.0;
        for k in 0..PITCH * PITCH {
            let (row, column) = (k / PITCH, k % PITCH);
            let (x, y) = (from_middle(column), from_middle(row));
            (steps[0][k], steps[1][k]) = (x, y);
            if (1..=SIDE).contains(&column) && (1..=SIDE).contains(&row) {
                weights[k - FIRST] = gaussian(x * x + y * y, WINDOW * PER_CELL as f32);
            }
        }
        Self { backend, round_steps, round_weights, round_members, steps, weights, shares: shares_of_turns() }
    }

    /// Directions of the gradients around a keypoint, `[BINS]` from -π on, weighted and smoothed.
    ///
    /// `middle` and `sigma` in samples of `view`. All zero where there is no gradient.
    // Not inlined, so that profiles and counters show it.
    #[inline(never)]
    pub fn directions(
        &self,
        view: BlurredImage<'_>,
        middle: [f32; 2],
        sigma: f32,
        memory: &mut PatchMemory,
    ) -> [f32; BINS] {
        let at = Placement { middle, axis: [ROUND_STEP * sigma, 0.0] };
        dispatch::run(self.backend, Directions { patches: self, view, at, memory })
    }

    /// The histogram of the gradients around a keypoint as RootSIFT bytes: unit length, clipped, then the square root
    /// of each bin's share of the sum, times 512, rounded, clipped at 255.
    ///
    /// `middle` and `sigma` in samples of `view`, `orientation` in radians. All zero where there is no gradient.
    // Not inlined, so that profiles and counters show it.
    #[inline(never)]
    pub fn describe(
        &self,
        view: BlurredImage<'_>,
        middle: [f32; 2],
        sigma: f32,
        orientation: f32,
        memory: &mut PatchMemory,
    ) -> [u8; DESCRIPTOR] {
        let step = CELL_SIDE * sigma / PER_CELL as f32;
        let at = Placement { middle, axis: cos_sin(orientation).map(|axis| step * axis) };
        dispatch::run(self.backend, Descriptor { patches: self, view, at, memory })
    }
}

struct Directions<'a> {
    patches: &'a Patches,
    view: BlurredImage<'a>,
    at: Placement,
    memory: &'a mut PatchMemory,
}

impl dispatch::Kernel for Directions<'_> {
    type Output = [f32; BINS];

    #[inline(always)]
    fn run(self) -> [f32; BINS] {
        use std::f32::consts::{PI, TAU};

        let Self { patches, view, at, memory } = self;
        let whole = memory.round.take(view, at, &patches.round_steps);
        let mut places = [0_u32; ROUND_COUNTED];
        for start in (0..ROUND_COUNTED).step_by(LANES) {
            let [length, angle] = memory.round.gradients(start + ROUND_FIRST, ROUND_PITCH, whole);
            for i in 0..LANES {
                let vote = length.0[i] * patches.round_weights[start + i];
                // Divided between the two bins with the nearest centres; the first is repeated after the last.
                let place = (angle.0[i] + PI) * (BINS as f32 / TAU) + 0.5;
                let floor = (place - 0.5) + ROUND;
                let share = place - (floor - ROUND);
                places[start + i] = floor.to_bits() & 0x3f;
                memory.round_votes[start + i] = [vote - share * vote, share * vote];
            }
        }
        // Counted in turns, so that a vote does not depend on the previous one.
        let mut turns = [[0.0_f32; BINS + 4]; 4];
        for (k, &member) in patches.round_members.iter().enumerate() {
            let member = usize::from(member);
            let bin = (places[member] as usize).min(BINS);
            let [here, next] = memory.round_votes[member];
            turns[k % 4][bin] += here;
            turns[k % 4][bin + 1] += next;
        }
        // Bin `k` is at `k + 1`.
        let mut bins = [0.0_f32; BINS + 2];
        for k in 0..BINS + 2 {
            bins[k] = (turns[0][k] + turns[1][k]) + (turns[2][k] + turns[3][k]);
        }
        bins[BINS] += bins[0];
        bins[1] += bins[BINS + 1];
        for _ in 0..SMOOTHINGS {
            (bins[0], bins[BINS + 1]) = (bins[BINS], bins[1]);
            let old = bins;
            for k in 1..=BINS {
                bins[k] = (old[k - 1] + old[k] + old[k + 1]) * (1.0 / 3.0);
            }
        }
        std::array::from_fn(|k| bins[k + 1])
    }
}

struct Descriptor<'a> {
    patches: &'a Patches,
    view: BlurredImage<'a>,
    at: Placement,
    memory: &'a mut PatchMemory,
}

impl dispatch::Kernel for Descriptor<'_> {
    type Output = [u8; DESCRIPTOR];

    #[inline(always)]
    fn run(self) -> [u8; DESCRIPTOR] {
        let Self { patches, view, at, memory } = self;
        let whole = memory.square.take(view, at, &patches.steps);
        for start in (0..COUNTED).step_by(LANES) {
            let [length, angle] = memory.square.gradients(start + FIRST, PITCH, whole);
            let mut turns = [0; LANES];
            for i in 0..LANES {
                // Opposite to the rotation from the first to the second axis.
                let turn = TURN_STEPS as f32 - angle.0[i] * (TURN_STEPS as f32 / std::f32::consts::TAU);
                turns[i] = (turn + ROUND).to_bits() & (TURN_STEPS as u32 - 1);
            }
            // SAFETY: both have `COUNTED` numbers, a multiple of `LANES`.
            unsafe { (length * Lanes::load(&patches.weights[..], start)).store(&mut memory.votes, start) };
            memory.turns[start..][..LANES].copy_from_slice(&turns);
        }
        root_sift(&cells(&patches.shares, &memory.turns, &memory.votes))
    }
}

/// Weights of a vote for the directions of a cell, by the nearest step of its direction: two neighbours have all of it.
fn shares_of_turns() -> Box<[Side<TURNS>; TURN_STEPS]> {
    let mut shares = Box::new([Side::all(0.0); TURN_STEPS]);
    let per_turn = TURN_STEPS / TURNS;
    for (step, shares) in shares.iter_mut().enumerate() {
        let share = (step % per_turn) as f32 / per_turn as f32;
        shares.0[step / per_turn] = 1.0 - share;
        shares.0[(step / per_turn + 1) % TURNS] = share;
    }
    shares
}

/// Divides each vote among two directions and the nearest cells, `[CELLS, CELLS, TURNS]`.
#[inline(always)]
fn cells(
    shares: &[Side<TURNS>; TURN_STEPS],
    turns: &[u32; COUNTED],
    votes: &[f32; COUNTED],
) -> [f32; DESCRIPTOR] {
    // Position of a sample between the centres of two cells.
    let share = |sample: usize| (sample as f32 + 0.5) / PER_CELL as f32;
    // The first and the last cells of rows and columns are not in the descriptor: they collect samples outside of it.
    let mut cells = [[Side::<TURNS>::all(0.0); CELLS + 2]; CELLS + 2];
    for row in 0..SIDE {
        let mut columns = [Side::<TURNS>::all(0.0); CELLS + 2];
        for group in 0..=CELLS {
            let (mut all, mut right) = (Side::all(0.0), Side::all(0.0));
            for sample in 0..PER_CELL {
                let k = row * PITCH + group * PER_CELL + sample;
                let vote = Side::all(votes[k]) * shares[turns[k] as usize % TURN_STEPS];
                all = all + vote;
                right = right + Side::all(share(sample)) * vote;
            }
            columns[group] = columns[group] + (all - right);
            columns[group + 1] = right;
        }
        let (above, down) = (row / PER_CELL, Side::all(share(row % PER_CELL)));
        let up = Side::all(1.0 - share(row % PER_CELL));
        for column in 1..=CELLS {
            cells[above][column] = cells[above][column] + up * columns[column];
            cells[above + 1][column] = cells[above + 1][column] + down * columns[column];
        }
    }
    let mut histogram = [0.0; DESCRIPTOR];
    for (k, cell) in histogram.chunks_exact_mut(TURNS).enumerate() {
        cell.copy_from_slice(&cells[k / CELLS + 1][k % CELLS + 1].0);
    }
    histogram
}

/// Unit length, clipped (against single strong edges), then the square root of each bin's share of the sum, times 512,
/// rounded, clipped at 255: the same code as COLMAP's.
#[inline(always)]
fn root_sift(histogram: &[f32; DESCRIPTOR]) -> [u8; DESCRIPTOR] {
    let mut squares = [0.0_f32; LANES];
    for part in histogram.chunks_exact(LANES) {
        for i in 0..LANES {
            squares[i] += part[i] * part[i];
        }
    }
    let limit = CLIP * squares.iter().sum::<f32>().sqrt();
    let mut sums = [0.0_f32; LANES];
    for part in histogram.chunks_exact(LANES) {
        for i in 0..LANES {
            sums[i] += if part[i] < limit { part[i] } else { limit };
        }
    }
    let sum: f32 = sums.iter().sum();
    let mut bytes = [0; DESCRIPTOR];
    if sum <= 0.0 {
        return bytes;
    }
    for k in 0..DESCRIPTOR {
        let clipped = if histogram[k] < limit { histogram[k] } else { limit };
        let value = 512.0 * (clipped / sum).sqrt();
        bytes[k] = ((if value < 255.0 { value } else { 255.0 }) + ROUND).to_bits() as u8;
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The examples of docs/reference/wire-format.md, for authors of other extractors.
    #[test]
    fn bytes_agree_with_the_documentation() {
        assert_eq!(root_sift(&[7.0; DESCRIPTOR]), [45; DESCRIPTOR]);
        let mut single = [0.0; DESCRIPTOR];
        single[17] = 3.0;
        let mut expected = [0; DESCRIPTOR];
        expected[17] = 255;
        assert_eq!(root_sift(&single), expected);
        assert_eq!(root_sift(&[0.0; DESCRIPTOR]), [0; DESCRIPTOR]);
        // Clipped at a fifth of the length: 20 numbers of 1 and one of 100, with length √(20 + 10000).
        let mut strong = [0.0; DESCRIPTOR];
        strong[..20].fill(1.0);
        strong[20] = 100.0;
        let clipped = 0.2 * 10_020.0_f64.sqrt();
        let byte = |g: f64| (512.0 * (g / (20.0 + clipped)).sqrt()).round().min(255.0) as u8;
        assert_eq!((root_sift(&strong)[0], root_sift(&strong)[20]), (byte(1.0), byte(clipped)));
        assert!(byte(1.0) > 70 && byte(clipped) == 255);
        let document = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../docs/reference/wire-format.md");
        let document = std::fs::read_to_string(document).expect("the document exists");
        assert!(document.contains("128 equal numbers become 128 bytes of 45, and a single one becomes 255"));
    }
}
