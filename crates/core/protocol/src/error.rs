//! Why a sealed query or a profile was rejected, and what to do about it.

/// What is wrong with a sealed query, a profile, a scheme's text or a camera. Contains no query content.
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
        /// Number of bytes.
        bytes: usize,
        /// Maximum number of bytes.
        limit: usize,
    },
    /// Not a protobuf message.
    #[error(
        "these bytes are not a {what} ({reason}); the file may be truncated or of another kind: seal it anew"
    )]
    Malformed {
        /// `sealed query` or `profile`.
        what: &'static str,
        /// The message of the decoder.
        reason: String,
    },
    /// A version that this program does not read.
    #[error("the {what} has version {found}, but this program reads version {supported}; {remedy}")]
    Version {
        /// `sealed query`, `profile` or `answer`.
        what: &'static str,
        /// The version of the message.
        found: u32,
        /// The version that this program reads.
        supported: u32,
        /// What to do.
        remedy: &'static str,
    },
    /// A required field is missing.
    #[error("field {field} is missing; the file may be truncated or of another kind: seal it anew")]
    Missing {
        /// Its name in the schema.
        field: &'static str,
    },
    /// A value that the field cannot have.
    #[error("{field} is {value}, but must be {allowed}")]
    Field {
        /// Its name in the schema.
        field: &'static str,
        /// The value.
        value: u32,
        /// The allowed values.
        allowed: &'static str,
    },
    /// A byte field whose length does not follow from the other fields.
    #[error(
        "{field} holds {actual} bytes instead of {expected}; the message was damaged: send it again as sealed"
    )]
    Length {
        /// Its name in the schema.
        field: &'static str,
        /// The length that follows from the other fields.
        expected: usize,
        /// The actual length.
        actual: usize,
    },
    /// A row that no keypoint of the image can produce.
    #[error("row {row} lies outside the image; the message was damaged or made by a faulty client")]
    Row {
        /// Its index.
        row: usize,
    },
    /// Readable, but not canonical: unknown fields, another order, trailing data.
    #[error(
        "the {what} is not in canonical form (unknown or repeated fields, or extra bytes); send the bytes as they were \
         written"
    )]
    NotCanonical {
        /// `sealed query` or `profile`.
        what: &'static str,
    },
    /// Invalid bytes of the global descriptor or vocabulary.
    #[error("the {what} is damaged: {reason}")]
    Descriptor {
        /// Which part, by its name in the schema.
        what: &'static str,
        /// The message of the descriptor crate.
        reason: String,
    },
    /// Parts that do not fit together were given to a constructor.
    #[error("{what}: {expected} expected, {actual} given")]
    Mismatch {
        /// Which part.
        what: &'static str,
        /// The value that the profile or the other parts require.
        expected: String,
        /// The given value.
        actual: String,
    },
    /// The query was sealed for another map.
    #[error("sealed with profile {query}, but the map has profile {map}")]
    WrongProfile {
        /// The query's.
        query: crate::ProfileId,
        /// The map's.
        map: crate::ProfileId,
    },
    /// The query was sealed with another pack.
    #[error("sealed with pack {query}, but the map has pack {map}")]
    WrongPack {
        /// The query's.
        query: crate::PackId,
        /// The map's.
        map: crate::PackId,
    },
    /// Unknown scheme name.
    #[error(
        "{text:?} is not a scheme; use points, random-lines, coordinate-permutation, or dcl, \
         which may have `:horizontal`, `:angle=DEGREES` and `:s=NUMBER`, or a layout of sectors"
    )]
    SchemeSyntax {
        /// The given text, at most 80 characters.
        text: String,
    },
    /// Dividing line or anchor distance out of range.
    #[error("dividing line at {degrees}° with s = {s}: the angle must be in [0, 180), s from 0.1 to 20")]
    Layout {
        /// The given angle.
        degrees: f64,
        /// The given `s`.
        s: f64,
    },
    /// An invalid layout of sectors, or one that the wire format cannot express.
    #[error(
        "this is not a layout of dcl; write axis=DEGREES:sectors=COUNT:anchors=X/Y+X/Y: COUNT a multiple of the number of \
         anchors and at most 120, two to four anchors at most 20 image heights from the centre, or @DEGREES for one at infinity; \
         shift=SHARE of a sector, from 0 to below 1, and across=DEGREES/COUNT/SHARE may be added"
    )]
    SectorLayout,
    /// An invalid gravity direction, or one whose standard deviation is too large.
    #[error(
        "gravity is X,Y,Z or X,Y,Z,SD_DEG: the direction in which things fall, in the camera's axes, of any length but \
         zero, and its standard deviation, above 0 and at most 16 degrees"
    )]
    Gravity,
    /// A position hint with invalid numbers.
    #[error("a position is X,Y,Z,SD: four finite numbers in map units, the standard deviation SD above 0")]
    PositionHint,
    /// A camera that does not show what is straight ahead of it.
    #[error("the optical axis is not in the image; check the principal point, or cut the image around it")]
    OpticalAxis,
    /// Not the id of a profile or pack.
    #[error("{text:?} is not the id of a profile or pack, which has 32 hexadecimal digits")]
    MessageId {
        /// The given text.
        text: String,
    },
    /// A focal length outside of the allowed range.
    #[error("a focal length of {focal} px is not between 16 and 32768; check the camera parameters")]
    Focal {
        /// Mean focal length of the device, pixels.
        focal: f64,
    },
    /// The undistorted image is too large.
    #[error(
        "without distortion the image would be {width} × {height} px, at most 8192 × 8192 are possible; \
         check the camera parameters, or extract from a smaller image"
    )]
    ImageSize {
        /// Required width, pixels.
        width: f64,
        /// Required height, pixels.
        height: f64,
    },
}

