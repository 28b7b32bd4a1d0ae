//! Probes a member while it owes something, and notices that it no longer runs.
//!
//! A member that owes an answer for [`PATIENCE`], or whose announcement is late, is asked whether it runs, and whether it
//! has the requests that it owes answers to. That question is answered by the part of a worker that receives messages,
//! so a worker that computes for long, or whose queue is long, answers at once; one that is suspended, dead or
//! disconnected does not. So one missed answer is enough to put it out, and no measured times are needed to tell a slow
//! worker from one that hangs. Requests that the member never received are sent again at once.

use std::sync::{Arc, Weak};

use tokio::time::{Instant, sleep_until};

use super::member::{Due, Member, OUT_PROBE_TIMEOUT, PROBE_TIMEOUT};
use super::{Role, Table};
use crate::ClusterError;
use crate::message::{Reply, ReplyOutcome, Request, Task};

/// Request name of messages that belong to no query.
const NO_REQUEST: [u8; 16] = [0; 16];

/// Watches a member until it leaves or the table is dropped.
pub(super) async fn watch(table: Weak<Table>, member: Arc<Member>) {
    loop {
        let Some(known) = table.upgrade().filter(|table| table.has(&member)) else { return };
        let due = match (known.role, member.due()) {
            (Role::Gateway, due) => due,
            (Role::Worker, _) => member.forget_at(),
        };
        if Instant::now() < due.at() {
            // While it waits, it does not keep the table.
            drop(known);
            tokio::select! {
                () = sleep_until(due.at()) => {
                    if Instant::now() > due.at() + member.period() * 2 {
                        // This process was suspended, and has not read what was sent to it in the meantime.
                        member.restart_clocks();
                    }
                }
                () = member.changed.notified() => {}
            }
            continue;
        }
        match due {
            Due::Forget(_) => return known.remove(&member),
            Due::Probe(_) => probe(&known, &member).await,
        }
    }
}

/// Asks a member whether it runs, and which of its requests it does not know.
async fn probe(table: &Table, member: &Arc<Member>) {
    let (numbers, owed): (Vec<u64>, Vec<_>) = member.owed().into_iter().unzip();
    let begun = Instant::now();
    let within = if member.is_out() { OUT_PROBE_TIMEOUT } else { PROBE_TIMEOUT };
    let ping = Request {
        version: member.version(),
        name: NO_REQUEST,
        object: veiloc_map::regions::ObjectId::from_bytes([0; 32]),
        lane: None,
        rows: 0,
        span: None,
        within,
        task: Task::Ping { owed },
    };
    let reply = table.bus.request(&member.subject, ping.encode(), within).await;
    if matches!(reply, Err(ClusterError::NoResponders { .. })) {
        return table.remove(member);
    }
    match reply.and_then(|bytes| Reply::decode(bytes, &NO_REQUEST)) {
        Ok(Reply { outcome: ReplyOutcome::Here { unknown }, load, .. }) => {
            let unknown: Vec<u64> =
                unknown.iter().filter_map(|at| numbers.get(*at as usize).copied()).collect();
            member.answered_probe(&numbers, &unknown, load, begun);
            table.set_out(member, false);
        }
        missed => {
            if let Err(error) = &missed {
                tracing::debug!(member = %member.id, %error, "a worker misses a probe");
            }
            table.set_out(member, true);
            member.probing();
        }
    }
}
