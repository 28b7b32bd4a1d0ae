//! Images from descriptors: what an attacker can reconstruct from a query with keypoints, or from the sent query
//! alone. The paper's Tables 2 and 7, and more: image → keypoints → scheme → attack → network → image → similarity to the
//! original.
//!
//! The inputs of the network are those of the paper (true keypoints, and the closed form with true neighbours) and:
//! - the graph attack with true neighbours, and the best attack without an oracle ([`InversionEvaluation`]);
//! - what a server that knows the pose has without an attack, and what its attacks recover (the paper's Figs. 7 and 8);
//! - the prior-only baseline, and the line itself, with each descriptor spread over it;
//! - descriptors without positions, and no descriptors at all: the network's output without input. A score shows a
//!   leak only by comparison with this output.
//!
//! The network is trained in PyTorch (`research/train`) on images of scenes that are not evaluated:
//! `docs/results/privacy.md`.

mod column;
mod contact_sheet;
mod document;
mod image_metrics;
mod pixels;
mod recovered;
mod run;
mod visibility;

pub use contact_sheet::{ContactSheet, Tile};
pub use document::{
    ClassesRow, InversionDocument, NetworkRow, ReconstructionRow, SummaryRow, evaluation_table,
};
pub use image_metrics::{ImageMetrics, ReconstructionScores};
pub use run::{InversionEvaluation, evaluate_inversion};

pub use veiloc_attacks::image_metrics::{Classifier, PerceptualDistance};
pub use veiloc_attacks::learned::inversion::InversionNetwork;
pub use veiloc_features::detector::Detector;
