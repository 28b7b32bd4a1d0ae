//! Request/reply messaging: a request goes to one member of a group, and its reply comes back. All machines of a
//! cluster communicate over this bus.
//!
//! - [`Bus`]: [`Bus::request`] sends a request to one member of the group of a [`Subject`], [`Bus::join`] makes the
//!   caller a member. The transport is NATS ([`Bus::nats`]) or the local process ([`Bus::in_process`]); both give the
//!   same guarantees.
//! - [`Membership`]: receives the requests to a member until it leaves.
//! - [`Bus::publish`] sends a message to every [`Listener`] of a subject, best effort and without a reply.
//!
//! # Guarantees
//! A request goes to **at most one** member. It is answered, or it ends with a [`ClusterError`]: the group is empty
//! ([`ClusterError::NoResponders`], known at once), or no reply came in time ([`ClusterError::TimedOut`]), which also
//! covers a member that died. A client that needs an answer sends the same bytes again. Nothing is stored: a reply
//! after the timeout is dropped.
//!
//! A requester that stops waiting may cancel its request ([`Bus::request_cancellable`]). The member that received it
//! is then notified ([`Incoming::cancelled`]), best effort and once. Only the requester can cancel.
//!
//! This module does not depend on maps or queries.
//!
//! ```
//! use std::time::Duration;
//! use veiloc_cluster::ClusterError;
//! use veiloc_cluster::bus::{Bus, Subject};
//!
//! # let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
//! # runtime.block_on(async {
//! let bus = Bus::in_process();
//! let subject = Subject::new(["greeting", "en"])?;
//! let empty_group = bus.request(&subject, "hello".into(), Duration::from_secs(1)).await;
//! assert!(matches!(empty_group, Err(ClusterError::NoResponders { .. })));
//!
//! let mut member = bus.join(&subject).await?;
//! tokio::spawn(async move {
//!     while let Some(incoming) = member.next().await {
//!         incoming.answer("good day".into()).await.expect("sent");
//!     }
//! });
//! let reply = bus.request(&subject, "hello".into(), Duration::from_secs(5)).await?;
//! assert_eq!(&reply[..], b"good day");
//! # Ok::<(), ClusterError>(())
//! # })?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![forbid(unsafe_code)]

mod nats;
mod open_requests;
mod process;
mod subject;

use crate::ClusterError;
use std::fmt;
use std::time::Duration;

use bytes::Bytes;
use futures_util::StreamExt as _;

pub use nats::NatsOptions;
pub use subject::{InvalidSubjectWord, Subject};

use nats::Nats;
use process::Process;

/// The bus; clones share it.
#[derive(Clone)]
pub struct Bus(Transport);

#[derive(Clone)]
enum Transport {
    Nats(Nats),
    Process(Process),
}

impl Bus {
    /// A bus within this process, for tests and for a cluster on one machine.
    pub fn in_process() -> Self {
        Self(Transport::Process(Process::default()))
    }

    /// A bus over NATS. It reconnects by itself, also to another server of the cluster.
    ///
    /// # Errors
    /// [`ClusterError`]: an invalid address, an unreadable file, no reachable server, or a server whose maximum
    /// message is too short.
    pub async fn nats(options: &NatsOptions) -> Result<Self, ClusterError> {
        Nats::connect(options).await.map(|nats| Self(Transport::Nats(nats)))
    }

    /// Maximum length of a message, bytes.
    pub fn max_payload(&self) -> usize {
        match &self.0 {
            Transport::Nats(nats) => nats.max_payload(),
            Transport::Process(_) => Process::MAX_PAYLOAD,
        }
    }

    /// Whether a server is connected.
    pub fn is_connected(&self) -> bool {
        match &self.0 {
            Transport::Nats(nats) => nats.is_connected(),
            Transport::Process(_) => true,
        }
    }

    /// Waits until all sent messages have left this machine, at most a few seconds.
    pub async fn flush(&self) {
        if let Transport::Nats(nats) = &self.0 {
            nats.flush().await;
        }
    }

    /// Sends a request to one member of the subject's group.
    ///
    /// # Errors
    /// [`ClusterError`]: the group is empty, no reply came in time, or the message is too long.
    pub async fn request(
        &self,
        subject: &Subject,
        payload: Bytes,
        within: Duration,
    ) -> Result<Bytes, ClusterError> {
        self.send_request(subject, payload, within, false).await
    }

    /// As [`Self::request`], for expensive requests: when the future is dropped or times out, the member is notified,
    /// best effort ([`Incoming::cancelled`]).
    ///
    /// # Errors
    /// As [`Self::request`].
    pub async fn request_cancellable(
        &self,
        subject: &Subject,
        payload: Bytes,
        within: Duration,
    ) -> Result<Bytes, ClusterError> {
        self.send_request(subject, payload, within, true).await
    }

