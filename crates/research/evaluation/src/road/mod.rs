//! The localization pipeline of evaluations: a map is built, written and opened as on a server; a query is sealed,
//! encoded and decoded as if it had crossed a network. No stage is skipped because the truth is known.

mod ask;
mod extracted;
mod judge;
mod place_map;
mod posed_query;
mod progressive;
mod send;
mod served;
mod upright;

pub(crate) use ask::{Answer, ask};
pub(crate) use extracted::extracted;
pub use judge::localize_one;
pub(crate) use judge::localize_sent;
pub use place_map::PlaceMap;
pub use posed_query::{AskedQuery, PosedQuery, posed_queries, queries_of_place};
pub use progressive::Sending;
pub(crate) use progressive::send_and_ask;
pub(crate) use send::{Sent, equipped, send};
pub(crate) use served::Served;
pub use upright::Upright;
