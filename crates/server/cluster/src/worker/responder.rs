//! Receives the requests to a worker, and answers them with what its threads compute.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use tokio::sync::watch;
use tokio::task::{JoinHandle, JoinSet};

use super::executor::{Accepted, Done, Executor};
use super::holdings::Holdings;
use super::spans::{Spans, Traced};
use crate::bus::{Incoming, Membership};
use crate::frame_version::VERSION;
use crate::message::{RejectReason, Reply, ReplyOutcome, Request};

/// The task that answers requests.
pub(crate) struct Responder {
    finish: watch::Sender<bool>,
    is_leaving: Arc<AtomicBool>,
    requests: JoinHandle<()>,
}

impl Responder {
    /// Answers the requests of this membership.
    pub(crate) fn start(
        executor: Arc<Executor>,
        holdings: Arc<Holdings>,
        membership: Membership,
        spans: Spans,
    ) -> Self {
        let (finish, finishing) = watch::channel(false);
        let is_leaving = Arc::new(AtomicBool::new(false));
        let requests = answer_all(executor, holdings, membership, finishing, is_leaving.clone(), spans);
        Self { finish, is_leaving, requests: tokio::spawn(requests) }
    }

    /// Takes no further requests, and returns when the accepted ones are answered. Until then it still answers pings, so
    /// that gateways wait for those answers.
    pub(crate) async fn leave(self) {
        self.is_leaving.store(true, Ordering::Relaxed);
        self.finish.send_replace(true);
        // It ends by itself; a panic is logged by the panic hook.
        let _ = self.requests.await;
    }
}

async fn answer_all(
    executor: Arc<Executor>,
    holdings: Arc<Holdings>,
    mut membership: Membership,
    mut finishing: watch::Receiver<bool>,
    is_leaving: Arc<AtomicBool>,
    spans: Spans,
) {
    let mut answers = JoinSet::new();
    let (mut finishes, mut left) = (false, false);
    loop {
        if finishes && !left && answers.is_empty() {
            left = true;
            membership.leave().await;
        }
        tokio::select! {
            incoming = membership.next() => match incoming {
                Some(incoming) => {
                    // In the order of arrival, so that a ping finds the requests before it.
                    let accepted =
                        accept(&executor, &holdings, &incoming, is_leaving.load(Ordering::Relaxed), &spans);
                    answers.spawn(answer(executor.clone(), incoming, accepted, spans.clone()));
                }
                None => break,
            },
            // A dropped sender also means leaving: the worker was dropped.
            _ = finishing.wait_for(|finish| *finish), if !finishes => finishes = true,
            Some(_) = answers.join_next(), if !answers.is_empty() => {}
        }
    }
    while answers.join_next().await.is_some() {}
}

/// A request that was received.
struct Received {
    version: u32,
    name: [u8; 16],
    /// Its task, or the reply that needs none.
    accepted: Result<Accepted, ReplyOutcome>,
    traced: Option<Traced>,
}

fn accept(
    executor: &Arc<Executor>,
    holdings: &Holdings,
    incoming: &Incoming,
    is_leaving: bool,
    spans: &Spans,
) -> Received {
    match Request::decode(incoming.payload.clone()) {
        Ok(request) => {
            let (version, name, traced) = (request.version, request.name, spans.begin(&request));
            Received { version, name, accepted: executor.accept(request, holdings, is_leaving), traced }
        }
        Err(error) => {
            tracing::warn!(%error, "an invalid request was received");
            let accepted = Err(ReplyOutcome::Rejected(RejectReason::Undecodable));
            Received { version: VERSION, name: [0; 16], accepted, traced: None }
        }
    }
}

async fn answer(
    executor: Arc<Executor>,
    mut incoming: Incoming,
    Received { version, name, accepted, traced }: Received,
    spans: Spans,
) {
    let (done, _mark) = match accepted {
        Ok(accepted) => tokio::select! {
            biased;
            (done, mark) = executor.work(accepted) => (done, Some(mark)),
            // Another copy was answered first, the device disconnected, or time is over: the reply is not needed.
            () = incoming.cancelled() => {
                if let Some(traced) = traced {
                    spans.end(traced, None);
                }
                return;
            }
        },
        Err(outcome) => (Done::at_once(outcome), None),
    };
    executor.count_reply(&done.outcome);
    if let Some(traced) = traced {
        spans.end(traced, Some(&done));
    }
    let Done { outcome, worked, waited } = done;
    let reply = Reply { version, name, outcome, worked, waited, load: executor.load() };
    if let Err(error) = incoming.answer(reply.encode()).await {
        tracing::warn!(%error, "a reply could not be sent");
    }
}
