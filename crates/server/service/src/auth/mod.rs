//! The file of tokens: who may ask, which maps, and until when. Knows neither HTTP nor clocks.
//!
//! - [`TokenList`]: what a file of tokens holds; [`Entry`] is one line of it.
//! - [`TokenFile`]: the file under its lock, to add a token or to revoke one.
//! - [`Secret`]: a token, which is told once and kept nowhere; [`TokenKey`]: its hash, by which it is known again.
//! - [`Moment`]: a second in UTC, as the end of a token is written.
//!
//! # The file
//! One token a line: a name for people, the SHA-256 of the token in hexadecimal, then in any order what it is worth:
//! `operator` (it may also read the metrics), `maps=a,b` (it may ask for these maps alone), `expires=2027-01-31T00:00:00Z`
//! or `expires=2027-01-31` (the beginning of that day in UTC; from then on it is worth nothing). Empty lines and lines
//! beginning with `#` do not count. A file without tokens is an error, because an unfinished write looks like that, unless
//! the line `nobody` says that it is meant.
//!
//! # Why plain hashes
//! A token is 256 random bits ([`Secret`]; by hand `openssl rand -hex 32`). Its plain hash can neither be reversed nor
//! guessed, so salt or stretching would only cost time on every request. For the same reason a map from hash to token may
//! be looked into without care for how long that takes: who tries tokens cannot choose their hashes, and would learn from
//! the time at most how a hash they already know begins that of somebody's token, from which no token follows. The time
//! does not depend on how many tokens there are (`scripts/service/many_tokens.py`).
//!
//! ```
//! use veiloc_service::auth::{Entry, Moment, Secret, TokenList};
//!
//! let secret = Secret::of_random([7; 32]); // from the system's generator, in earnest
//! let mut entry = Entry::new("phone", secret.key())?;
//! entry.grant_maps(["lobby"])?;
//! entry.expires = Some("2027-01-31".parse()?);
//! let list = TokenList::parse(entry.to_string().as_bytes())?;
//! let found = list.find(&secret.key()).expect("its token");
//! assert!(found.may_ask_for("lobby") && !found.may_ask_for("garage"));
//! assert!(found.has_expired("2027-01-31T00:00:00Z".parse::<Moment>()?));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]

mod edit;
mod entry;
mod error;
mod key;
mod list;
mod moment;
mod names;
mod secret;
mod store;

pub use edit::{Revoked, added, revoked};
pub use entry::Entry;
pub use error::{LineFault, TokensError};
pub use key::TokenKey;
pub use list::TokenList;
pub use moment::{BadMoment, Moment};
pub use names::is_token_name;
pub use secret::Secret;
pub use store::TokenFile;
