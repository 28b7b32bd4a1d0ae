//! The device side: extract, seal, localize.
//!
//! A [`Sealer`] extracts and seals, [`Client`] sends the query; several images of one scene are sealed in one
//! [`SessionFile`] or [`Session`]. Callers with their own features start at [`Extracted::new`]; callers with their own
//! HTTP client send [`SealedQuery::encode`] and read [`Answer::decode`]. `docs/reference/privacy-rules.md` describes what
//! an app must not do, and the remaining leakage.

/// For apps with an AR framework: camera frames, axes, the transform from the AR world to the map.
pub use veiloc_ar as ar;
pub use veiloc_client::{
    Client, ClientError, ClientOptions, LocalizeRequest, Notice, Refusal, RetryPolicy, SessionFile, printable,
};
pub use veiloc_features::{
    Extractor, Extractors, FeatureError, Features, GlobalExtractor, GrayImage, Image, Keypoint, Mask,
    SharedGlobal, Sift, SiftOptions, load_gray, load_mask,
};
pub use veiloc_obfuscation::{
    DeviceLimits, ExplainedRow, Extracted, KnownCamera, KnownPlace, Orientation, PackUse, SealError,
    SealErrorKind, SealOptions, Sealer, Session, SessionAnchors, SessionOptions, SessionSealer, device_rng,
};
pub use veiloc_protocol::{
    AnchorPose, Answer, AnswerDocument, AnswerPose, CoarseGravity, ContentAnchor, ContentAnchorError,
    ContentAnchors, FocalKnowledge, Pack, PositionHint, Profile, QueryError, Scheme, SealedQuery,
};
