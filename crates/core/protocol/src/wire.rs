//! The messages, field by field as in `proto/veiloc/` (a test compares them).

use prost::Message;

use veiloc_descriptor::{DescriptorError, DescriptorKind, Encoding};

use crate::QueryError;

/// The beginning of all messages.
#[derive(Clone, PartialEq, Message)]
pub(crate) struct VersionMessage {
    #[prost(fixed32, optional, tag = "1")]
    pub version: Option<u32>,
}

#[derive(Clone, PartialEq, Message)]
#[prost(skip_debug)]
pub(crate) struct SealedQueryMessage {
    #[prost(fixed32, optional, tag = "1")]
    pub version: Option<u32>,
    #[prost(bytes = "vec", optional, tag = "2")]
    pub profile_id: Option<Vec<u8>>,
    #[prost(fixed32, optional, tag = "3")]
    pub scheme: Option<u32>,
    #[prost(fixed32, optional, tag = "4")]
    pub dividing_angle: Option<u32>,
    #[prost(fixed32, optional, tag = "5")]
    pub anchor_distance: Option<u32>,
    #[prost(fixed32, optional, tag = "6")]
    pub angle_bits: Option<u32>,
    #[prost(fixed32, optional, tag = "7")]
    pub camera_focal: Option<u32>,
    #[prost(fixed32, optional, tag = "8")]
    pub camera_width: Option<u32>,
    #[prost(fixed32, optional, tag = "9")]
    pub camera_height: Option<u32>,
    #[prost(fixed32, optional, tag = "10")]
    pub rows: Option<u32>,
    #[prost(string, optional, tag = "11")]
    pub descriptor_name: Option<String>,
    #[prost(fixed32, optional, tag = "12")]
    pub descriptor_dim: Option<u32>,
    #[prost(fixed32, optional, tag = "13")]
    pub descriptor_encoding: Option<u32>,
    #[prost(fixed32, optional, tag = "14")]
    pub descriptor_norm: Option<u32>,
    #[prost(bytes = "vec", optional, tag = "15")]
    pub positions: Option<Vec<u8>>,
    #[prost(bytes = "vec", optional, tag = "16")]
    pub descriptors: Option<Vec<u8>>,
    #[prost(bytes = "vec", optional, tag = "17")]
    pub global: Option<Vec<u8>>,
    #[prost(fixed32, optional, tag = "18")]
    pub focal_known: Option<u32>,
    #[prost(fixed32, optional, tag = "19")]
    pub gravity: Option<u32>,
    #[prost(bytes = "vec", optional, tag = "20")]
    pub layout: Option<Vec<u8>>,
    #[prost(fixed32, optional, tag = "21")]
    pub turn_x: Option<u32>,
    #[prost(fixed32, optional, tag = "22")]
    pub turn_y: Option<u32>,
    #[prost(fixed32, optional, tag = "23")]
    pub turn_z: Option<u32>,
    #[prost(bytes = "vec", optional, tag = "24")]
    pub pack_id: Option<Vec<u8>>,
    #[prost(fixed32, optional, tag = "25")]
    pub pack_points: Option<u32>,
    #[prost(bytes = "vec", optional, tag = "26")]
    pub candidates: Option<Vec<u8>>,
}

#[derive(Clone, PartialEq, Message)]
#[prost(skip_debug)]
pub(crate) struct ProfileMessage {
    #[prost(fixed32, optional, tag = "1")]
    pub version: Option<u32>,
    #[prost(string, optional, tag = "2")]
    pub descriptor_name: Option<String>,
    #[prost(fixed32, optional, tag = "3")]
    pub descriptor_dim: Option<u32>,
    #[prost(fixed32, optional, tag = "4")]
    pub descriptor_encoding: Option<u32>,
    #[prost(fixed32, optional, tag = "5")]
    pub descriptor_norm: Option<u32>,
    #[prost(fixed32, optional, tag = "6")]
    pub max_keypoints: Option<u32>,
    #[prost(fixed32, optional, tag = "7")]
    pub max_image_side: Option<u32>,
    #[prost(string, optional, tag = "8")]
    pub global_name: Option<String>,
    #[prost(fixed32, optional, tag = "9")]
    pub global_codes: Option<u32>,
    #[prost(bytes = "vec", optional, tag = "10")]
    pub vocabulary: Option<Vec<u8>>,
}

