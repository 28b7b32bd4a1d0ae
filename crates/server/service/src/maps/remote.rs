//! Maps in other processes: the service accepts the query and sends the answer, a remote backend computes the pose.
//!
//! Authentication, refusals, padding and metrics are the same as for a local map. No thread waits for the answer: the
//! number of connections bounds the number of remote queries in flight, and their queue is that of the other process.

use std::fmt;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use crate::auth::TokenKey;
use crate::telemetry::{RequestContext, RequestId};
use veiloc_protocol::{Answer, MapCoordinates, PositionHint, Profile};

use crate::routes::decoded_request::{DecodedRequest, LocalizeFailure};

/// A map as described by its remote backend.
#[derive(Debug, Clone)]
pub struct MapDescription {
    /// The profile with which a device seals.
    pub profile: Profile,
    /// Registered images.
    pub images: usize,
    /// Map points.
    pub points: usize,
    /// What the coordinates of the map mean.
    pub coordinates: MapCoordinates,
}

/// One request to a remote backend.
pub struct RemoteRequest {
    /// Id of the request.
    pub id: RequestId,
    /// The token of the client; `None` where clients are not distinguished.
    pub client: Option<TokenKey>,
    /// The decoded body.
    pub decoded: DecodedRequest,
    /// The body as received. A retry sends the same bytes (rule L7).
    pub bytes: Vec<u8>,
    /// A prior of the camera position, if the client sent one.
    pub near: Option<PositionHint>,
    /// Time limit, from now.
    pub within: Duration,
    /// The context in which requests to other machines are recorded; `None` if no traces are sent.
    pub trace: Option<Arc<RequestContext>>,
}

/// Rule L8: nothing of a query reaches a log.
impl fmt::Debug for RemoteRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RemoteRequest")
            .field("id", &self.id)
            .field("decoded", &self.decoded)
            .finish_non_exhaustive()
    }
}

/// The future answer of a remote backend.
pub type AnswerFuture<'a> = Pin<Box<dyn Future<Output = Result<Answer, LocalizeFailure>> + Send + 'a>>;

/// A process or a cluster that holds a map.
pub trait RemoteBackend: Send + Sync {
    /// Describes the current map; returns the same `Arc` until the map changes. `None` before the first one.
    fn describe(&self) -> Option<Arc<MapDescription>>;

    /// Whether queries can be answered in every part of the map. If not, the map counts as not served in `/readyz`, but
    /// queries are accepted.
    fn is_complete(&self) -> bool;

    /// Requests a pose.
    fn localize(&self, request: RemoteRequest) -> AnswerFuture<'_>;
}

/// A map of a remote backend, and the name under which it is served.
#[derive(Clone)]
pub struct RemoteMap {
    /// As [`crate::MapSource::name`].
    pub name: String,
    /// The backend.
    pub backend: Arc<dyn RemoteBackend>,
}

impl fmt::Debug for RemoteMap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RemoteMap").field("name", &self.name).finish_non_exhaustive()
    }
}
