//! Who is let in and whose turn it is, without a word about HTTP or localization.
//!
//! - [`Connections`]: which connections may be open, in all, of one address, and with a known token.
//! - [`FairQueue`]: whose work is done next, so that who sends much waits longer and nobody else does.
//! - [`Throttle`]: which log lines are written one by one and which are summed up.
//!
//! Nothing here reads a clock, so all of it is tested without one. `veiloc-service` is the user.
//!
//! ```
//! use std::num::NonZeroUsize;
//! use veiloc_service::queue::FairQueue;
//!
//! let mut queue: FairQueue<u8, &str> = FairQueue::new(NonZeroUsize::new(32).expect("not zero"));
//! (0..10).for_each(|_| queue.push(Some(1), 4096, "of who sends much"));
//! queue.push(Some(2), 512, "of who sends little");
//! let order: Vec<&str> = std::iter::from_fn(|| queue.pop()).map(|(_, work)| work).collect();
//! assert!(order.iter().position(|work| *work == "of who sends little").expect("done") < 2);
//! ```
#![forbid(unsafe_code)]

mod connections;
mod fair_queue;
mod throttle;

pub use connections::{Connections, Entry, Guest, Limits, Place};
pub use fair_queue::FairQueue;
pub use throttle::{Kind, Throttle};
