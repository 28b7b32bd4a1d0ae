//! What speaks against a fit to known positions.

use std::fmt;

/// A reason not to believe an alignment.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum AlignmentFault {
    /// The scale is hardly known.
    Scale {
        /// Relative standard deviation.
        sd: f64,
    },
    /// Up by the positions is not up by the map: its gravity, or the horizon of its images.
    Up {
        /// Angle between them, degrees.
        angle_deg: f64,
    },
    /// Most positions repeat others.
    Repeated {
        /// How many do.
        repeated: usize,
        /// Of how many.
        all: usize,
    },
    /// Less than half of the positions agree.
    FewAgree {
        /// How many do.
        used: usize,
        /// Of how many.
        all: usize,
    },
    /// The positions that agree are in one part of the map.
    Part {
        /// Their spread, of that of all.
        share: f64,
    },
    /// The distances are large for the extent of the positions.
    Distances {
        /// Root mean square distance, new units.
        rms: f64,
        /// Extent of the positions that were used, new units.
        extent: f64,
    },
    /// The list of positions fits better when it is shifted against its names.
    Shifted {
        /// By how many lines.
        lines: isize,
        /// Root mean square distance then, of the present one.
        share: f64,
    },
    /// The mirrored positions fit better.
    Mirrored {
        /// Root mean square distance then, of the present one.
        share: f64,
    },
    /// Heights are of two kinds.
    Heights {
        /// Distance of their middles, new units.
        apart: f64,
    },
    /// What the images see is at a distance at which nothing can be seen, if the new unit is the metre.
    Metres {
        /// Median distance, metres.
        distance: f64,
    },
}

impl fmt::Display for AlignmentFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Scale { sd } => write!(
                f,
                "the scale is known to ± {:.0} % only: the positions are too inaccurate for a place of this size",
                100.0 * sd
            ),
            Self::Up { angle_deg } => write!(
                f,
                "up by the positions is {angle_deg:.0}° from up by the images; check heights, axes and the order of the \
                 numbers (--known-down names another direction of gravity in the axes of the positions)"
            ),
            Self::Repeated { repeated, all } => write!(
                f,
                "{repeated} of {all} positions repeat others although the images are apart: the receiver had no new fix"
            ),
            Self::FewAgree { used, all } => write!(f, "only {used} of {all} positions agree"),
            Self::Part { share } => write!(
                f,
                "the positions that agree span only {:.0} % of what all images with positions span",
                100.0 * share
            ),
            Self::Distances { rms, extent } => write!(
                f,
                "the distances are {rms:.3} in the root mean square, and all positions are within {extent:.3}"
            ),
            Self::Shifted { lines, share } => write!(
                f,
                "the list fits better when it is shifted by {lines} lines against its names: the distances are then {:.0} % \
                 of the present ones",
                100.0 * share
            ),
            Self::Mirrored { share } => write!(
                f,
                "the mirrored positions fit better, with {:.0} % of the distances: their axes are left-handed; swap two, or \
                 change the sign of one",
                100.0 * share
            ),
            Self::Heights { apart } => write!(
                f,
                "the heights are of two kinds, {apart:.1} apart, such as over the sea and over the ground; give one kind"
            ),
            Self::Metres { distance } if *distance < 1.0 => write!(
                f,
                "what the images see would be {distance:.2e} metres away; are the positions degrees, or not in metres?"
            ),
            Self::Metres { distance } => write!(
                f,
                "what the images see would be {distance:.0} metres away; are the positions in millimetres?"
            ),
        }
    }
}
