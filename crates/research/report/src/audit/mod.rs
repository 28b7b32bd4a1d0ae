//! The page of `veiloc audit`: what attackers get out of what is sent, for operators, developers and reviewers.
//!
//! All that the page says in words is decided by the figures ([`veiloc_evaluation::audit::conclusion`]).

mod cdf;
mod collage;
mod curve;
mod figures;
mod page;
mod palette;
mod panels;
mod sentences;
mod table;

#[cfg(test)]
mod tests;

pub use page::audit_page;
