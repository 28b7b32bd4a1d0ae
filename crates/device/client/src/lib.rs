//! Internal: the client of a positioning service: seal an image, send the sealed query, get the pose.
//!
//! This is the library for app developers. It does not use the terminal; calls block, so run them on a separate thread.
//! It never sends an image or a keypoint: a [`Client`] only accepts a [`SealedQuery`].
//!
//! - [`Client`]: a client of a service. [`Client::profile`] fetches what is needed to seal for a map (and stores it in
//!   [`ClientOptions::cache`]), [`Client::localize`] sends a query, [`Client::localize_rig`] sends several images of
//!   one device, [`Client::localize_progressive`] sends rows only until the pose is trusted.
//! - [`Client::anchors`], [`Client::put_anchor`]: content that stays at its place in a map ([`ContentAnchors`]).
//! - [`Sealer`]: from an image and its camera to the sealed query; [`Image::without`] hides what a [`Mask`] marks.
//! - [`SessionFile`]: several images of one scene, sealed so that their lines do not cross in the keypoints.
//! - [`ClientError`]: errors grouped by what an app does about them: busy, not localized, a map that was replaced, an
//!   error response, the network.
//! - [`ClientOptions`] and [`RetryPolicy`]: limits, and a [`Notice`] for each event during a call.
//!
//! # What the client never does
//! It never seals an image twice (rule L7 of `docs/reference/privacy-rules.md`): when the service is busy or the network fails, it
//! sends the same bytes again. It uses plain HTTP only to this machine, unless [`ClientOptions::insecure_http`]
//! declares the network safe. It does not trust responses: it checks lengths, types and formats, and removes control
//! characters from texts ([`printable`]).
//!
//! # The whole pipeline
//! ```no_run
//! use veiloc_client::{
//!     Answer, Client, ClientError, ClientOptions, Image, Intrinsics, SealOptions, Sealer, device_rng,
//! };
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let client = Client::new("https://places.example:8443", Some("token"), ClientOptions::default())?;
//! let profile = client.profile("lobby")?;
//! let camera: Intrinsics = "SIMPLE_RADIAL,1296,1936,2435.4,648,968,-0.034".parse()?;
//! // The device chooses how positions are hidden, independent of the profile; the default is `dcl`.
//! let sealer = Sealer::new(&profile, SealOptions::default())?;
//! let extracted = sealer.extract(Image::open("photo.jpg".as_ref())?, camera)?;
//! // Once for each image. Further images of the scene belong to one session: `sealer.in_session`.
//! let query = sealer.seal(extracted, &mut device_rng()?)?;
//! match client.localize("lobby", &query) {
//!     Ok(Answer { pose: Some(pose), doubts, .. }) if doubts.is_empty() => {
//!         println!("at {:?} ± {}", pose.center(), pose.position_sd());
//!     }
//!     Ok(_) | Err(ClientError::NotLocalized(_)) => println!("not sure where this is"),
//!     Err(ClientError::Busy { retry_after, .. }) => println!("busy; the same query again in {retry_after:?}"),
//!     Err(error) => return Err(error.into()),
//! }
//! # Ok(())
//! # }
//! ```
//!
//! # Errors have types
//! A service that does not know the map; here a thread simulates it:
//! ```
//! use std::io::{Read, Write};
//! use veiloc_client::{Client, ClientError, ClientOptions};
//!
//! let listener = std::net::TcpListener::bind("127.0.0.1:0")?;
//! let address = listener.local_addr()?;
//! std::thread::spawn(move || {
//!     let (mut stream, _) = listener.accept().unwrap();
//!     let _ = stream.read(&mut [0; 4096]);
//!     let body = r#"{"type":"urn:veiloc:problem:unknown-map","title":"Unknown map","status":404,"detail":"none"}"#;
//!     let head = "HTTP/1.1 404 Not Found\r\ncontent-type: application/problem+json\r\nconnection: close\r\n";
//!     write!(stream, "{head}content-length: {}\r\n\r\n{body}", body.len()).unwrap();
//! });
//!
//! let client = Client::new(&format!("http://{address}"), None, ClientOptions::default())?;
//! let Err(ClientError::Refused(refusal)) = client.profile("atlantis") else { panic!("there is no such map") };
//! assert_eq!((refusal.status, refusal.name.as_str()), (404, "unknown-map"));
//!
//! // Tokens and queries are not sent unencrypted.
//! let plain = Client::new("http://places.example", None, ClientOptions::default());
//! assert!(matches!(plain, Err(ClientError::PlainHttp { .. })));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]

mod address;
mod atomic_file;
mod cache;
mod client;
mod error;
mod options;
mod progressive;
mod refusal;
mod request;
mod session_file;
mod transport;

pub use client::Client;
pub use error::ClientError;
pub use options::{ClientOptions, Notice, NoticeListener, RetryPolicy, Sleep};
pub use progressive::{ProgressiveAnswer, Step, StepOutcome};
pub use refusal::{Refusal, printable};
pub use request::LocalizeRequest;
pub use session_file::SessionFile;
pub use veiloc_features::{Image, Mask, load_mask};
pub use veiloc_geometry::{CameraFromRig, Intrinsics};
pub use veiloc_obfuscation::{
    Extracted, KnownCamera, KnownPlace, Orientation, PackUse, SealError, SealOptions, Sealer, Session,
    SessionAnchors, SessionOptions, SessionSealer, device_rng,
};
pub use veiloc_protocol::{
    AnchorPose, Answer, AnswerDocument, AnswerFit, AnswerPose, AnswerState, CoarseGravity, ContentAnchor,
    ContentAnchorError, ContentAnchors, FocalKnowledge, Pack, PositionHint, Profile, RigMessage, Scheme,
    SealedFrame, SealedIn, SealedQuery, SeparateAnchors, SessionTag, StopCriterion,
};
