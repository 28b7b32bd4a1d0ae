//! The road of a query as evaluations walk it: a map built, written and opened as a server would; a query sealed, encoded
//! and decoded as if it had crossed a network. No stage is short-cut because truth is at hand.

mod ask;
mod judge;
mod place_map;
mod posed_query;
mod send;
mod upright;

pub(crate) use ask::{Answer, ask};
pub use judge::localize_one;
pub use place_map::PlaceMap;
pub use posed_query::{PosedQuery, posed_queries, queries_of_place};
pub(crate) use send::{Sent, send};
pub use upright::Upright;
