//! Internal: the sealed query, the device profile, the answer, and their wire formats.
//!
//! Both sides of the wire share this crate: the device writes sealed queries (`veiloc-obfuscation`), the server reads
//! them (`veiloc-localization`). It holds codes and converts codes into lines; nothing in it converts a keypoint into a
//! code, and no type of the line schemes has a field that could hold a keypoint.
//!
//! - [`Scheme`]: how keypoint positions are hidden; [`DclLayout`]: the anchors of Dual Convergent Lines;
//!   [`LayoutTurn`]: their rotation in a later frame of a session.
//! - [`Profile`]: what a device needs to seal for a map. It contains no map data and no scheme.
//! - [`SealedQuery`]: what the device sends; [`Observations`]: what it reveals about positions.
//! - [`Pack`]: the descriptors of a place without positions; [`RowMatches`]: what a device found in them.
//! - [`RigMessage`]: several queries with their relative poses.
//! - [`Answer`]: the server's answer; [`AnswerDocument`]: the same as JSON.
//! - [`ContentAnchors`]: content of apps at poses of a map, and [`is_map_name`], which names may have.
//! - [`Hints`]: optional information about the camera beside the rows.
//! - [`CanonicalCamera`]: the camera of all positions, which identifies no individual lens.
//!
//! Each message has one version; another version is rejected with the remedy ([`QueryError::Version`]).
//! `docs/reference/wire-format.md` and `proto/veiloc/` describe the bytes, `docs/reference/privacy-rules.md` the reasons.
//!
//! ```
//! use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
//! use veiloc_geometry::Anchor;
//! use veiloc_protocol::{
//!     AnchoredRow, AngleBits, CanonicalCamera, Hints, LayoutTurn, Profile, QueryParts, Rows, Scheme, SealedQuery,
//!     SentContent,
//! };
//!
//! // A server publishes its map's profile as bytes, a device reads it.
//! let kind = DescriptorKind::ROOT_SIFT;
//! let published = Profile::vlad(Vocabulary::new(Descriptors::new(kind, vec![20; 2 * 128])?)?).encode();
//! let profile = Profile::decode(&published)?;
//!
//! // The device assembles rows: `veiloc_obfuscation::Sealer` makes them from keypoints; these are invented.
//! let bits = AngleBits::default();
//! let scheme: Scheme = "dcl:paper".parse()?;
//! let row = |i: u32| AnchoredRow::new(bits, Anchor::BOTH[i as usize % 2], f64::from(i) / 100.0);
//! let parts = QueryParts {
//!     camera: CanonicalCamera::from_codes(36, 20, 15)?, // 512 px, 640 x 480
//!     scheme,
//!     angle_bits: bits,
//!     rows: Rows::Dcl((0..256).map(row).collect()),
//!     content: SentContent::Described { descriptors: Descriptors::new(kind, vec![30; 256 * 128])?, image_global: None },
//!     turn: LayoutTurn::default(), // fixed in the image
//!     hints: Hints::default(), // calibrated, no gravity direction
//! };
//! let bytes = SealedQuery::new(&profile, parts)?.encode();
//!
//! // The server decodes it strictly, and checks whether it was sealed for its map.
//! let received = SealedQuery::decode(&bytes)?;
//! profile.check(&received)?;
//! assert_eq!((received.len(), received.scheme()), (256, scheme));
//! assert!(SealedQuery::decode(&bytes[..bytes.len() - 1]).is_err());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]

mod angle;
mod answer;
mod answer_document;
mod answer_wire;
mod balance;
mod bits;
mod camera;
mod content_anchors;
mod error;
mod gravity;
mod hints;
mod layout;
mod message_id;
mod name;
mod observations;
mod pack;
mod pack_wire;
mod position_hint;
mod profile;
mod profile_check;
mod profile_wire;
mod rig_anchors;
mod rig_message;
mod row_matches;
mod rows;
mod scheme;
mod sealed;
mod sealed_wire;
mod sector_layout;
mod size_class;
mod steps;
mod turn;
mod wire;

pub use angle::AngleBits;
pub use answer::{
    Answer, AnswerDoubt, AnswerFit, AnswerPose, AnswerState, AnswerTimes, DoubtKind, GravityUse,
    MapCoordinates,
};
pub use answer_document::{AnswerDocument, ConfidenceDocument, PoseDocument};
pub use balance::{MIN_PER_SIDE, UnbalancedAnchors};
pub use camera::{CanonicalCamera, Window};
pub use content_anchors::{AnchorPose, ContentAnchor, ContentAnchorError, ContentAnchors, FrameImage};
pub use error::QueryError;
pub use gravity::CoarseGravity;
pub use hints::{FocalKnowledge, Hints, UnknownKnowledge};
pub use layout::{DclLayout, HalvesLayout};
pub use message_id::{MessageId, PackId, ProfileId};
pub use name::is_map_name;
pub use observations::{AnchoredLine, Observations};
pub use pack::{Pack, PackImage};
pub use position_hint::PositionHint;
pub use profile::{ExtractionLimits, Profile};
pub use rig_anchors::{SealedIn, SeparateAnchors, SessionTag, SessionTagError};
pub use rig_message::{RigMessage, SealedFrame};
pub use row_matches::{Candidate, MatchWeight, RowMatches};
pub use rows::{AnchoredRow, LineRow, PositionRow, Rows};
pub use scheme::Scheme;
pub use sealed::{QueryContent, QueryParts, SealedQuery, SentContent};
pub use sector_layout::SectorLayout;
pub use size_class::SizeClass;
pub use steps::StopCriterion;
pub use turn::LayoutTurn;
