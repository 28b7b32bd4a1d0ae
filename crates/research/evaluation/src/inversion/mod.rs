//! Images from descriptors: what whoever has keypoints, or only what was sent, can make of a query.
//!
//! - [`train`]: a U-Net, or three in a row ([`Form`]), learn from images of elsewhere; equal seeds give equal networks, whatever the number of threads, and
//!   an interrupted training goes on as if it had not been.
//! - [`Inverter`]: the network, from descriptors and what is known of their places to an image. Places may be those of the
//!   keypoints (the paper's upper bound), those an attack recovered, lines as they were sent, or nothing at all ([`Sees`]).
//! - [`evaluation`]: the paper's Table 1 and more, image by image, with contact sheets.
//!
//! How well it does is measured on images of places it never saw: `docs/inversion.md`.
#![forbid(unsafe_code)]

mod document;
pub mod evaluation;
mod example;
mod inverter;
mod loss;
mod network;
mod pixels;
mod places;
mod read;
mod task;
mod training;

pub use document::{CurveRow, InversionDocument, inversion_table};
pub use example::Example;
pub use inverter::{Inverter, Known};
pub use network::{Form, Grid, Sees, Shape};
pub use read::{read_examples, refuse_shared};
pub use task::InversionTask;
pub use training::train;
/// Who judges images: what an [`evaluation`] takes.
pub mod judges {
    pub use veiloc_attacks::image_metrics::{FeatureDistance, Lpips, LpipsNetwork};
    pub use veiloc_features::detector::Detector;
}

pub use veiloc_attacks::training::{Course, CurvePoint, Progress, Trained, TrainingState};
