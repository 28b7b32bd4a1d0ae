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
    #[error("{what} of version {found}, but this program reads version {supported}; {remedy}")]
    Version {
        /// `sealed query`, `profile` or `answer`.
        what: &'static str,
        /// The version told.
        found: u32,
        /// The one read here.
        supported: u32,
        /// What to do.
        remedy: &'static str,
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
    /// Readable, but not written as it is written here: unknown fields, another order, trailing data.
    #[error("the {what} is not in the one form that is allowed (unknown or repeated fields, or extra bytes)")]
    NotCanonical {
        /// `sealed query` or `profile`.
        what: &'static str,
    },
    /// Global descriptor or vocabulary bytes were refused.
    #[error("the {what} is damaged: {reason}")]
    Descriptor {
        /// Which part, by its name in the schema.
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
         which may have `:horizontal`, `:angle=DEGREES` and `:s=NUMBER`, or a layout of sectors"
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
    /// A layout of sectors that is none, or that the wire cannot tell.
    #[error(
        "this is no layout of dcl; write axis=DEGREES:sectors=COUNT:anchors=X/Y+X/Y: COUNT a multiple of the number of anchors \
         and at most 120, two to four anchors at most 20 image heights from the centre, or @DEGREES for one at infinity; \
         shift=SHARE of a sector, from 0 to below 1, and across=DEGREES/COUNT/SHARE may be added"
    )]
    SectorLayout,
    /// A direction of gravity that is none, or one known too badly to be told.
    #[error(
        "gravity is X,Y,Z or X,Y,Z,SD_DEG: the direction in which things fall in the camera's axes, of any length but zero, \
         and its standard deviation, above 0 and at most 16 degrees"
    )]
    Gravity,
    /// Where a camera is said to be, in numbers that are no place.
    #[error("a place is X,Y,Z,SD: four finite numbers in map units, the standard deviation SD above 0")]
    PositionHint,
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

impl QueryError {
    /// The message without any value of the query or profile it is about: what a server may say to whoever sent it,
    /// and may log (rules L8, L12). Names of fields, what they may be, and what to do.
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
                    "{field} has not the length that the other fields ask for: send it again as sealed"
                );
            }
            Self::Descriptor { what, .. } => return format!("the {what} is damaged"),
            Self::Mismatch { what, .. } => return format!("{what}: not what the map asks for"),
            // Names only.
            Self::Missing { .. } | Self::NotCanonical { .. } => return self.to_string(),
            Self::Row { .. } => {
                "a row lies outside the image; the message was damaged or made by a faulty client"
            }
            Self::WrongProfile { .. } => {
                "sealed with another profile than the map's; get the profile of this map and seal anew"
            }
            Self::SchemeSyntax { .. } => "no such scheme",
            Self::PositionHint | Self::Gravity | Self::SectorLayout => return self.to_string(),
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
    fn no_value_is_told() {
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
            QueryError::SchemeSyntax { text: text() },
            QueryError::Layout { degrees: 987_654.0, s: 987_654.0 },
            QueryError::PositionHint,
            QueryError::Gravity,
            QueryError::Focal { focal: 987_654.0 },
            QueryError::ImageSize { width: 987_654.0, height: 987_654.0 },
        ];
        for error in all {
            let (told, full) = (error.without_values(), error.to_string());
            for value in ["987", "SECRET", "abab", "cdcd"] {
                assert!(!told.contains(value), "{told}");
            }
            assert!(told.len() > 10, "{full}: says nothing");
        }
    }
}