impl QueryError {
    /// The message without any value of the query or profile: a server may send it to the client and may log it (rules
    /// L8, L12). It names fields, their allowed values, and the remedy.
    pub fn without_values(&self) -> String {
        let text = match self {
            Self::TooLong { what, limit, .. } => {
                return format!(
                    "more bytes than a {what} can have ({limit}); send the bytes exactly as they were sealed"
                );
            }
            Self::Malformed { what, .. } => {
                return format!(
                    "these bytes are not a {what}; they may be truncated or of another kind: seal it anew"
                );
            }
            Self::Version { what, supported, remedy, .. } => {
                return format!("a {what} of an unknown version; version {supported} is read: {remedy}");
            }
            Self::Field { field, allowed, .. } => return format!("{field} must be {allowed}"),
            Self::Length { field, .. } => {
                return format!(
                    "the length of {field} does not match the other fields: send it again as sealed"
                );
            }
            Self::Descriptor { what, .. } => return format!("the {what} is damaged"),
            Self::Mismatch { what, .. } => return format!("{what}: not what the map requires"),
            // These contain only names.
            Self::Missing { .. } | Self::NotCanonical { .. } => return self.to_string(),
            Self::Row { .. } => {
                "a row lies outside the image; the message was damaged or made by a faulty client"
            }
            Self::WrongProfile { .. } => {
                "sealed with another profile than the map's; fetch the profile of this map and seal again"
            }
            Self::WrongPack { .. } => {
                "sealed with another pack than the map's; fetch the pack of this map and seal another image"
            }
            Self::SchemeSyntax { .. } => "unknown scheme",
            Self::MessageId { .. } => "not the id of a profile or pack",
            Self::PositionHint | Self::Gravity | Self::SectorLayout | Self::OpticalAxis => {
                return self.to_string();
            }
            Self::Layout { .. } => "dividing line or anchor distance out of range",
            Self::Focal { .. } => "a focal length that is not between 16 and 32768 pixels",
            Self::ImageSize { .. } => "an image larger than 8192 x 8192 pixels once its distortion is undone",
        };
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ProfileId;

    #[test]
    fn messages_without_values_contain_none() {
        let number = 987_654;
        let text = || "SECRET".to_owned();
        let (query, map) = (ProfileId::from_bytes([0xAB; 16]), ProfileId::from_bytes([0xCD; 16]));
        let all = [
            QueryError::TooLong { what: "sealed query", bytes: number, limit: 5 },
            QueryError::Malformed { what: "profile", reason: text() },
            QueryError::Version {
                what: "profile",
                found: number as u32,
                supported: 1,
                remedy: "update the app",
            },
            QueryError::Missing { field: "rows" },
            QueryError::Field { field: "rows", value: number as u32, allowed: "256" },
            QueryError::Length { field: "global", expected: number, actual: number },
            QueryError::Row { row: number },
            QueryError::NotCanonical { what: "profile" },
            QueryError::Descriptor { what: "vocabulary", reason: text() },
            QueryError::Mismatch { what: "rows", expected: text(), actual: text() },
            QueryError::WrongProfile { query, map },
            QueryError::WrongPack { query, map },
            QueryError::SchemeSyntax { text: text() },
            QueryError::Layout { degrees: 987_654.0, s: 987_654.0 },
            QueryError::PositionHint,
            QueryError::Gravity,
            QueryError::OpticalAxis,
            QueryError::MessageId { text: text() },
            QueryError::Focal { focal: 987_654.0 },
            QueryError::ImageSize { width: 987_654.0, height: 987_654.0 },
        ];
        for error in all {
            let (redacted, full) = (error.without_values(), error.to_string());
            for value in ["987", "SECRET", "abab", "cdcd"] {
                assert!(!redacted.contains(value), "{redacted}");
            }
            assert!(redacted.len() > 10, "{full}: says nothing");
        }
    }
}
