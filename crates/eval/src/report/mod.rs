//! One self-contained HTML file that shows what was localized and what leaked.

mod data;

pub use data::{AttackRow, Card, PRIOR_ONLY, QueryPanel, Report, SchemePanel, TopView, TopViewScheme};

/// The page: one HTML document that loads nothing from anywhere.
pub fn html(report: &Report) -> String {
    format!("<!doctype html><title>{}</title>", report.title)
}
