//! Documents of evaluations as SVG.

mod bound;
mod errors;
mod layouts;
mod times;
mod training;

pub use bound::plot as bound;
pub use errors::{ErrorAxis, plot as errors};
pub use layouts::plot as layouts;
pub use times::plot as times;
pub use training::{course, plot as training, positions};

use plotters::style::RGBColor;

/// Distinct in print and for the colour-blind (Okabe and Ito).
pub(crate) const COLORS: [RGBColor; 4] =
    [RGBColor(0, 114, 178), RGBColor(230, 159, 0), RGBColor(0, 158, 115), RGBColor(204, 121, 167)];

/// Why a plot could not be drawn.
pub(crate) type Fault = Box<dyn std::error::Error + Send + Sync>;

/// The drawing's errors borrow nothing, but their type does not say so.
pub(crate) fn fault(error: impl std::fmt::Display) -> Fault {
    error.to_string().into()
}

/// Why a document could not be drawn.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PlotError {
    /// It holds nothing to draw.
    #[error("{0}")]
    Nothing(&'static str),
    /// The drawing failed.
    #[error("the plot could not be drawn: {0}")]
    Failed(String),
}
