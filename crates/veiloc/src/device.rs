//! The device side: extract, seal, localize.
//!
//! [`seal_image`] extracts and seals, [`Client`] sends the query; several images of one scene are sealed in one
//! [`SessionFile`] or [`Session`]. Callers with their own features start at [`seal`]; callers with their own HTTP
//! client send [`SealedQuery::encode`] and read [`Answer::decode`]. `docs/reference/privacy-rules.md` describes what an app must not
//! do, and the remaining leakage.

/// For apps with an AR framework: camera frames, axes, the transform from the AR world to the map.
pub use veiloc_ar as ar;
pub use veiloc_client::{
    Client, ClientError, ClientOptions, LocalizeRequest, Notice, Refusal, RetryPolicy, SealedImage,
    SessionFile, printable, seal_image,
};
pub use veiloc_features::{
    Extractor, Extractors, FeatureError, Features, GlobalExtractor, GrayImage, Image, Keypoint, SharedGlobal,
    Sift, SiftOptions, load_gray,
};
pub use veiloc_obfuscation::{
    DeviceLimits, KnownCamera, Orientation, SealError, SealOptions, Session, SessionAnchors, SessionOptions,
    device_rng, extract, extract_loaded, extract_with, seal,
};
pub use veiloc_protocol::{
    Answer, AnswerDocument, AnswerPose, CoarseGravity, FocalKnowledge, PositionHint, Profile, QueryError,
    Scheme, SealedQuery,
};
