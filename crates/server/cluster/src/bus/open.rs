//! What a member was asked over NATS and has not answered, and who of those that asked no longer waits.
//!
//! Questions and what is no longer waited for come by two subscriptions, whose order to each other is not kept: a process
//! that was halted for a while finds both at once, and may read first that nobody waits for what it is asked next.

use std::collections::{HashMap, VecDeque};
use std::sync::{Mutex, MutexGuard, PoisonError};

use tokio::sync::oneshot;

/// Inboxes remembered that no question has come from yet. Members hear what all others are told, so most of them never do.
const EARLY: usize = 256;

/// Bytes of an inbox that is remembered; ours are a third of that.
const LONGEST_INBOX: usize = 256;

/// By the inbox of who asked.
#[derive(Default)]
pub(crate) struct Open(Mutex<Both>);

#[derive(Default)]
struct Both {
    asked: HashMap<String, oneshot::Sender<()>>,
    early: VecDeque<String>,
}

impl Open {
    fn both(&self) -> MutexGuard<'_, Both> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A request arrived. The receiver is notified when it is cancelled, at once if the cancel message arrived earlier.
    pub(crate) fn asked(&self, inbox: &str) -> oneshot::Receiver<()> {
        let (cancel, cancelled) = oneshot::channel();
        let mut both = self.both();
        match both.early.iter().position(|early| early == inbox) {
            Some(place) => {
                both.early.remove(place);
                // Its receiver is here.
                let _ = cancel.send(());
            }
            None => {
                both.asked.insert(inbox.to_owned(), cancel);
            }
        }
        cancelled
    }

    /// It was answered, or nobody works on it.
    pub(crate) fn ended(&self, inbox: &str) {
        self.both().asked.remove(inbox);
    }

    /// Nobody waits at this inbox any more.
    pub(crate) fn not_waited_for(&self, inbox: &str) {
        let mut both = self.both();
        if let Some(work) = both.asked.remove(inbox) {
            let _ = work.send(());
        } else if inbox.len() <= LONGEST_INBOX {
            if both.early.len() == EARLY {
                both.early.pop_front();
            }
            both.early.push_back(inbox.to_owned());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_question_may_come_before_the_word_that_nobody_waits_or_after_it() {
        let open = Open::default();
        let (mut before, mut other) = (open.asked("_INBOX.a.1"), open.asked("_INBOX.a.2"));
        open.not_waited_for("_INBOX.a.1");
        before.try_recv().expect("told");
        other.try_recv().expect_err("somebody waits");

        open.not_waited_for("_INBOX.a.3");
        open.asked("_INBOX.a.3").try_recv().expect("told at once");
        open.asked("_INBOX.a.3").try_recv().expect_err("a word holds for one question");

        open.ended("_INBOX.a.2");
        assert!(open.both().early.is_empty());
    }

    #[test]
    fn what_is_remembered_is_bounded() {
        let open = Open::default();
        open.not_waited_for(&"x".repeat(1 << 20));
        for number in 0..=EARLY {
            open.not_waited_for(&number.to_string());
        }
        assert_eq!(open.both().early.len(), EARLY);
        open.asked("0").try_recv().expect_err("pushed out by later ones");
        open.asked("1").try_recv().expect("remembered");
    }
}
