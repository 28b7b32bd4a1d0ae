//! The bus within one process: members of a group take turns.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use tokio::sync::{mpsc, oneshot};

use crate::ClusterError;
use crate::bus::subject::Subject;

/// Requests that may wait for one member; more are as lost as those of a member that is too slow for its connection.
const WAITING: usize = 1024;

type Asked = (Bytes, Reply);

/// The groups.
#[derive(Clone, Default)]
pub(crate) struct Process(Arc<Mutex<Groups>>);

#[derive(Default)]
struct Groups {
    groups: HashMap<Subject, Group>,
    /// Of the next member.
    next_place: u64,
}

#[derive(Default)]
struct Group {
    places: Vec<Place>,
    /// Whose turn it is.
    turn: usize,
}

struct Place {
    number: u64,
    ask: mpsc::Sender<Asked>,
}

impl Process {
    /// What the messages of a NATS server have at most.
    pub(crate) const MAX_PAYLOAD: usize = 64 << 20;

    fn groups(&self) -> MutexGuard<'_, Groups> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) async fn request(&self, subject: &Subject, payload: Bytes) -> Result<Bytes, ClusterError> {
        let (reply, answer) = oneshot::channel();
        {
            let mut groups = self.groups();
            let group = groups.groups.get_mut(subject).filter(|group| !group.places.is_empty());
            let Group { places, turn } =
                group.ok_or_else(|| ClusterError::Nobody { subject: subject.clone() })?;
            *turn = turn.wrapping_add(1);
            // One that cannot take it loses it, as a slow connection would.
            let _ = places[*turn % places.len()].ask.try_send((payload, Reply(reply)));
        }
        match answer.await {
            Ok(bytes) => Ok(bytes),
            // Dropped unanswered: as with any bus, who asked finds out by waiting.
            Err(_) => std::future::pending().await,
        }
    }

    pub(crate) fn join(&self, subject: &Subject) -> Membership {
        let (ask, asked) = mpsc::channel(WAITING);
        let mut groups = self.groups();
        let number = groups.next_place;
        groups.next_place += 1;
        groups.groups.entry(subject.clone()).or_default().places.push(Place { number, ask });
        Membership { process: self.clone(), subject: subject.clone(), number, asked }
    }
}

pub(crate) struct Membership {
    process: Process,
    subject: Subject,
    number: u64,
    asked: mpsc::Receiver<Asked>,
}

impl Membership {
    pub(crate) async fn next(&mut self) -> Option<Asked> {
        self.asked.recv().await
    }

    /// The channel ends with its sender; what is in it is still given.
    pub(crate) fn leave(&mut self) {
        let mut groups = self.process.groups();
        if let Some(group) = groups.groups.get_mut(&self.subject) {
            group.places.retain(|place| place.number != self.number);
            if group.places.is_empty() {
                groups.groups.remove(&self.subject);
            }
        }
    }
}

impl Drop for Membership {
    fn drop(&mut self) {
        self.leave();
    }
}

/// The way back.
pub(crate) struct Reply(oneshot::Sender<Bytes>);

impl Reply {
    pub(crate) async fn cancelled(&mut self) {
        self.0.closed().await;
    }

    pub(crate) fn send(self, payload: Bytes) -> Result<(), ClusterError> {
        if payload.len() > Process::MAX_PAYLOAD {
            return Err(ClusterError::MessageTooLong { bytes: payload.len(), longest: Process::MAX_PAYLOAD });
        }
        // Whoever asked may have given up.
        let _ = self.0.send(payload);
        Ok(())
    }
}
