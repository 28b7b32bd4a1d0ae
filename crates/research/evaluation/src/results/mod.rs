//! Results of evaluations: figures, JSON documents and text tables.
//!
//! - [`EvaluationDocument`] and its parts: the document of `eval pose` and `eval scene`; [`summarize`], [`table()`].
//! - [`DataSetEvaluation`]: the same for the scenes of a data set.
//! - [`metrics`]: pose errors, recall, medians. [`coverage`]: coverage of covariances. [`chi_squared`].
//! - [`pose_lines`]: poses as lines of other programs' files (hloc, visuallocalization.net, TUM).
//! - [`text_table`]: tables that fit a terminal.
#![forbid(unsafe_code)]

pub mod chi_squared;
pub mod coverage;
mod data_set;
mod document;
pub mod metrics;
pub mod pose_lines;
pub mod state;
mod summary;
mod table;
pub mod text_table;
mod uncertainty;

pub use data_set::{DataSetEvaluation, RunInfo, SceneInfo, SceneQuery, SceneSummary};
pub use document::{
    EstimatorVariant, EvaluationDocument, LossStage, MapSummary, QueryResult, RegionsSummary, SchemeSummary,
    SeedSummary, SentDocument, SentSummary, SparseMap,
};
pub use summary::summarize;
pub use table::{STAGES, table};
pub use uncertainty::{QueryUncertainty, TrustedUncertainty};
