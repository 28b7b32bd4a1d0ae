//! Documents to pages and plots. Nothing here measures, attacks or localizes.
//!
//! - [`run_page`] turns a [`RunReport`] into one HTML file: what became of the queries of a run, under each scheme, one by one,
//!   and in the place, which is turned in the browser.
//! - [`html`] does so for the demo ([`Report`]), stage by stage, with what leaked.
//! - [`audit_page`] does so for an audit ([`veiloc_evaluation::audit::Audit`]).
//! - [`inversion_page`] does so for images that were made of descriptors ([`InversionReport`]).
//! - [`map_picture`]: a map from above as one small drawing.
//! - [`plots`]: documents of evaluations as SVG.
//!
//! Whoever measured fills plain data; images, lines and what agrees with a pose are in no document and come from whoever
//! localizes, on request. A page loads nothing from anywhere: no scripts, fonts or images but those inside, which its own
//! policy holds it to. It follows the reader's light or dark setting, prints, fits a telephone, and says without scripts
//! what it says with them. Captions speak to people who never heard of keypoints.
#![forbid(unsafe_code)]

mod attacked;
mod audit;
mod card;
mod data;
mod embed;
mod format;
mod histogram;
mod inversion;
mod map_picture;
mod page;
pub mod plots;
mod run;
mod sent;
mod shell;
mod space;
mod tables;
mod top_view;
mod undistort;

#[cfg(test)]
mod tests;

pub use audit::audit_page;
pub use card::Card;
pub use data::{AttackedBy, AttackedScheme, Report, SeenQuery};
pub use inversion::{InversionReport, InversionRow, InversionSheet, SheetImage, SheetTile, inversion_page};
pub use map_picture::map_picture;
pub use page::html;
pub use run::{
    PlaceView, QueryDrawing, QueryOutcome, RowState, RunFigure, RunReport, RunRow, SentDrawing, run_page,
    worst_first,
};
pub use undistort::undistorted;
