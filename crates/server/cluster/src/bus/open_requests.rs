//! Requests that a member received over NATS and has not answered, for cancellation.
//!
//! Requests and cancel messages come by two subscriptions without a common order: a process that was suspended may
//! read the cancel message before its request.

use std::collections::{HashMap, VecDeque};
use std::sync::{Mutex, MutexGuard, PoisonError};

use tokio::sync::oneshot;

/// Number of cancel messages stored before their request arrives. Members receive the cancel messages of all members,
/// so most of these requests never arrive.
const EARLY: usize = 256;

/// Maximum length of a stored inbox, bytes; ours are a third of that.
const MAX_INBOX_LEN: usize = 256;

/// Open requests by reply inbox.
#[derive(Default)]
pub(crate) struct OpenRequests(Mutex<OpenState>);

#[derive(Default)]
struct OpenState {
    requests: HashMap<String, oneshot::Sender<()>>,
    early: VecDeque<String>,
}

impl OpenRequests {
    fn state(&self) -> MutexGuard<'_, OpenState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A request arrived. The receiver is notified when it is cancelled, at once if the cancel message arrived earlier.
    pub(crate) fn received(&self, inbox: &str) -> oneshot::Receiver<()> {
        let (notify, cancelled) = oneshot::channel();
        let mut state = self.state();
        match state.early.iter().position(|early| early == inbox) {
            Some(position) => {
                state.early.remove(position);
                // The receiver is in this function.
                let _ = notify.send(());
            }
            None => {
                state.requests.insert(inbox.to_owned(), notify);
            }
        }
        cancelled
    }

    /// Removes a request that was answered or dropped.
    pub(crate) fn ended(&self, inbox: &str) {
        self.state().requests.remove(inbox);
    }

    /// Handles a cancel message for this inbox.
    pub(crate) fn cancel(&self, inbox: &str) {
        let mut state = self.state();
        if let Some(work) = state.requests.remove(inbox) {
            let _ = work.send(());
        } else if inbox.len() <= MAX_INBOX_LEN {
            if state.early.len() == EARLY {
                state.early.pop_front();
            }
            state.early.push_back(inbox.to_owned());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cancel_message_may_arrive_before_or_after_its_request() {
        let open = OpenRequests::default();
        let (mut before, mut other) = (open.received("_INBOX.a.1"), open.received("_INBOX.a.2"));
        open.cancel("_INBOX.a.1");
        before.try_recv().expect("cancelled");
        other.try_recv().expect_err("not cancelled");

        open.cancel("_INBOX.a.3");
        open.received("_INBOX.a.3").try_recv().expect("cancelled at once");
        open.received("_INBOX.a.3").try_recv().expect_err("a cancel message applies to one request");

        open.ended("_INBOX.a.2");
        assert!(open.state().early.is_empty());
    }

    #[test]
    fn early_cancel_messages_are_bounded() {
        let open = OpenRequests::default();
        open.cancel(&"x".repeat(1 << 20));
        for number in 0..=EARLY {
            open.cancel(&number.to_string());
        }
        assert_eq!(open.state().early.len(), EARLY);
        open.received("0").try_recv().expect_err("dropped for later ones");
        open.received("1").try_recv().expect("stored");
    }
}