    async fn send_request(
        &self,
        subject: &Subject,
        payload: Bytes,
        within: Duration,
        cancellable: bool,
    ) -> Result<Bytes, ClusterError> {
        let longest = self.max_payload();
        if payload.len() > longest {
            return Err(ClusterError::MessageTooLong { bytes: payload.len(), longest });
        }
        let answered = async {
            match &self.0 {
                Transport::Nats(nats) => nats.request(subject, payload, cancellable).await,
                Transport::Process(process) => process.request(subject, payload).await,
            }
        };
        let timed_out = || ClusterError::TimedOut { subject: subject.clone(), within };
        tokio::time::timeout(within, answered).await.map_err(|_| timed_out())?
    }

    /// Sends a message to all listeners of the subject. Whether there are any is not known.
    ///
    /// # Errors
    /// [`ClusterError`]: the message is too long, or the connection is closed for good.
    pub async fn publish(&self, subject: &Subject, payload: Bytes) -> Result<(), ClusterError> {
        let longest = self.max_payload();
        if payload.len() > longest {
            return Err(ClusterError::MessageTooLong { bytes: payload.len(), longest });
        }
        match &self.0 {
            Transport::Nats(nats) => nats.publish(subject, payload).await,
            Transport::Process(process) => {
                process.publish(subject, &payload);
                Ok(())
            }
        }
    }

    /// Listens to the messages that are published to the subject from now on.
    ///
    /// # Errors
    /// [`ClusterError::BusClosed`]: the connection is closed for good.
    pub async fn listen(&self, subject: &Subject) -> Result<Listener, ClusterError> {
        Ok(Listener(match &self.0 {
            Transport::Nats(nats) => Messages::Nats(nats.listen(subject).await?),
            Transport::Process(process) => Messages::Process(process.listen(subject)),
        }))
    }

    /// Joins the subject's group; the [`Membership`] receives its requests.
    ///
    /// # Errors
    /// [`ClusterError::BusClosed`]: the connection is closed for good.
    pub async fn join(&self, subject: &Subject) -> Result<Membership, ClusterError> {
        Ok(Membership(match &self.0 {
            Transport::Nats(nats) => Member::Nats(nats.join(subject).await?),
            Transport::Process(process) => Member::Process(process.join(subject)),
        }))
    }
}

impl fmt::Debug for Bus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.0 {
            Transport::Nats(_) => "Bus(NATS)",
            Transport::Process(_) => "Bus(in process)",
        })
    }
}

/// Receives the published messages of a subject until it is dropped. Messages that arrive while 1024 (in one process) or
/// 65 536 (NATS) others wait are lost.
pub struct Listener(Messages);

enum Messages {
    Nats(async_nats::Subscriber),
    Process(tokio::sync::mpsc::Receiver<Bytes>),
}

impl Listener {
    /// Waits for the next message; `None` when the connection is closed for good.
    pub async fn next(&mut self) -> Option<Bytes> {
        match &mut self.0 {
            Messages::Nats(messages) => messages.next().await.map(|message| message.payload),
            Messages::Process(messages) => messages.recv().await,
        }
    }
}

impl fmt::Debug for Listener {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Listener").finish_non_exhaustive()
    }
}

/// Membership in the group of a subject. Dropping it leaves the group and loses pending requests.
pub struct Membership(Member);

enum Member {
    Nats(nats::Membership),
    Process(process::Membership),
}

impl Membership {
    /// Waits for the next request; `None` after [`Self::leave`], when all earlier requests were returned.
    pub async fn next(&mut self) -> Option<Incoming> {
        match &mut self.0 {
            Member::Nats(member) => {
                member.next().await.map(|(payload, to)| Incoming { payload, to: Reply::Nats(to) })
            }
            Member::Process(member) => {
                member.next().await.map(|(payload, to)| Incoming { payload, to: Reply::Process(to) })
            }
        }
    }

    /// Leaves the group; earlier requests are still returned by [`Self::next`].
    pub async fn leave(&mut self) {
        match &mut self.0 {
            Member::Nats(member) => member.leave().await,
            Member::Process(member) => member.leave(),
        }
    }
}

impl fmt::Debug for Membership {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Membership").finish_non_exhaustive()
    }
}

/// A received request, and its reply channel.
pub struct Incoming {
    /// The payload of the request.
    pub payload: Bytes,
    to: Reply,
}

enum Reply {
    Nats(nats::Reply),
    Process(process::Reply),
}

impl Incoming {
    /// Returns when the requester has cancelled; never, when no cancel message arrives. Must not be awaited again
    /// after it returned.
    pub async fn cancelled(&mut self) {
        match &mut self.to {
            Reply::Nats(reply) => reply.cancelled().await,
            Reply::Process(reply) => reply.cancelled().await,
        }
    }

    /// Sends the reply. Whether the requester still waits is not known.
    ///
    /// # Errors
    /// [`ClusterError`]: the reply is too long, or the connection is closed for good.
    pub async fn answer(self, payload: Bytes) -> Result<(), ClusterError> {
        match self.to {
            Reply::Nats(reply) => reply.send(payload).await,
            Reply::Process(reply) => reply.send(payload),
        }
    }
}

/// Prints only the length of the payload.
impl fmt::Debug for Incoming {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Incoming({} bytes)", self.payload.len())
    }
}
