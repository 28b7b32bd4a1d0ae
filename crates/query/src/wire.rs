//! Version 1 of the messages, field by field as in `proto/veiloc/v1/` (a test holds the two together).

use prost::Message;

use crate::QueryError;

/// The version written and read.
pub(crate) const VERSION: u32 = 1;

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
    #[prost(fixed32, optional, tag = "11")]
    pub descriptor_kind: Option<u32>,
    #[prost(bytes = "vec", optional, tag = "12")]
    pub positions: Option<Vec<u8>>,
    #[prost(bytes = "vec", optional, tag = "13")]
    pub descriptors: Option<Vec<u8>>,
    #[prost(bytes = "vec", optional, tag = "14")]
    pub global: Option<Vec<u8>>,
}

#[derive(Clone, PartialEq, Message)]
#[prost(skip_debug)]
pub(crate) struct ProfileMessage {
    #[prost(fixed32, optional, tag = "1")]
    pub version: Option<u32>,
    #[prost(fixed32, optional, tag = "2")]
    pub scheme: Option<u32>,
    #[prost(fixed32, optional, tag = "3")]
    pub dividing_angle: Option<u32>,
    #[prost(fixed32, optional, tag = "4")]
    pub anchor_distance: Option<u32>,
    #[prost(fixed32, optional, tag = "5")]
    pub angle_bits: Option<u32>,
    #[prost(fixed32, optional, tag = "6")]
    pub descriptor_kind: Option<u32>,
    #[prost(fixed32, optional, tag = "7")]
    pub max_keypoints: Option<u32>,
    #[prost(fixed32, optional, tag = "8")]
    pub max_image_side: Option<u32>,
    #[prost(bytes = "vec", optional, tag = "9")]
    pub vocabulary: Option<Vec<u8>>,
}

/// The first step of strict reading: bounded size, a protobuf message, a known version.
pub(crate) fn parse<M: Message + Default>(
    what: &'static str,
    bytes: &[u8],
    limit: usize,
    version: impl Fn(&M) -> Option<u32>,
) -> Result<M, QueryError> {
    if bytes.len() > limit {
        return Err(QueryError::TooLong { what, bytes: bytes.len(), limit });
    }
    let message = M::decode(bytes).map_err(|e| QueryError::Malformed { what, reason: e.to_string() })?;
    match present("version", version(&message))? {
        VERSION => Ok(message),
        found => Err(QueryError::Version { what, found, supported: VERSION }),
    }
}

/// A field every message has.
pub(crate) fn present<T>(field: &'static str, value: Option<T>) -> Result<T, QueryError> {
    value.ok_or(QueryError::Missing { field })
}
