//! What is learned.

use veiloc_query::{AngleBits, Scheme};

use crate::error::InversionError;
use crate::network::{Sees, Shape};

/// What is learned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct InversionTask {
    /// The network.
    pub shape: Shape,
    /// Under which images are sent; of a network that sees no lines, [`Scheme::Points`].
    pub scheme: Scheme,
    /// Bits of a line's angle, as devices send them.
    pub angle_bits: AngleBits,
}

impl InversionTask {
    /// Of a network of this shape; `scheme` for one that sees lines.
    ///
    /// # Errors
    /// [`InversionError::Training`] for a shape that cannot be, [`InversionError::Scheme`] for lines without a scheme that
    /// sends some, and for a scheme without lines.
    pub fn new(shape: Shape, scheme: Option<Scheme>) -> Result<Self, InversionError> {
        shape.check()?;
        let angle_bits = AngleBits::default();
        match (shape.sees, scheme) {
            (Sees::Lines, Some(scheme)) if scheme.hides_positions() => Ok(Self { shape, scheme, angle_bits }),
            (Sees::Lines, scheme) => Err(InversionError::Scheme {
                found: scheme.map_or("no scheme".to_owned(), |s| s.to_string()),
                expected: "a network that sees lines needs a scheme that sends lines",
            }),
            (Sees::Places | Sees::Bag, None) => Ok(Self { shape, scheme: Scheme::Points, angle_bits }),
            (Sees::Places | Sees::Bag, Some(scheme)) => Err(InversionError::Scheme {
                found: scheme.to_string(),
                expected: "only a network that sees lines learns under a scheme",
            }),
        }
    }
}
