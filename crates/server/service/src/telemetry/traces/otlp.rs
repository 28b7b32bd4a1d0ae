//! Traces in the JSON form of OTLP (OpenTelemetry Protocol 1.x, `ExportTraceServiceRequest`): ids in hexadecimal,
//! 64-bit numbers as strings.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde_json::{Value, json};

use crate::telemetry::request_context::{RequestContext, RequestKind, RequestStage};
use crate::telemetry::request_id::RequestId;

/// `SPAN_KIND_INTERNAL` and `SPAN_KIND_SERVER`.
const INTERNAL: u8 = 1;
const SERVER: u8 = 2;
/// `STATUS_CODE_ERROR`; set on a server span for errors of the server.
const ERROR: u8 = 2;

/// One request and its stages.
pub(super) struct Trace {
    id: RequestId,
    begun: SystemTime,
    took: Duration,
    method: &'static str,
    route: String,
    status: u16,
    problem: Option<&'static str>,
    token: Option<String>,
    map: Option<String>,
    stages: Vec<RequestStage>,
}

impl Trace {
    pub(super) fn of(context: &RequestContext, method: &'static str, kind: &RequestKind<'_>) -> Self {
        Self {
            id: context.id(),
            begun: context.begun_at(),
            took: context.elapsed(),
            method,
            route: kind.route.to_owned(),
            status: kind.status,
            problem: kind.problem,
            token: context.token().map(str::to_owned),
            map: context.map().map(str::to_owned),
            stages: context.stages(),
        }
    }

    /// Number of spans.
    pub(super) fn spans(&self) -> u64 {
        1 + self.stages.len() as u64
    }

    /// Span number 0 is the request, 1, 2, … are its stages. Ids differ within the trace and are not 0, as OTLP
    /// requires.
    fn span_id(&self, number: usize) -> String {
        let [_, _, _, _, _, _, _, _, low @ ..] = self.id.bytes();
        // Never 0, and adding the number cannot overflow.
        let id = (u64::from_be_bytes(low) >> 1 | 1 << 62).wrapping_add(number as u64);
        format!("{id:016x}")
    }

    /// The fields common to all spans.
    fn span(&self, number: usize, name: &str, kind: u8, begun: Duration, took: Duration) -> Value {
        let begun = self.begun + begun;
        json!({
            "traceId": self.id.to_string(),
            "spanId": self.span_id(number),
            "name": name,
            "kind": kind,
            "startTimeUnixNano": nanoseconds(begun),
            "endTimeUnixNano": nanoseconds(begun + took),
        })
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
        if self.status >= 500 {
            span["status"] = json!({"code": ERROR});
        }
        span
    }

    fn all_spans(&self) -> Vec<Value> {
        let stages = self.stages.iter().enumerate().map(|(i, stage)| {
            let mut span = self.span(i + 1, stage.name, INTERNAL, stage.begun, stage.took);
            let above = self.stages.iter().position(|other| Some(other.name) == stage.within);
            span["parentSpanId"] = self.span_id(above.map_or(0, |above| above + 1)).into();
            span
        });
        std::iter::once(self.root()).chain(stages).collect()
    }
}

/// `ExportTraceServiceRequest`.
pub(super) fn document(traces: &[Trace], version: &str) -> Value {
    let spans: Vec<Value> = traces.iter().flat_map(Trace::all_spans).collect();
    json!({"resourceSpans": [{
        "resource": {"attributes": [text("service.name", "veiloc"), text("service.version", version)]},
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
