//! HTML pages about evaluations, made of the parts of `veiloc_report`.
//!
//! - [`demo_page`]: a query stage by stage, and what attackers recover ([`DemoReport`]).
//! - [`audit_page`]: what attackers recover from sealed queries ([`crate::attack_evaluation::Audit`]).
//! - [`inversion_page`]: images reconstructed from descriptors.
//! - [`add_scene`], [`query_drawing`]: fill a page of localized queries from an evaluation.

mod attack_figures;
mod attacks;
mod audit;
mod demo;
mod fill;
mod inversion;

#[cfg(test)]
mod tests;

pub use audit::audit_page;
pub use demo::{DemoReport, DeviceQuery, demo_page};
pub use fill::{add_scene, query_drawing};
pub use inversion::inversion_page;
