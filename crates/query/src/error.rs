//! Why a sealed query or a profile was refused, and what to do about it.

/// What is wrong with a sealed query, a profile, a scheme's text or a camera. Holds no query content.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum QueryError {
    /// More bytes than any message of this version has.
    #[error(
        "{bytes} bytes are more than a {what} can have ({limit}); send the bytes exactly as they were sealed"
    )]
    TooLong {
        /// `sealed query` or `profile`.
        what: &'static str,
        /// How many bytes there were.
        bytes: usize,
        /// How many there may be.
        limit: usize,
    },
    /// Not a protobuf message.
    #[error(
        "these bytes are not a {what} ({reason}); the file may be truncated or of another kind: seal it anew"
    )]
    Malformed {
        /// `sealed query` or `profile`.
        what: &'static str,
        /// What the decoder met.
        reason: String,
    },
    /// A version this program does not read.
    #[error("{what} of version {found}, but this program reads version {supported}; update the older side")]
    Version {
        /// `sealed query` or `profile`.
        what: &'static str,
        /// The version told.
        found: u32,
        /// The version read here.
        supported: u32,
    },
    /// A field that must be there is not.
    #[error("field {field} is missing; the file may be truncated or of another kind: seal it anew")]
    Missing {
        /// Its name in the schema.
        field: &'static str,
    },
    /// A number no such field can have.
    #[error("{field} is {value}, but must be {allowed}")]
    Field {
        /// Its name in the schema.
        field: &'static str,
        /// What it was.
        value: u32,
        /// What it may be.
        allowed: &'static str,
    },
    /// Bytes of a length that does not follow from the other fields.
    #[error(
        "{field} holds {actual} bytes instead of {expected}; the message was damaged: send it again as sealed"
    )]
    Length {
        /// Its name in the schema.
        field: &'static str,
        /// How many bytes the other fields ask for.
        expected: usize,
        /// How many there were.
        actual: usize,
    },
    /// A row that no keypoint of the image could have given.
    #[error("row {row} lies outside the image; the message was damaged or made by a faulty client")]
    Row {
        /// Its index.
        row: usize,
    },
    /// Readable, but not written as this version writes it: unknown fields, another order, trailing data.
    #[error(
        "the {what} is not in the one form this version allows (unknown or repeated fields, or extra bytes)"
    )]
    NotCanonical {
        /// `sealed query` or `profile`.
        what: &'static str,
    },
    /// Global descriptor or vocabulary bytes were refused.
    #[error("the {what} is damaged: {reason}")]
    Descriptor {
        /// `global descriptor` or `vocabulary`.
        what: &'static str,
        /// What the descriptor room said.
        reason: String,
    },
    /// Parts that do not belong together were given to a constructor.
    #[error("{what}: {expected} expected, {actual} given")]
    Mismatch {
        /// Which part.
        what: &'static str,
        /// What the profile or the other parts ask for.
        expected: String,
        /// What was given.
        actual: String,
    },
    /// The query was sealed for another map.
    #[error(
        "sealed with profile {query}, but the map has profile {map}; seal with `veiloc map profile` of this map"
    )]
    WrongProfile {
        /// The query's.
        query: crate::ProfileId,
        /// The map's.
        map: crate::ProfileId,
    },
    /// Unknown scheme name.
    #[error(
        "{text:?} is no scheme; use points, random-lines, coordinate-permutation, or dcl, \
         which may have `:horizontal`, `:angle=DEGREES` and `,s=NUMBER`"
    )]
    SchemeSyntax {
        /// What was given, at most 80 characters.
        text: String,
    },
    /// Dividing line or anchor distance out of range.
    #[error("dividing line at {degrees}° with s = {s}: the angle must be in [0, 180), s from 0.1 to 20")]
    Layout {
        /// Degrees given.
        degrees: f64,
        /// `s` given.
        s: f64,
    },
    /// A focal length beyond the ladder.
    #[error("a focal length of {focal} px is not between 16 and 32768; check the camera parameters")]
    Focal {
        /// Mean focal length of the device, pixels.
        focal: f64,
    },
    /// An image too large once its distortion is undone.
    #[error(
        "without distortion the image would be {width} × {height} px, at most 8192 × 8192 are possible; \
         check the camera parameters, or extract from a smaller image"
    )]
    ImageSize {
        /// Width that would be needed, pixels.
        width: f64,
        /// Height that would be needed, pixels.
        height: f64,
    },
}
