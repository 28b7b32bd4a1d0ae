//! A request in flight, from its head to the last byte of its response body.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use crate::queue::Connection;
use hyper::body::{Body, Frame, SizeHint};

/// Guard: the request counts as in flight while this exists.
pub(crate) struct InFlightRequest {
    connection: Arc<Connection>,
    /// Whether the response was produced before the guard was dropped.
    is_answered: bool,
}

impl InFlightRequest {
    pub(crate) fn begin(connection: Arc<Connection>) -> Self {
        connection.request_started();
        Self { connection, is_answered: false }
    }

    /// The response was produced; its body keeps the guard until it is sent.
    pub(crate) const fn with_body<B>(mut self, body: B) -> InFlightBody<B> {
        self.is_answered = true;
        InFlightBody { body, _in_flight: self }
    }
}

impl Drop for InFlightRequest {
    fn drop(&mut self) {
        if self.is_answered {
            self.connection.request_answered();
        } else {
            // No response will be written.
            self.connection.request_aborted();
        }
    }
}

/// A response body that keeps the guard.
pub(crate) struct InFlightBody<B> {
    body: B,
    _in_flight: InFlightRequest,
}

impl<B: Body + Unpin> Body for InFlightBody<B> {
    type Data = B::Data;
    type Error = B::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<B::Data>, B::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
