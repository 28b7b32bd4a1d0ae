//! Traces in the JSON form of OTLP (OpenTelemetry Protocol 1.x, `ExportTraceServiceRequest`): ids in hexadecimal,
//! 64-bit numbers as strings.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde_json::{Value, json};

use crate::telemetry::request_context::{RemoteCall, RequestContext, RequestKind, RequestStage};
use crate::telemetry::request_id::{RequestId, SpanId};

/// `SPAN_KIND_INTERNAL`, `SPAN_KIND_SERVER` and `SPAN_KIND_CLIENT`.
const INTERNAL: u8 = 1;
const SERVER: u8 = 2;
const CLIENT: u8 = 3;
/// `STATUS_CODE_ERROR`; set on a server span for errors of the server.
const ERROR: u8 = 2;

/// The fields common to all spans; `begun` is a duration since `start`.
fn span(
    trace: RequestId,
    id: SpanId,
    name: &str,
    kind: u8,
    start: SystemTime,
    begun: Duration,
    took: Duration,
) -> Value {
    let begun = start + begun;
    json!({
        "traceId": trace.to_string(),
        "spanId": id.to_string(),
        "name": name,
        "kind": kind,
        "startTimeUnixNano": nanoseconds(begun),
        "endTimeUnixNano": nanoseconds(begun + took),
    })
}

/// One request, its stages and its requests to workers.
pub(super) struct Trace {
    id: RequestId,
    parent: Option<SpanId>,
    begun: SystemTime,
    took: Duration,
    method: &'static str,
    route: String,
    status: u16,
    problem: Option<&'static str>,
    token: Option<String>,
    map: Option<String>,
    stages: Vec<RequestStage>,
    calls: Vec<RemoteCall>,
}

impl Trace {
    pub(super) fn of(context: &RequestContext, method: &'static str, kind: &RequestKind<'_>) -> Self {
        Self {
            id: context.id(),
            parent: context.parent(),
            begun: context.begun_at(),
            took: context.elapsed(),
            method,
            route: kind.route.to_owned(),
            status: kind.status,
            problem: kind.problem,
            token: context.token().map(str::to_owned),
            map: context.map().map(str::to_owned),
            stages: context.stages(),
            calls: context.calls(),
        }
    }

    /// Number of spans.
    pub(super) fn spans(&self) -> u64 {
        1 + (self.stages.len() + self.calls.len()) as u64
    }

    /// Span number 0 is the request, 1, 2, … are its stages. Ids differ within the trace.
    const fn span_id(&self, number: usize) -> SpanId {
        match self.parent {
            Some(parent) => parent.within(number as u64),
            None => self.id.span(number as u64),
        }
    }

    fn span(&self, number: usize, name: &str, kind: u8, begun: Duration, took: Duration) -> Value {
        span(self.id, self.span_id(number), name, kind, self.begun, begun, took)
    }

    fn root(&self) -> Value {
        let mut attributes = vec![
            text("http.request.method", self.method),
            text("http.route", &self.route),
            json!({"key": "http.response.status_code", "value": {"intValue": self.status.to_string()}}),
        ];
        attributes.extend(self.problem.map(|problem| text("error.type", problem)));
        attributes.extend(self.map.as_ref().map(|map| text("veiloc.map", map)));
        attributes.extend(self.token.as_ref().map(|token| text("veiloc.token", token)));
        let name = format!("{} {}", self.method, self.route);
        let mut span = self.span(0, &name, SERVER, Duration::ZERO, self.took);
        span["attributes"] = attributes.into();
        if let Some(parent) = self.parent {
            span["parentSpanId"] = parent.to_string().into();
        }
        if self.status >= 500 {
            span["status"] = json!({"code": ERROR});
        }
        span
    }

    fn all_spans(&self) -> Vec<Value> {
        let stages = self.stages.iter().enumerate().map(|(i, stage)| {
            let mut span = self.span(i + 1, stage.name, INTERNAL, stage.begun, stage.took);
            let above = self.stages.iter().position(|other| Some(other.name) == stage.within);
            span["parentSpanId"] = self.span_id(above.map_or(0, |above| above + 1)).to_string().into();
            span
        });
        let localize = self.stages.iter().position(|stage| stage.name == "localize");
        let calls = self.calls.iter().map(|call| {
            let mut span = span(self.id, call.span, "ask worker", CLIENT, self.begun, call.begun, call.took);
            span["parentSpanId"] = self.span_id(localize.map_or(0, |above| above + 1)).to_string().into();
            span["attributes"] =
                json!([text("veiloc.worker", &call.machine), text("veiloc.outcome", call.outcome)]);
            span
        });
        std::iter::once(self.root()).chain(stages).chain(calls).collect()
    }
}

/// `ExportTraceServiceRequest`.
pub(super) fn document(all: &[Trace], service: &str, version: &str) -> Value {
    let spans: Vec<Value> = all.iter().flat_map(Trace::all_spans).collect();
    json!({"resourceSpans": [{
        "resource": {"attributes": [text("service.name", service), text("service.version", version)]},
        "scopeSpans": [{"scope": {"name": "veiloc-server", "version": version}, "spans": spans}],
    }]})
}

fn text(key: &str, value: &str) -> Value {
    json!({"key": key, "value": {"stringValue": value}})
}

/// Nanoseconds since 1970 as a decimal string.
fn nanoseconds(time: SystemTime) -> String {
    time.duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos().to_string()
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;
    use crate::telemetry::request_id::RequestIds;

    #[test]
    fn stage_spans_have_the_right_parent() {
        let ids = RequestIds::start().expect("random");
        let ms = Duration::from_millis;
        for _ in 0..100 {
            let context = RequestContext::begin(ids.next());
            for (name, within, begun) in
                [("read", None, 1), ("localize", None, 5), ("pose", Some("localize"), 7)]
            {
                context.stage(RequestStage { name, within, begun: ms(begun), took: ms(2) });
            }
            let kind = RequestKind { route: "/x", status: 504, problem: Some("timed-out") };
            let trace = Trace::of(&context, "POST", &kind);
            let spans = trace.all_spans();
            assert_eq!(spans.len() as u64, trace.spans());
            let id = |i: usize| spans[i]["spanId"].as_str().expect("an id");
            assert_eq!((0..4).map(id).collect::<HashSet<_>>().len(), 4);
            assert!((0..4).all(|i| id(i).len() == 16 && id(i).bytes().any(|c| c != b'0')));
            assert_eq!(spans[0].get("parentSpanId"), None);
            assert_eq!(spans[1]["parentSpanId"], id(0));
            assert_eq!(spans[3]["parentSpanId"], id(2), "a pose is a part of a localization");
            assert_eq!(spans[0]["status"]["code"], ERROR);
            let time =
                |i: usize, at: &str| spans[i][at].as_str().expect("text").parse::<u128>().expect("a number");
            assert_eq!(time(3, "startTimeUnixNano") - time(0, "startTimeUnixNano"), 7_000_000);
            assert_eq!(time(3, "endTimeUnixNano") - time(3, "startTimeUnixNano"), 2_000_000);
        }
    }
}
