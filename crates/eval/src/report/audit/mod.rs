//! The report of `veiloc audit`: what attackers get out of what is sent, for operators, developers and reviewers.
//!
//! [`run_audit`] attacks and hands back the figures as a document and as one HTML page that loads nothing. All that the
//! page says in words is decided by the figures ([`conclusion`]).

mod cdf;
mod collage;
mod conclusion;
mod curve;
mod figures;
mod gallery;
mod page;
mod panels;
mod run;
mod table;
mod verdict;
mod words;

#[cfg(test)]
mod tests;

pub use run::{Audit, AuditDocument, AuditOptions, AuditPart, run_audit};
