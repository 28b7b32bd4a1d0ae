//! Images from descriptors: what whoever has keypoints, or only what was sent, can make of a query. The paper's Table 1 and more:
//! image → keypoints → scheme → attack → network → image → how alike it is to the first.
//!
//! What is put through the network, beside what the paper puts there (keypoints themselves, and the closed form with true
//! neighbours):
//! - the graph attack with true neighbours, and the best attack of those who are told nothing ([`Realistic`]);
//! - the guess from the single line, and the line itself, each descriptor spread over it;
//! - descriptors in a bag, and nothing at all: what the network answers that was given no descriptor. A score says something
//!   about leaks only beside that of nothing.
//!
//! The network is trained in PyTorch (`research/train`) on images of places that are not judged: `docs/results/privacy.md`.

mod attacked;
mod beliefs;
mod document;
mod judges;
mod pixels;
mod run;
mod sheet;

pub use attacked::Realistic;
pub use document::{ClassesRow, EvaluationDocument, NetworkRow, RebuiltRow, SummaryRow, evaluation_table};
pub use judges::{Judges, Scores};
pub use run::{InversionEvaluation, evaluate_inversion};
pub use sheet::{Sheet, Tile};

pub use veiloc_attacks::image_metrics::{Classifier, PerceptualDistance};
pub use veiloc_attacks::learned::inversion::InversionNetwork;
pub use veiloc_features::detector::Detector;
