//! Spans of a worker for the traces of its gateways.

use std::time::{Duration, Instant, SystemTime};

use veiloc_service::telemetry::{RequestId, RequestStage, SpanId, WorkSpan};

use super::executor::Done;
use crate::announcement::MemberId;
use crate::message::{ReplyOutcome, Request, Task};

/// Where spans go.
#[derive(Clone)]
pub(super) struct Spans {
    pub(super) member: MemberId,
    pub(super) traces: Option<veiloc_service::telemetry::Traces>,
}

/// A request that is traced.
pub(super) struct Traced {
    request: RequestId,
    parent: SpanId,
    kind: &'static str,
    object: String,
    begun_at: SystemTime,
    begun: Instant,
}

impl Spans {
    /// Begins the span of a request, if its gateway and this worker send traces.
    pub(super) fn begin(&self, request: &Request) -> Option<Traced> {
        let kind = match request.task {
            Task::Ping { .. } => return None,
            Task::Search { .. } => "search",
            Task::Pose { .. } => "pose",
        };
        Some(Traced {
            request: RequestId::from_bytes(request.name),
            parent: request.span.filter(|_| self.are_sent())?,
            kind,
            object: request.object.to_string(),
            begun_at: SystemTime::now(),
            begun: Instant::now(),
        })
    }

    /// Ends it. `None` for `done`: the request was cancelled.
    pub(super) fn end(&self, traced: Traced, done: Option<&Done>) {
        let (outcome, stages) = done.map_or(("cancelled", Vec::new()), |done| {
            (done.outcome.name(), stages(done.waited, done.worked, &done.outcome))
        });
        let Traced { request, parent, kind, object, begun_at, begun } = traced;
        let (worker, took) = (self.member.to_string(), begun.elapsed());
        self.send(WorkSpan { request, parent, kind, outcome, worker, object, begun_at, took, stages });
    }

    const fn are_sent(&self) -> bool {
        self.traces.is_some()
    }

    fn send(&self, span: WorkSpan) {
        if let Some(traces) = &self.traces {
            traces.work(span);
        }
    }
}

/// The queue, and the work with its parts.
fn stages(waited: Duration, worked: Duration, outcome: &ReplyOutcome) -> Vec<RequestStage> {
    if waited + worked == Duration::ZERO {
        return Vec::new();
    }
    let mut stages = vec![
        RequestStage { name: "queue", within: None, begun: Duration::ZERO, took: waited },
        RequestStage { name: "localize", within: None, begun: waited, took: worked },
    ];
    if let ReplyOutcome::Pose(answer) = outcome {
        let times = answer.times;
        let mut begun = waited;
        for (name, ms) in
            [("retrieve", times.retrieve_ms), ("match", times.match_ms), ("pose", times.pose_ms)]
        {
            let took = Duration::from_secs_f64(ms.max(0.0) / 1e3);
            stages.push(RequestStage { name, within: Some("localize"), begun, took });
            begun += took;
        }
    }
    stages
}
