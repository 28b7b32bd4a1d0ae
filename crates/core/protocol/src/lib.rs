//! The sealed query, the device profile, the answer, and their wire formats.
//!
//! This room is what both sides of the wire share: the device seals into it (`veiloc-obfuscation`), the server
//! reads from it (`veiloc-localization`). It holds codes and turns codes into lines; nothing in it turns a keypoint
//! into a code, and for the line schemes no type in it has a field that could hold a keypoint.
//!
//! - [`Scheme`]: what happens to keypoint positions; [`DclLayout`]: where Dual Convergent Lines puts its anchors;
//!   [`LayoutTurn`]: how they are turned in a later frame of a session.
//! - [`Profile`]: what a device needs to know before it can seal for a map. No map data, and no scheme.
//! - [`SealedQuery`]: what leaves the device; [`Observations`]: what it tells about positions.
//! - [`RigMessage`]: several of them with their relative poses.
//! - [`Answer`]: what the server tells in return; [`AnswerDocument`]: the same as JSON.
//! - [`Hints`]: what a device says of its camera beside the rows, if it wants to.
//! - [`CanonicalCamera`]: the camera all positions are told in, which names no individual lens.
//!
//! Each message has one version; another one is refused with what to do about it ([`QueryError::Version`]).
//! The bytes are described in `docs/reference/wire-format.md` and `proto/veiloc/`, the reasons in `docs/reference/privacy-rules.md`.
//!
//! ```
//! use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
//! use veiloc_geometry::Anchor;
//! use veiloc_protocol::{
//!     AnchoredRow, AngleBits, CanonicalCamera, Hints, LayoutTurn, Profile, QueryParts, Rows, Scheme, SealedQuery,
//! };
//!
//! // A server publishes its map's profile as bytes, a device reads it.
//! let kind = DescriptorKind::ROOT_SIFT;
//! let published = Profile::vlad(Vocabulary::new(Descriptors::new(kind, vec![20; 2 * 128])?)?).encode();
//! let profile = Profile::decode(&published)?;
//!
//! // The device puts rows together: `veiloc_obfuscation::seal` makes them of keypoints, here are some made up.
//! let bits = AngleBits::default();
//! let scheme: Scheme = "dcl:paper".parse()?;
//! let row = |i: u32| AnchoredRow::new(bits, Anchor::BOTH[i as usize % 2], f64::from(i) / 100.0);
//! let parts = QueryParts {
//!     camera: CanonicalCamera::from_codes(36, 20, 15)?, // 512 px, 640 x 480
//!     scheme,
//!     angle_bits: bits,
//!     rows: Rows::Dcl((0..256).map(row).collect()),
//!     descriptors: Descriptors::new(kind, vec![30; 256 * 128])?,
//!     image_global: None,
//!     turn: LayoutTurn::default(), // fixed in the image
//!     hints: Hints::default(), // calibrated, and nothing of gravity
//! };
//! let bytes = SealedQuery::new(&profile, parts)?.encode();
//!
//! // The server reads it strictly, and sees whether it was sealed for its map.
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
mod error;
mod gravity;
mod hints;
mod layout;
mod observations;
mod position_hint;
mod profile;
mod profile_check;
mod profile_id;
mod profile_wire;
mod rig_message;
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
pub use answer::{Answer, AnswerDoubt, AnswerFit, AnswerPose, AnswerState, AnswerTimes, DoubtKind};
pub use answer_document::{AnswerDocument, ConfidenceDocument, DoubtDocument, PoseDocument, StageDocument};
pub use balance::{LEAST_A_SIDE, Lopsided};
pub use camera::{CanonicalCamera, Window};
pub use error::QueryError;
pub use gravity::CoarseGravity;
pub use hints::{FocalKnowledge, Hints, UnknownKnowledge};
pub use layout::{DclLayout, HalvesLayout};
pub use observations::{AnchoredLine, Observations};
pub use position_hint::PositionHint;
pub use profile::{ExtractionLimits, Profile};
pub use profile_id::ProfileId;
pub use rig_message::{RigMessage, SealedFrame};
pub use rows::{AnchoredRow, LineRow, PositionRow, Rows};
pub use scheme::Scheme;
pub use sealed::{QueryParts, SealedQuery};
pub use sector_layout::SectorLayout;
pub use size_class::SizeClass;
pub use steps::Enough;
pub use turn::LayoutTurn;
