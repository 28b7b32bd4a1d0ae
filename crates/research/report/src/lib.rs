//! Internal: reports as self-contained HTML pages.
//!
//! This crate only presents results; it does not measure, attack or localize.
//!
//! - [`localization_page`]: localized queries ([`LocalizationReport`]): tables, the scene in 3D, single queries.
//! - [`demo_page`]: a query stage by stage, and what attackers recover ([`DemoReport`]).
//! - [`audit_page`]: what attackers recover from sealed queries ([`veiloc_evaluation::attack_evaluation::Audit`]).
//! - [`inversion_page`]: images reconstructed from descriptors.
//! - [`map_picture`]: a small drawing of a map from above.
//!
//! A page loads no external resource: scripts, fonts and images are embedded, and its content security policy forbids
//! others. Templates are compiled and escape all text (`maud`). A page follows the reader's light or dark setting,
//! can be printed, fits a phone, and shows its tables and drawings without scripts too.
#![forbid(unsafe_code)]

mod attacks;
mod audit;
mod demo;
mod drawing;
mod heat;
mod images;
mod inversion;
mod localization;
mod numbers;
mod page;
mod scene;
mod space;
mod table;
mod top_view;

#[cfg(test)]
mod tests;

pub use audit::audit_page;
pub use demo::{DemoReport, DeviceQuery, demo_page};
pub use heat::{HeatCell, HeatMap};
pub use inversion::inversion_page;
pub use localization::{LocalizationReport, Method, QueryDrawing, localization_page, worst_first};
pub use numbers::{LengthUnit, significant};
pub use page::Card;
pub use scene::{MatchState, QueryOutcome, SceneView, SentDrawing};
pub use top_view::map_picture;
