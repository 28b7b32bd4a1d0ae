//! Documents to pages and plots. Nothing here measures, attacks or localizes.
//!
//! - [`html`] turns a [`Report`] into one HTML file that shows what was localized and what leaked.
//! - [`audit_page`] does so for an audit ([`veiloc_audit::Audit`]).
//! - [`plots`]: documents of evaluations as SVG.
//!
//! Whoever measured fills plain data. A page loads nothing from anywhere: no scripts, fonts or images but those inside. It
//! follows the reader's light or dark setting, prints, and fits a telephone. Captions speak to people who never heard of
//! keypoints.
#![forbid(unsafe_code)]

mod audit;
mod data;
mod embed;
mod format;
mod histogram;
mod page;
pub mod plots;
mod query_figures;
mod tables;
mod top_view;

#[cfg(test)]
mod tests;

pub use audit::audit_page;
pub use data::{Card, QueryPanel, Report, SchemePanel, TopView, TopViewScheme};
pub use page::html;
