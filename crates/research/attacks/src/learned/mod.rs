//! An outsider who learns: whoever sees sealed queries alone, has other people's images and the time to train.
//!
//! He knows no place and no pose. What he can have is what images have in common, and two networks learn it:
//! - [`neighbours`]: from the descriptors of an image to who is near whom, for the attacks of `veiloc-attacks` that
//!   live on neighbours;
//! - [`positions`]: end to end, from all rows of a query, descriptors and lines, to where on its line each keypoint
//!   lies.
//!
//! Both are trained on the CPU by the engine of `veiloc_attacks::training`, with derivatives by hand: equal seeds give equal
//! networks, whatever the number of threads, and a training that was interrupted goes on as if it had not been
//! ([`TrainingState`]). Decision 0021 says why no library does this.
#![forbid(unsafe_code)]

mod engine;
pub mod neighbours;
mod options;
pub mod positions;

pub use crate::training::{CurvePoint, Progress, Trained, TrainingState};
pub use options::TrainingOptions;
