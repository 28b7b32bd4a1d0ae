//! The device's road: extract, seal, ask.
//!
//! [`seal_image`] does the first two, [`Client`] the third; several images of one place are sealed in one [`SessionFile`] or
//! [`Session`]. Who has features of their own begins at [`seal`]; who speaks
//! HTTP by other means sends [`SealedQuery::encode`] and reads [`Answer::decode`]. What an app must not do, and what leaks
//! all the same, is in `docs/reference/privacy-rules.md`.

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
