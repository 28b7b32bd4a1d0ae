//! One line in the log and one count in the metrics for every request: the only place where either is made. Lines that
//! anybody can cause are summed up (`crate::queue::Throttle`). Also the request's name, which the answer, the log and
//! the trace have in common.
//!
//! Rule L8: a line holds names the operator chose, route templates (never the address that was asked for), status,
//! problem and time. Method, address and headers come from the client and could hold anything; an id that a client sends is
//! not looked at.

use std::sync::Arc;

use crate::telemetry::{RequestKind, Trail};
use axum::extract::{MatchedPath, Request, State};
use axum::http::header::CONNECTION;
use axum::http::{HeaderName, HeaderValue, Method};
use axum::middleware::Next;
use axum::response::Response;

use crate::padding::fill_head;
use crate::problem::{ProblemKind, sign};
use crate::state::App;

/// The header of every answer that names its request.
pub(super) const REQUEST_ID: HeaderName = HeaderName::from_static("veiloc-request-id");

/// Addresses that answer anybody.
const OPEN: [&str; 6] = ["/healthz", "/readyz", "/v1/openapi.json", "/", "/page/{file}", "other"];

pub(super) async fn record(State(app): State<Arc<App>>, mut request: Request, next: Next) -> Response {
    let trail = Arc::new(Trail::begin(app.ids.next()));
    let method = match *request.method() {
        Method::GET => "GET",
        Method::HEAD => "HEAD",
        Method::POST => "POST",
        _ => "other",
    };
    let route = request.extensions().get::<MatchedPath>().cloned();
    let route = route.as_ref().map_or("other", MatchedPath::as_str);
    request.extensions_mut().insert(trail.clone());
    let mut response = next.run(request).await;
    sign(&mut response, trail.id());
    // Digits are a header's value.
    if let Ok(id) = HeaderValue::try_from(trail.id().to_string()) {
        response.headers_mut().insert(REQUEST_ID, id);
    }
    if app.is_closing() {
        // Whoever keeps the connection would lose it soon, perhaps in the middle of its next request.
        response.headers_mut().insert(CONNECTION, HeaderValue::from_static("close"));
        app.answered();
    }
    let response = fill_head(response);
    let took = trail.elapsed();
    let status = response.status().as_u16();
    let problem = response.extensions().get::<ProblemKind>().map(|kind| kind.0);
    let kind = RequestKind { route, status, problem };
    app.metrics.request(&kind, took, trail.token());
    #[cfg(feature = "opentelemetry")]
    if let Some(traces) = app.traces.as_ref().filter(|_| !OPEN.contains(&route)) {
        traces.request(&trail, method, &kind);
    }
    // What needs no token to cause, and every refusal, is summed up where there is much of it.
    let kind = (status, problem.unwrap_or(""));
    if (status < 400 && !OPEN.contains(&route)) || app.quiet.admits(kind) {
        let (token, map, ms) = (trail.token(), trail.map(), took.as_secs_f64() * 1e3);
        tracing::info!(request = %trail.id(), method, route, status, problem, token, map, ms, "answered");
    }
    response
}
