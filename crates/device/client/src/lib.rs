//! The device's road to a positioning service: seal an image, send the sealed query, get the pose.
//!
//! This is the library for whoever writes an app. Nothing in it talks to a terminal; calls block, so run them on a thread
//! of their own. It never sends an image or a keypoint: a [`Client`] takes [`SealedQuery`] and nothing else.
//!
//! - [`Client`]: a service, and who asks it. [`Client::profile`] fetches what is needed to seal for a map (and keeps it on
//!   disk, when [`ClientOptions::cache`] says where), [`Client::localize`] asks, [`Client::localize_rig`] for several images
//!   of one device at once, [`Client::localize_progressive`] sends no more rows than a trusted pose takes.
//! - [`seal_image`]: from a file and its camera to the sealed query; [`seal_masked`] without what a [`Mask`] hides.
//! - [`SessionFile`]: several images of one place, sealed so that their lines do not cross in what they show.
//! - [`ClientError`]: tells apart what an app does different things about: busy, not localized, a map that was exchanged,
//!   a refusal, the network.
//! - [`ClientOptions`] and [`RetryPolicy`]: limits, and [`Notice`] for what happens meanwhile.
//!
//! # What is never done
//! An image is sealed once (rule L7 of `docs/reference/privacy-rules.md`): when the service is busy or the network fails, the same bytes
//! are sent again, never a new query. Plain HTTP is spoken with this machine only, unless
//! [`ClientOptions::insecure_http`] says that the way is safe. Nothing a service answers is believed: lengths, types and
//! forms are checked, and its words are made fit for a screen ([`printable`]).
//!
//! # The whole road
//! ```no_run
//! use veiloc_client::{Answer, Client, ClientError, ClientOptions, SealOptions, seal_image};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let client = Client::new("https://places.example:8443", Some("token"), ClientOptions::default())?;
//! let profile = client.profile("lobby")?;
//! let camera = "SIMPLE_RADIAL,1296,1936,2435.4,648,968,-0.034".parse()?;
//! // How positions are hidden is the device's choice, whatever a profile says; `dcl` unless it says otherwise.
//! let sealed = seal_image("photo.jpg".as_ref(), &camera, &profile, &SealOptions::default())?;
//! match client.localize("lobby", &sealed.query) {
//!     Ok(Answer { trusted: true, pose: Some(pose), .. }) => {
//!         println!("at {:?} ± {}", pose.center, pose.position_sd());
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
//! A service that does not know the map; here a thread plays it:
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
//! // Tokens and queries do not travel in the open.
//! let plain = Client::new("http://places.example", None, ClientOptions::default());
//! assert!(matches!(plain, Err(ClientError::PlainHttp { .. })));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]

mod address;
mod client;
mod error;
mod options;
mod profile_cache;
mod progressive;
mod refusal;
mod replace;
mod request;
mod seal;
mod session_file;
mod transport;

pub use client::Client;
pub use error::ClientError;
pub use options::{ClientOptions, Notice, NoticeListener, RetryPolicy, Sleep};
pub use progressive::{ProgressiveAnswer, Step, StepOutcome};
pub use refusal::{Refusal, printable};
pub use request::LocalizeRequest;
pub use seal::{SealedImage, seal_image, seal_masked};
pub use session_file::SessionFile;
pub use veiloc_features::{Mask, load_mask};
pub use veiloc_geometry::{CameraFromRig, Intrinsics};
pub use veiloc_obfuscation::{
    KnownCamera, Orientation, SealError, SealOptions, Session, SessionAnchors, SessionOptions,
};
pub use veiloc_protocol::{
    Answer, AnswerDocument, AnswerFit, AnswerPose, AnswerState, CoarseGravity, Enough, FocalKnowledge,
    PositionHint, Profile, RigMessage, Scheme, SealedFrame, SealedQuery,
};
