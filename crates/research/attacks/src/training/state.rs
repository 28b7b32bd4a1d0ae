//! A training that was interrupted: everything from which it goes on as if it had not been.
//!
//! ```text
//! "VLTRAINS"            8 bytes
//! version               u32, 1
//! fingerprint           u64, of options and images
//! step, steps since the last look, looks, parameters, step of the best look or 0     u64 each
//! sum of losses since the last look                                              f64
//! value of the best look                                                         f64
//! looks                 step u64, loss f64, value f64 each
//! numbers, running means, running squares, and, where there was a look, the best numbers     f32 each
//! checksum              u64, XXH3 of all that stands before
//! ```
//! Little-endian throughout.

use crate::AttackError;
use crate::training::file::{Format, Reader, Writer};
use crate::training::optimizer::Memory;
use xxhash_rust::xxh3::Xxh3;

const FORMAT: Format = Format {
    magic: b"VLTRAINS",
    version: 1,
    expected: "interrupted training; `veiloc train` writes one beside the network",
};

/// How far training was at one look at the validation images.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CurvePoint {
    /// Steps done.
    pub step: usize,
    /// Mean loss of the steps since the last point, natural logarithms.
    pub loss: f64,
    /// How good the network is on the validation images, as [`Subject::judge`](crate::training::Subject::judge) says: the greater the
    /// better.
    pub judged: f64,
}

/// Everything a training needs to go on.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingState {
    /// Of options and images.
    pub(crate) fingerprint: u64,
    /// Steps done.
    pub(crate) step: usize,
    /// The network as it is.
    pub(crate) numbers: Vec<f32>,
    /// What the optimizer remembers.
    pub(crate) memory: Memory,
    /// The best look so far.
    pub(crate) best: Option<Best>,
    /// All looks.
    pub(crate) curve: Vec<CurvePoint>,
    /// Sum of the losses since the last look, and how many.
    pub(crate) losses: f64,
    pub(crate) since: usize,
}

/// The network of the best look.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Best {
    pub(crate) judged: f64,
    pub(crate) step: usize,
    pub(crate) numbers: Vec<f32>,
}

impl TrainingState {
    /// Steps done.
    pub fn step(&self) -> usize {
        self.step
    }

    /// The bytes of its file.
    pub fn encode(&self) -> Vec<u8> {
        let mut file = Writer::new(&FORMAT);
        let best = self.best.as_ref();
        file.long(self.fingerprint);
        let counts =
            [self.step, self.since, self.curve.len(), self.numbers.len(), best.map_or(0, |b| b.step)];
        for count in counts {
            file.long(count as u64);
        }
        file.real(self.losses);
        file.real(best.map_or(0.0, |b| b.judged));
        for point in &self.curve {
            file.long(point.step as u64);
            file.real(point.loss);
            file.real(point.judged);
        }
        for numbers in [&self.numbers, &self.memory.mean, &self.memory.square] {
            file.numbers(numbers);
        }
        if let Some(best) = best {
            file.numbers(&best.numbers);
        }
        file.finish()
    }

    /// From the bytes of its file.
    ///
    /// # Errors
    /// [`AttackError`] saying what is wrong: no training, another version, cut short, damaged.
    pub fn decode(bytes: &[u8]) -> Result<Self, AttackError> {
        let mut file = Reader::new(bytes, &FORMAT)?;
        let fingerprint = file.long()?;
        let mut counts = [0u64; 5];
        for count in &mut counts {
            *count = file.long()?;
        }
        let (losses, judged) = (file.real()?, file.real()?);
        let [step, since, looks, parameters, best_step] = counts;
        let lists = if best_step > 0 { 4 } else { 3 };
        // Of dishonest counts the sum may pass what can be counted; no file is as long as that.
        let body = looks.saturating_mul(24).saturating_add(parameters.saturating_mul(4 * lists));
        file.seal(body.min(u64::MAX / 2))?;
        let mut curve = Vec::new();
        for _ in 0..looks {
            curve.push(CurvePoint { step: file.long()? as usize, loss: file.real()?, judged: file.real()? });
        }
        let parameters = parameters as usize;
        let numbers = file.numbers(parameters)?;
        let memory = Memory { mean: file.numbers(parameters)?, square: file.numbers(parameters)? };
        let best = if best_step > 0 {
            Some(Best { judged, step: best_step as usize, numbers: file.numbers(parameters)? })
        } else {
            None
        };
        let (step, since) = (step as usize, since as usize);
        Ok(Self { fingerprint, step, numbers, memory, best, curve, losses, since })
    }
}

/// A number that is another one for other options or images: `feed` gives the hash all that a training depends on.
pub fn fingerprint(feed: impl FnOnce(&mut dyn FnMut(&[u8]))) -> u64 {
    let mut hash = Xxh3::new();
    feed(&mut |bytes| hash.update(bytes));
    hash.digest()
}
