//! One line in the log and one count in the metrics for every request: the only place where either is made. Lines that
//! anybody can cause are summed up (`veiloc_admission::Throttle`).
//!
//! Rule L8: a line holds names the operator chose, route templates (never the address that was asked for), status,
//! problem and time. Method and address come from the client and could hold anything.

use std::sync::Arc;
use std::time::Instant;

use axum::extract::{MatchedPath, Request, State};
use axum::http::header::CONNECTION;
use axum::http::{HeaderValue, Method};
use axum::middleware::Next;
use axum::response::Response;

use crate::problem::ProblemKind;
use crate::state::App;

/// Travels with a response: the name of a map that is served.
#[derive(Debug, Clone)]
pub(super) struct ServedMap(pub(super) Arc<str>);

/// Addresses that answer anybody.
const OPEN: [&str; 4] = ["/healthz", "/readyz", "/v1/openapi.json", "other"];

pub(super) async fn record(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    let started = Instant::now();
    let method = match *request.method() {
        Method::GET => "GET",
        Method::HEAD => "HEAD",
        Method::POST => "POST",
        _ => "other",
    };
    let route = request.extensions().get::<MatchedPath>().cloned();
    let route = route.as_ref().map_or("other", MatchedPath::as_str);
    let mut response = next.run(request).await;
    if app.is_closing() {
        // Whoever keeps the connection would lose it soon, perhaps in the middle of its next request.
        response.headers_mut().insert(CONNECTION, HeaderValue::from_static("close"));
        app.answered();
    }
    let took = started.elapsed();
    let status = response.status().as_u16();
    let problem = response.extensions().get::<ProblemKind>().map(|kind| kind.0);
    let map = response.extensions().get::<ServedMap>().map(|map| map.0.as_ref());
    app.metrics.request(route, status, problem);
    let ms = took.as_secs_f64() * 1e3;
    // What needs no token to cause, and every refusal, is summed up where there is much of it.
    let kind = (status, problem.unwrap_or(""));
    if (status < 400 && !OPEN.contains(&route)) || app.quiet.admits(kind) {
        tracing::info!(method, route, status, problem, map, ms, "answered");
    }
    response
}
