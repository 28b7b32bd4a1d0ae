//! Internal: self-contained HTML pages for the operator of a map.
//!
//! This crate only presents results; it does not measure or localize.
//!
//! - [`localization_page`]: localized queries ([`LocalizationReport`]): tables, the scene in 3D, single queries; also a map with its
//!   weak parts ([`HeatMap`]).
//! - [`map_picture`]: a small drawing of a map from above.
//! - [`page`], [`table`], [`drawing`], [`images`], [`numbers`]: the parts of which other pages are made; those of attacks are in
//!   `veiloc_evaluation::report`.
//!
//! A page loads no external resource: scripts, fonts and images are embedded, and its content security policy forbids
//! others. Templates are compiled and escape all text (`maud`). A page follows the reader's light or dark setting,
//! can be printed, fits a phone, and shows its tables and drawings without scripts too.
#![forbid(unsafe_code)]

pub mod drawing;
mod heat;
pub mod images;
pub mod localization;
pub mod numbers;
pub mod page;
mod scene;
mod space;
pub mod table;
mod top_view;

pub use heat::{HeatCell, HeatMap};
pub use localization::{
    LocalizationReport, Method, MethodFigures, QueryDrawing, localization_page, worst_first,
};
pub use numbers::{LengthUnit, significant};
pub use page::Card;
pub use scene::{MatchState, QueryOutcome, SceneView, SentDrawing};
pub use top_view::map_picture;
