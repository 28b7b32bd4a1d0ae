//! Maps that others hold: the service takes the query and gives the answer, and asks them for the pose.
//!
//! What a request goes through (tokens, the fair queue, refusals, padding, metrics) is the same as for a map in memory:
//! a thread of the pool asks [`Elsewhere`] in the place of localizing, and waits. So the pool's threads are the queries
//! that may be under way at a time.

use std::fmt;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use crate::telemetry::RequestId;
use veiloc_protocol::{Answer, PositionHint, Profile};

use crate::asked::{Asked, Unanswered};

/// A map as those who hold it describe it.
#[derive(Debug, Clone)]
pub struct Description {
    /// What a device needs.
    pub profile: Profile,
    /// Registered images.
    pub images: usize,
    /// Map points.
    pub points: usize,
}

/// What is asked of them.
pub struct Question {
    /// The name of the request.
    pub request: RequestId,
    /// What was sent, read.
    pub asked: Asked,
    /// What was sent, to the byte: whoever is asked again is sent the same (rule L7).
    pub bytes: Vec<u8>,
    /// Where the camera roughly is, if the caller says so.
    pub near: Option<PositionHint>,
    /// How long an answer may take from now.
    pub within: Duration,
}

/// Rule L8: nothing of a query reaches a log.
impl fmt::Debug for Question {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Question")
            .field("request", &self.request)
            .field("asked", &self.asked)
            .finish_non_exhaustive()
    }
}

/// An answer to come.
pub type Answering<'a> = Pin<Box<dyn Future<Output = Result<Answer, Unanswered>> + Send + 'a>>;

/// Somebody who holds a map.
pub trait Elsewhere: Send + Sync {
    /// The map as it is now; the same `Arc` as long as it is the same. `None` while nobody holds it whole.
    fn describe(&self) -> Option<Arc<Description>>;

    /// The longest body that gets there, bytes.
    fn longest(&self) -> usize;

    /// Asks for the pose.
    fn localize(&self, question: Question) -> Answering<'_>;
}

/// A map that others hold, and the name it is served under.
#[derive(Clone)]
pub struct MapElsewhere {
    /// As [`crate::MapSource::name`].
    pub name: String,
    /// Who holds it.
    pub held_by: Arc<dyn Elsewhere>,
}

impl fmt::Debug for MapElsewhere {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("MapElsewhere").field("name", &self.name).finish_non_exhaustive()
    }
}
