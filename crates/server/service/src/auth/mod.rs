//! The token file: which clients may query which maps, and until when. Independent of HTTP and of clocks.
//!
//! - [`TokenList`]: the content of a token file; [`TokenEntry`] is one line of it.
//! - [`TokenFile`]: the locked file, for adding and revoking tokens.
//! - [`Secret`]: a token, which is printed once and never stored; [`TokenKey`]: its hash, by which it is recognized.
//! - [`Timestamp`]: a second in UTC, the end of validity of a token.
//!
//! # The file
//! One token per line: a name, the SHA-256 of the token in hexadecimal, then in any order its permissions: `operator`
//! (it may also read the metrics), `anchors` (it may write content anchors), `maps=a,b` (it may use only these maps), `expires=2027-01-31T00:00:00Z` or
//! `expires=2027-01-31` (the beginning of that day in UTC; the token is invalid from then on). Empty lines and lines
//! that begin with `#` are ignored. A file without tokens is an error, because an unfinished write looks the same,
//! unless the line `nobody` says that it is intended.
//!
//! # Why plain hashes
//! A token has 256 random bits ([`Secret`]; by hand `openssl rand -hex 32`). Its plain hash can be neither inverted
//! nor guessed, so salting or stretching would only cost time on every request. For the same reason the lookup from
//! hash to token need not be constant-time: an attacker cannot choose the hashes of the tokens it tries. From the
//! time it would learn at most a prefix of the hash of a valid token, from which the token does not follow. The time
//! does not depend on the number of tokens (`study service tokens`).
//!
//! ```
//! use veiloc_service::auth::{TokenEntry, Timestamp, Secret, TokenList};
//!
//! let secret = Secret::of_random([7; 32]); // in real use from the generator of the system
//! let mut entry = TokenEntry::new("phone", secret.key())?;
//! entry.grant_maps(["lobby"])?;
//! entry.expires = Some("2027-01-31".parse()?);
//! let list = TokenList::parse(entry.to_string().as_bytes())?;
//! let found = list.find(&secret.key()).expect("its token");
//! assert!(found.allows_map("lobby") && !found.allows_map("garage"));
//! assert!(found.has_expired("2027-01-31T00:00:00Z".parse::<Timestamp>()?));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]

mod edit;
mod entry;
mod error;
mod key;
mod list;
mod names;
mod secret;
pub(crate) mod small_file;
mod store;
mod timestamp;
pub(crate) mod tokens;
pub(crate) mod tokens_file;

pub use edit::{Revocation, added, revoked};
pub use entry::TokenEntry;
pub use error::{LineError, TokensError};
pub use key::{Lane, TokenKey};
pub use list::TokenList;
pub use names::is_token_name;
pub use secret::Secret;
pub use store::TokenFile;
pub use timestamp::{InvalidTimestamp, Timestamp};
