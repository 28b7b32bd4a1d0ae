//! Membership in the group of one object, whose requests run on the threads of the worker.

use std::sync::Arc;

use crate::bus::{Incoming, Membership};
use tokio::sync::watch;
use tokio::task::{JoinHandle, JoinSet};
use veiloc_map::regions::ObjectId;

use super::content::Content;
use super::executor::{Done, Executor};
use crate::message::{RejectReason, Reply, ReplyOutcome, Request};

/// A held object, and the task that answers its requests.
pub(crate) struct Subscription {
    leave: watch::Sender<bool>,
    requests: JoinHandle<()>,
}

impl Subscription {
    /// Answers requests for this object.
    pub(crate) fn start(
        executor: Arc<Executor>,
        object: ObjectId,
        content: Content,
        membership: Membership,
    ) -> Self {
        let (leave, left) = watch::channel(false);
        let responder = Arc::new(Responder { executor, object, content: Arc::new(content) });
        Self { leave, requests: tokio::spawn(answer_all(responder, membership, left)) }
    }

    /// Leaves the group; returns when earlier requests are answered.
    pub(crate) async fn leave(self) {
        self.leave.send_replace(true);
        // It ends by itself; a panic is logged by the panic hook.
        let _ = self.requests.await;
    }
}

struct Responder {
    executor: Arc<Executor>,
    object: ObjectId,
    content: Arc<Content>,
}

async fn answer_all(responder: Arc<Responder>, mut membership: Membership, mut leave: watch::Receiver<bool>) {
    let mut requests = JoinSet::new();
    let mut left = false;
    loop {
        tokio::select! {
            incoming = membership.next() => match incoming {
                Some(incoming) => {
                    requests.spawn(answer(responder.clone(), incoming));
                }
                None => break,
            },
            // A dropped sender also means leaving: the worker was dropped.
            () = left_requested(&mut leave), if !left => {
                left = true;
                membership.leave().await;
            }
            Some(_) = requests.join_next(), if !requests.is_empty() => {}
        }
    }
    while requests.join_next().await.is_some() {}
}

/// Returns when the flag is set or its sender is dropped.
async fn left_requested(leave: &mut watch::Receiver<bool>) {
    let _ = leave.wait_for(|leave| *leave).await;
}

async fn answer(responder: Arc<Responder>, mut incoming: Incoming) {
    let (name, done) = match Request::decode(incoming.payload.clone()) {
        Ok(request) if request.object == responder.object => {
            let name = request.name;
            tokio::select! {
                biased;
                done = responder.executor.work(request, &responder.content) => (name, done),
                // Another copy was answered first, the device disconnected, or time is over: the reply is not needed.
                () = incoming.cancelled() => return,
            }
        }
        Ok(request) => (request.name, Done::at_once(ReplyOutcome::Rejected(RejectReason::NotHeld))),
        Err(error) => {
            tracing::warn!(%error, "an invalid request was received");
            ([0; 16], Done::at_once(ReplyOutcome::Rejected(RejectReason::Undecodable)))
        }
    };
    responder.executor.count_reply(&done.outcome);
    let Done { outcome, worked, waited } = done;
    if let Err(error) = incoming.answer(Reply { name, outcome, worked, waited }.encode()).await {
        tracing::warn!(%error, "a reply could not be sent");
    }
}