#[derive(Clone, PartialEq, Message)]
#[prost(skip_debug)]
pub(crate) struct PackMessage {
    #[prost(fixed32, optional, tag = "1")]
    pub version: Option<u32>,
    #[prost(bytes = "vec", optional, tag = "2")]
    pub profile: Option<Vec<u8>>,
    #[prost(fixed32, optional, tag = "3")]
    pub points: Option<u32>,
    #[prost(bytes = "vec", optional, tag = "4")]
    pub images: Option<Vec<u8>>,
    #[prost(bytes = "vec", optional, tag = "5")]
    pub row_points: Option<Vec<u8>>,
    #[prost(bytes = "vec", optional, tag = "6")]
    pub descriptors: Option<Vec<u8>>,
    #[prost(bytes = "vec", optional, tag = "7")]
    pub checksum: Option<Vec<u8>>,
}

/// A descriptor kind in the form of the messages.
pub(crate) struct KindFields {
    pub(crate) name: String,
    pub(crate) dim: u32,
    pub(crate) encoding: u32,
    pub(crate) norm: u32,
}

impl KindFields {
    pub(crate) fn of(kind: DescriptorKind) -> Self {
        let encoding = match kind.encoding() {
            Encoding::Unsigned => 1,
            Encoding::Signed => 2,
            Encoding::Coarse => 3,
        };
        Self { name: kind.name().to_owned(), dim: kind.dim() as u32, encoding, norm: kind.norm() }
    }

    pub(crate) fn kind(&self) -> Result<DescriptorKind, QueryError> {
        let encoding = match self.encoding {
            1 => Encoding::Unsigned,
            2 => Encoding::Signed,
            3 => Encoding::Coarse,
            value => {
                let (field, allowed) = ("descriptor_encoding", "1 (unsigned), 2 (signed) or 3 (coarse)");
                return Err(QueryError::Field { field, value, allowed });
            }
        };
        DescriptorKind::new(&self.name, self.dim as usize, encoding, self.norm).map_err(|e| match e {
            DescriptorError::Kind { field: "dim", allowed, .. } => {
                QueryError::Field { field: "descriptor_dim", value: self.dim, allowed }
            }
            DescriptorError::Kind { field: "norm", allowed, .. } => {
                QueryError::Field { field: "descriptor_norm", value: self.norm, allowed }
            }
            other => refused("descriptor_name", &other),
        })
    }
}

/// Converts an error of the descriptor crate about a part of a message.
pub(crate) fn refused(what: &'static str, error: &DescriptorError) -> QueryError {
    QueryError::Descriptor { what, reason: error.to_string() }
}

/// Name of a message type, its maximum length, and the version that is read here.
#[derive(Clone, Copy)]
pub(crate) struct Format {
    pub(crate) what: &'static str,
    /// Bytes.
    pub(crate) limit: usize,
    pub(crate) version: u32,
    /// What to do about a message of another version.
    pub(crate) remedy: &'static str,
}

impl Format {
    /// The first step of strict decoding: bounded size, a protobuf message, the supported version.
    ///
    /// The version is read first and alone: fields of a message of another version may have other types.
    pub(crate) fn message<M: Message + Default>(&self, bytes: &[u8]) -> Result<M, QueryError> {
        let &Self { what, limit, version, remedy } = self;
        if bytes.len() > limit {
            return Err(QueryError::TooLong { what, bytes: bytes.len(), limit });
        }
        let found = present("version", message::<VersionMessage>(what, bytes)?.version)?;
        if found != version {
            return Err(QueryError::Version { what, found, supported: version, remedy });
        }
        message(what, bytes)
    }
}

/// Decodes a protobuf message.
fn message<M: Message + Default>(what: &'static str, bytes: &[u8]) -> Result<M, QueryError> {
    M::decode(bytes).map_err(|e| QueryError::Malformed { what, reason: e.to_string() })
}

/// A required field.
pub(crate) fn present<T>(field: &'static str, value: Option<T>) -> Result<T, QueryError> {
    value.ok_or(QueryError::Missing { field })
}
