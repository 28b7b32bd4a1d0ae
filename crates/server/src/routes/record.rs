//! One line in the log and one count in the metrics for every request: the only place where either is made.
//!
//! Rule L8: a line holds names the operator chose, route templates (never the address that was asked for), status,
//! problem and time. Method and address come from the client and could hold anything.

use std::sync::Arc;
use std::time::Instant;

use axum::extract::{MatchedPath, Request, State};
use axum::http::Method;
use axum::middleware::Next;
use axum::response::Response;

use crate::problem::ProblemKind;
use crate::state::App;

/// Travels with a response: the name of a map that is served.
#[derive(Debug, Clone)]
pub(super) struct ServedMap(pub(super) Arc<str>);

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
    let response = next.run(request).await;
    let took = started.elapsed();
    let status = response.status().as_u16();
    let problem = response.extensions().get::<ProblemKind>().map(|kind| kind.0);
    let map = response.extensions().get::<ServedMap>().map(|map| map.0.as_ref());
    app.metrics.request(route, status, problem);
    let ms = took.as_secs_f64() * 1e3;
    tracing::info!(method, route, status, problem, map, ms, "answered");
    response
}
