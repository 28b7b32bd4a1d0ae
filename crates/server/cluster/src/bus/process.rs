//! The bus within one process: the members of a group take turns.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use tokio::sync::{mpsc, oneshot};

use crate::ClusterError;
use crate::bus::subject::Subject;

/// Pending requests per member, and messages per listener; further ones are lost, as on a connection of NATS that is too slow.
const MEMBER_QUEUE: usize = 1024;

type Delivery = (Bytes, Reply);

/// The groups.
#[derive(Clone, Default)]
pub(crate) struct Process(Arc<Mutex<Groups>>);

#[derive(Default)]
struct Groups {
    by_subject: HashMap<Subject, Group>,
    listeners: HashMap<Subject, Vec<mpsc::Sender<Bytes>>>,
    /// Number of the next member.
    next_number: u64,
}

#[derive(Default)]
struct Group {
    members: Vec<GroupMember>,
    /// Index of the last member that got a request.
    turn: usize,
}

struct GroupMember {
    number: u64,
    sender: mpsc::Sender<Delivery>,
}

impl Process {
    /// The maximum that NATS allows.
    pub(crate) const MAX_PAYLOAD: usize = 64 << 20;

    fn groups(&self) -> MutexGuard<'_, Groups> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) async fn request(&self, subject: &Subject, payload: Bytes) -> Result<Bytes, ClusterError> {
        let (reply, answer) = oneshot::channel();
        {
            let mut groups = self.groups();
            let group = groups.by_subject.get_mut(subject).filter(|group| !group.members.is_empty());
            let Group { members, turn } =
                group.ok_or_else(|| ClusterError::NoResponders { subject: subject.clone() })?;
            *turn = turn.wrapping_add(1);
            // A full queue drops the request, as a slow connection would.
            let _ = members[*turn % members.len()].sender.try_send((payload, Reply(reply)));
        }
        match answer.await {
            Ok(bytes) => Ok(bytes),
            // Dropped without a reply: as over NATS, the requester waits until its timeout.
            Err(_) => std::future::pending().await,
        }
    }

    pub(crate) fn publish(&self, subject: &Subject, payload: &Bytes) {
        if let Some(listeners) = self.groups().listeners.get_mut(subject) {
            // A full queue loses the message, as a slow connection would.
            let is_open = |listener: &mpsc::Sender<Bytes>| {
                !matches!(listener.try_send(payload.clone()), Err(mpsc::error::TrySendError::Closed(_)))
            };
            listeners.retain(is_open);
        }
    }

    pub(crate) fn listen(&self, subject: &Subject) -> mpsc::Receiver<Bytes> {
        let (sender, messages) = mpsc::channel(MEMBER_QUEUE);
        self.groups().listeners.entry(subject.clone()).or_default().push(sender);
        messages
    }

    pub(crate) fn join(&self, subject: &Subject) -> Membership {
        let (sender, requests) = mpsc::channel(MEMBER_QUEUE);
        let mut groups = self.groups();
        let number = groups.next_number;
        groups.next_number += 1;
        groups.by_subject.entry(subject.clone()).or_default().members.push(GroupMember { number, sender });
        Membership { process: self.clone(), subject: subject.clone(), number, requests }
    }
}

pub(crate) struct Membership {
    process: Process,
    subject: Subject,
    number: u64,
    requests: mpsc::Receiver<Delivery>,
}

impl Membership {
    pub(crate) async fn next(&mut self) -> Option<Delivery> {
        self.requests.recv().await
    }

    /// The channel closes with its sender; pending requests are still returned.
    pub(crate) fn leave(&mut self) {
        let mut groups = self.process.groups();
        if let Some(group) = groups.by_subject.get_mut(&self.subject) {
            group.members.retain(|member| member.number != self.number);
            if group.members.is_empty() {
                groups.by_subject.remove(&self.subject);
            }
        }
    }
}

impl Drop for Membership {
    fn drop(&mut self) {
        self.leave();
    }
}

/// Reply channel of a request.
pub(crate) struct Reply(oneshot::Sender<Bytes>);

impl Reply {
    pub(crate) async fn cancelled(&mut self) {
        self.0.closed().await;
    }

    pub(crate) fn send(self, payload: Bytes) -> Result<(), ClusterError> {
        if payload.len() > Process::MAX_PAYLOAD {
            return Err(ClusterError::MessageTooLong { bytes: payload.len(), longest: Process::MAX_PAYLOAD });
        }
        // The requester may be gone.
        let _ = self.0.send(payload);
        Ok(())
    }
}
