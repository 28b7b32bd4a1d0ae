//! A place in the group of one object: what is asked of it is worked on by the worker's threads.

use std::sync::Arc;

use crate::bus::{Incoming, Membership};
use tokio::sync::watch;
use tokio::task::{JoinHandle, JoinSet};
use veiloc_map::regions::ObjectId;

use super::content::Content;
use super::executor::{Done, Executor};
use crate::message::{Outcome, Reply, Request, Why};

/// An object that is held, and the task that answers for it.
pub(crate) struct Subscription {
    leave: watch::Sender<bool>,
    answering: JoinHandle<()>,
}

impl Subscription {
    /// Answers what is asked of a member that holds this object.
    pub(crate) fn take(
        executor: Arc<Executor>,
        object: ObjectId,
        content: Content,
        membership: Membership,
    ) -> Self {
        let (leave, left) = watch::channel(false);
        let responder = Arc::new(Responder { executor, object, content: Arc::new(content) });
        Self { leave, answering: tokio::spawn(answer_all(responder, membership, left)) }
    }

    /// Leaves the group; what was asked before is answered. Returns when it is.
    pub(crate) async fn leave(self) {
        self.leave.send_replace(true);
        // It ends by itself; a panic of it is logged by whoever watches the process's.
        let _ = self.answering.await;
    }
}

struct Responder {
    executor: Arc<Executor>,
    object: ObjectId,
    content: Arc<Content>,
}

async fn answer_all(responder: Arc<Responder>, mut membership: Membership, mut leave: watch::Receiver<bool>) {
    let mut answering = JoinSet::new();
    let mut left = false;
    loop {
        tokio::select! {
            incoming = membership.next() => match incoming {
                Some(incoming) => {
                    answering.spawn(answer(responder.clone(), incoming));
                }
                None => break,
            },
            // A sender that is gone leaves too: its worker was dropped.
            () = told(&mut leave), if !left => {
                left = true;
                membership.leave().await;
            }
            Some(_) = answering.join_next(), if !answering.is_empty() => {}
        }
    }
    while answering.join_next().await.is_some() {}
}

/// Returns when the word is given, or nobody is left who could.
async fn told(leave: &mut watch::Receiver<bool>) {
    let _ = leave.wait_for(|leave| *leave).await;
}

async fn answer(responder: Arc<Responder>, mut incoming: Incoming) {
    let (name, done) = match Request::decode(incoming.payload.clone()) {
        Ok(request) if request.object == responder.object => {
            let name = request.name;
            tokio::select! {
                biased;
                done = responder.executor.work(request, &responder.content) => (name, done),
                // Another copy was answered first, the device has left, or time is over: nobody waits for a reply.
                () = incoming.cancelled() => return,
            }
        }
        Ok(request) => (request.name, Done::at_once(Outcome::Rejected(Why::NotHeld))),
        Err(error) => {
            tracing::warn!(%error, "a request was not understood");
            ([0; 16], Done::at_once(Outcome::Rejected(Why::Unread)))
        }
    };
    responder.executor.said(&done.outcome);
    let Done { outcome, worked, waited } = done;
    if let Err(error) = incoming.answer(Reply { name, outcome, worked, waited }.encode()).await {
        tracing::warn!(%error, "a reply could not be sent");
    }
}
