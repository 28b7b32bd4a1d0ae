//! Admission and scheduling, independent of HTTP and localization.
//!
//! - [`Connections`]: limits of open connections in total, per address, and for authenticated clients.
//! - [`FairQueue`]: schedules work so that a client that sends much delays only itself.
//! - [`LogThrottle`]: limits log lines per kind and counts the suppressed ones.
//!
//! Nothing here reads a clock, so the tests need none: the pool says how long work took.
//!
//! ```
//! use std::num::NonZeroUsize;
//! use veiloc_service::queue::FairQueue;
//!
//! let mut queue: FairQueue<u8, &str> = FairQueue::new(NonZeroUsize::new(32).expect("not zero"));
//! (0..10).for_each(|_| queue.push(Some(1), 4096, "of a busy client"));
//! queue.push(Some(2), 512, "of a quiet client");
//! let order: Vec<&str> = std::iter::from_fn(|| queue.pop()).map(|(_, work)| work).collect();
//! assert!(order.iter().position(|work| *work == "of a quiet client").expect("done") < 2);
//! ```
#![forbid(unsafe_code)]

pub(crate) mod clock;
mod connections;
mod fair_queue;
pub(crate) mod pool;
pub(crate) mod rates;
mod throttle;

pub use connections::{Admission, Connection, ConnectionLimits, Connections, Slot};
pub use fair_queue::{Charge, FairQueue};
pub use pool::{JobSpec, Pool, Rejected};
pub use throttle::{LogKind, LogThrottle};
