//! A request that is being answered, from its head to the last byte of its answer's body.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use crate::queue::Guest;
use hyper::body::{Body, Frame, SizeHint};

/// Counts as being answered as long as it lives.
pub(crate) struct Answering {
    guest: Arc<Guest>,
    /// Whether the answer was made, and not given up before.
    is_made: bool,
}

impl Answering {
    pub(crate) fn begin(guest: Arc<Guest>) -> Self {
        guest.begin();
        Self { guest, is_made: false }
    }

    /// The answer is made; what is left is to send its body.
    pub(crate) const fn with_body<B>(mut self, body: B) -> Sending<B> {
        self.is_made = true;
        Sending { body, _answering: self }
    }
}

impl Drop for Answering {
    fn drop(&mut self) {
        if self.is_made {
            self.guest.answered();
        } else {
            // Nothing will be written for it.
            self.guest.gave_up();
        }
    }
}

/// The body of an answer.
pub(crate) struct Sending<B> {
    body: B,
    _answering: Answering,
}

impl<B: Body + Unpin> Body for Sending<B> {
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
