//! What is learned.
use crate::EvalError;
use crate::inversion::network::{Form, Sees, Shape};
use veiloc_attacks::AttackError;
use veiloc_protocol::{AngleBits, Scheme};

/// Percent of descriptors that at most stand in wrong places where a network is to learn which do.
const WRONG: u8 = 60;

/// What is learned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct InversionTask {
    /// The network.
    pub shape: Shape,
    /// Under which images are sent; of a network that sees no lines, [`Scheme::Points`].
    pub scheme: Scheme,
    /// Bits of a line's angle, as devices send them.
    pub angle_bits: AngleBits,
    /// Of the descriptors of an image at most so many percent stand in wrong places while it is learned from.
    wrong: u8,
}

impl InversionTask {
    /// Of a network of this shape; `scheme` for one that sees lines. More than half of the descriptors may stand in wrong places where the
    /// network is to learn which do, none otherwise ([`Self::with_wrong`]).
    ///
    /// # Errors
    /// [`EvalError::Attack`] for a shape that cannot be, [`EvalError::Scheme`] for lines without a scheme that
    /// sends some, and for a scheme without lines, [`EvalError::NoPlaces`] for stages that judge places where none are
    /// given.
    pub fn new(shape: Shape, scheme: Option<Scheme>) -> Result<Self, EvalError> {
        shape.check()?;
        if shape.form == Form::InvSfm && shape.sees != Sees::Places {
            return Err(EvalError::NoPlaces { sees: shape.sees.name() });
        }
        let angle_bits = AngleBits::default();
        let wrong = if shape.form == Form::InvSfm { WRONG } else { 0 };
        match (shape.sees, scheme) {
            (Sees::Lines, Some(scheme)) if scheme.hides_positions() => {
                Ok(Self { shape, scheme, angle_bits, wrong })
            }
            (Sees::Lines, scheme) => Err(EvalError::Scheme {
                found: scheme.map_or("no scheme".to_owned(), |s| s.to_string()),
                expected: "a network that sees lines needs a scheme that sends lines",
            }),
            (Sees::Places | Sees::Bag, None) => Ok(Self { shape, scheme: Scheme::Points, angle_bits, wrong }),
            (Sees::Places | Sees::Bag, Some(scheme)) => Err(EvalError::Scheme {
                found: scheme.to_string(),
                expected: "only a network that sees lines learns under a scheme",
            }),
        }
    }

    /// With at most so many percent of an image's descriptors in wrong places while it is learned from.
    ///
    /// # Errors
    /// [`EvalError::Attack`] for more than 90 percent, [`EvalError::NoPlaces`] for wrong places of a network that is
    /// given none.
    pub fn with_wrong(self, percent: u8) -> Result<Self, EvalError> {
        if percent > 90 {
            return Err(AttackError::refuse("wrong", usize::from(percent), "from 0 to 90 percent").into());
        }
        if percent > 0 && self.shape.sees != Sees::Places {
            return Err(EvalError::NoPlaces { sees: self.shape.sees.name() });
        }
        Ok(Self { wrong: percent, ..self })
    }

    /// Of the descriptors of an image at most so many percent stand in wrong places while it is learned from.
    pub fn wrong_percent(&self) -> u8 {
        self.wrong
    }

    /// The same as a share.
    pub(crate) fn most_wrong(&self) -> f64 {
        f64::from(self.wrong) / 100.0
    }
}
