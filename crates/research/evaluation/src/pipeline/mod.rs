//! The localization pipeline of evaluations: a map is built, written and opened as on a server; a query is sealed,
//! encoded and decoded as if it had crossed a network. No stage is skipped because the truth is known.

mod device;
mod evaluate_query;
mod posed_query;
mod progressive;
mod scene_map;
mod served_map;
mod server;
mod simulated_gravity;

pub(crate) use device::{SealedBytes, image_of, seal_query};
pub use evaluate_query::localize_one;
pub(crate) use evaluate_query::localize_sent;
pub use posed_query::{EvaluatedQuery, PosedQuery, posed_queries, queries_of_scene};
pub use progressive::QueryTransmission;
pub use scene_map::SceneMap;
pub(crate) use served_map::ServedMap;
pub use simulated_gravity::{GravityNoise, SimulatedGravity};
