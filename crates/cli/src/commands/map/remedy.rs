//! What the user can do about errors of mapping.

use veiloc_mapping::MappingError;

use crate::commands::coordinate_frame_check::REMEDY_OF_LOOK_ALIKES;
use crate::output::exit::Failure;

/// The remedies for a refused coordinate frame.
const REMEDY: &str = "give poses in one coordinate frame, or transform those of the named images with --align; if \
                                 they are of another place that only looks alike, use --no-coordinate-frame-check";

/// The remedies for a model with a group of images in another coordinate frame.
pub(super) const REMEDY_OF_IMPORT: &str = "build the map with map build --align, which transforms the named images and \
                                           triangulates the points anew; if they are of another place that only \
                                           looks alike, use --no-coordinate-frame-check";

/// Adds the flags that are the remedy, which the library does not know, to the error.
pub(super) fn with_remedy(error: MappingError) -> Failure {
    match error {
        MappingError::BadImages(_) => Failure::with_help(
            error,
            "repair them, remove them from the list, or leave them out with --skip-bad",
        ),
        MappingError::OtherCoordinateFrame { .. } => Failure::with_help(error, REMEDY),
        MappingError::NameInBothMaps { .. } => {
            Failure::with_help(error, "give one with --prefix, for example day-2/")
        }
        MappingError::PosesDisagree { .. } => Failure::with_help(error, REMEDY_OF_LOOK_ALIKES),
        error => error.into(),
    }
}
