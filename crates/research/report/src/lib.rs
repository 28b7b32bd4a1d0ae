//! Reports: each is one HTML page of the same type, and charts are SVG. Nothing here measures, attacks or localizes.
//!
//! - [`localization_page`]: localized queries ([`LocalizationReport`]): tables, the scene in 3D, single queries.
//! - [`demo_page`]: a query stage by stage, and what attackers recover ([`DemoReport`]).
//! - [`audit_page`]: what attackers recover from sealed queries ([`veiloc_evaluation::audit::Audit`]).
//! - [`inversion_page`]: images that networks make of descriptors.
//! - [`map_picture`]: a map from above as one small drawing.
//! - [`plots`]: documents of evaluations as charts.
//!
//! A page loads nothing: no scripts, fonts or images but those inside, and its content security policy forbids others. Templates
//! are compiled and escape all text (`maud`). A page follows the reader's light or dark setting, prints, fits a telephone, and
//! shows its tables and drawings without scripts too.
#![forbid(unsafe_code)]

mod attacks;
mod audit;
mod chart;
mod demo;
mod drawing;
mod images;
mod inversion;
mod localization;
mod numbers;
mod page;
pub mod plots;
mod space;
mod table;
mod top_view;

#[cfg(test)]
mod tests;

pub use audit::audit_page;
pub use demo::{DemoReport, SeenQuery, demo_page};
pub use inversion::inversion_page;
pub use localization::{
    LocalizationReport, MatchState, Method, QueryDrawing, QueryOutcome, SceneView, SentDrawing,
    localization_page, worst_first,
};
pub use numbers::{LengthUnit, significant};
pub use page::Card;
pub use top_view::map_picture;
