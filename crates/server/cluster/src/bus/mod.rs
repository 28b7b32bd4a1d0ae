//! Requests to whichever member of a group is there, and its reply: what a service of many machines talks over.
//!
//! - [`Bus`]: [`Bus::request`] asks one member of the group of a [`Subject`], [`Bus::join`] makes one a member. Over NATS
//!   ([`Bus::nats`]), or within one process ([`Bus::in_process`]): both keep the same promises.
//! - [`Membership`]: what is asked of a member, until it leaves.
//!
//! # What is promised
//! A request goes to **at most one** member. It is answered, or it ends with a [`ClusterError`] that says whether there was
//! nobody ([`ClusterError::Nobody`], known at once) or nobody answered in time ([`ClusterError::TimedOut`]); a member that dies
//! looks like the second. Whoever needs an answer sends the same bytes again. Nothing is stored: a message that nobody
//! waits for is gone.
//!
//! A requester that stops waiting may cancel its request ([`Bus::request_cancellable`]). The member that received it is then
//! notified ([`Incoming::cancelled`]), best effort and once. Only the requester can cancel.
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
//! let nobody = bus.request(&subject, "hello".into(), Duration::from_secs(1)).await;
//! assert!(matches!(nobody, Err(ClusterError::Nobody { .. })));
//!
//! let mut member = bus.join(&subject).await?;
//! tokio::spawn(async move {
//!     while let Some(asked) = member.next().await {
//!         asked.answer("good day".into()).await.expect("somebody waits");
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
mod open;
mod process;
mod subject;

use crate::ClusterError;
use std::fmt;
use std::time::Duration;

use bytes::Bytes;

pub use nats::NatsOptions;
pub use subject::{BadWord, Subject};

use nats::Nats;
use process::Process;

/// Where requests go; a clone is the same bus.
#[derive(Clone)]
pub struct Bus(Road);

#[derive(Clone)]
enum Road {
    Nats(Nats),
    Process(Process),
}

impl Bus {
    /// Within this process, for tests and for a cluster on one machine.
    pub fn in_process() -> Self {
        Self(Road::Process(Process::default()))
    }

    /// Over NATS. Once connected it stays so by itself: a server that goes is exchanged for another one.
    ///
    /// # Errors
    /// [`ClusterError`]: an address that is none, files that cannot be read, no server that answers, or one that takes only
    /// shorter messages than are needed.
    pub async fn nats(options: &NatsOptions) -> Result<Self, ClusterError> {
        Nats::connect(options).await.map(|nats| Self(Road::Nats(nats)))
    }

    /// The longest message, bytes.
    pub fn max_payload(&self) -> usize {
        match &self.0 {
            Road::Nats(nats) => nats.max_payload(),
            Road::Process(_) => Process::MAX_PAYLOAD,
        }
    }

    /// Whether there is a server at the moment.
    pub fn is_connected(&self) -> bool {
        match &self.0 {
            Road::Nats(nats) => nats.is_connected(),
            Road::Process(_) => true,
        }
    }

    /// Waits until all messages so far have left this machine, at most a few seconds.
    pub async fn flush(&self) {
        if let Road::Nats(nats) = &self.0 {
            nats.flush().await;
        }
    }

    /// Asks one member of the subject's group.
    ///
    /// # Errors
    /// [`ClusterError`]: nobody is there, nobody answered in time, or the message is too long.
    pub async fn request(
        &self,
        subject: &Subject,
        payload: Bytes,
        within: Duration,
    ) -> Result<Bytes, ClusterError> {
        self.ask(subject, payload, within, false).await
    }

    /// As [`Self::request`], for what keeps its member busy: when nobody waits for the reply any more, because the future
    /// was dropped or time is over, the member is told ([`Incoming::cancelled`]). That is not certain to reach it.
    ///
    /// # Errors
    /// As [`Self::request`].
    pub async fn request_cancellable(
        &self,
        subject: &Subject,
        payload: Bytes,
        within: Duration,
    ) -> Result<Bytes, ClusterError> {
        self.ask(subject, payload, within, true).await
    }

    async fn ask(
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
                Road::Nats(nats) => nats.request(subject, payload, cancellable).await,
                Road::Process(process) => process.request(subject, payload).await,
            }
        };
        let timed_out = || ClusterError::TimedOut { subject: subject.clone(), within };
        tokio::time::timeout(within, answered).await.map_err(|_| timed_out())?
    }

    /// Becomes a member of the subject's group; what is asked of it from then on is in the [`Membership`].
    ///
    /// # Errors
    /// [`ClusterError::BusClosed`]: the connection is gone for good.
    pub async fn join(&self, subject: &Subject) -> Result<Membership, ClusterError> {
        Ok(Membership(match &self.0 {
            Road::Nats(nats) => Member::Nats(nats.join(subject).await?),
            Road::Process(process) => Member::Process(process.join(subject)),
        }))
    }
}

impl fmt::Debug for Bus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.0 {
            Road::Nats(_) => "Bus(NATS)",
            Road::Process(_) => "Bus(in process)",
        })
    }
}

/// A place in the group of a subject. When it is dropped nothing more is asked of it, and what was asked is lost.
pub struct Membership(Member);

enum Member {
    Nats(nats::Membership),
    Process(process::Membership),
}

impl Membership {
    /// The next request, once there is one; `None` after [`Self::leave`], when all that was asked before has been given.
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

    /// Leaves the group; what was asked before is still given by [`Self::next`].
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

/// A request, and the way back to who asked.
pub struct Incoming {
    /// What was sent.
    pub payload: Bytes,
    to: Reply,
}

enum Reply {
    Nats(nats::Reply),
    Process(process::Reply),
}

impl Incoming {
    /// Returns when the requester has cancelled; never, when no cancel message arrives. Must not be awaited again after it
    /// returned.
    pub async fn cancelled(&mut self) {
        match &mut self.to {
            Reply::Nats(reply) => reply.cancelled().await,
            Reply::Process(reply) => reply.cancelled().await,
        }
    }

    /// Answers it. Whether anybody still waits is not known.
    ///
    /// # Errors
    /// [`ClusterError`]: the answer is too long, or the connection is gone for good.
    pub async fn answer(self, payload: Bytes) -> Result<(), ClusterError> {
        match self.to {
            Reply::Nats(reply) => reply.send(payload).await,
            Reply::Process(reply) => reply.send(payload),
        }
    }
}

/// Of what was sent the length, and no more.
impl fmt::Debug for Incoming {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Incoming({} bytes)", self.payload.len())
    }
}
