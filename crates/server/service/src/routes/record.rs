//! Log line, metrics and trace of every request; the only place where these are made. Lines that unauthenticated
//! clients can cause are limited (`crate::queue::LogThrottle`). Also draws the request id, which answer, log and
//! trace share.
//!
//! Rule L8: a line contains only names that the operator chose, route templates (never the requested address),
//! status, problem and duration. Method, address and headers come from the client and could contain anything; a
//! request id of the client is ignored.

use std::sync::Arc;

use crate::telemetry::{RequestContext, RequestKind};
use axum::extract::{MatchedPath, Request, State};
use axum::http::header::CONNECTION;
use axum::http::{HeaderName, HeaderValue, Method};
use axum::middleware::Next;
use axum::response::Response;

use crate::http::padding::pad_head;
use crate::http::problem::{ProblemKind, set_instance};
use crate::serve::state::App;

/// The header with the request id.
pub(super) const REQUEST_ID: HeaderName = HeaderName::from_static("veiloc-request-id");

/// Addresses that need no token.
const OPEN: [&str; 6] = ["/healthz", "/readyz", "/v1/openapi.json", "/", "/page/{file}", "other"];

pub(super) async fn record(State(app): State<Arc<App>>, mut request: Request, next: Next) -> Response {
    let context = Arc::new(RequestContext::begin(app.ids.next()));
    let method = match *request.method() {
        Method::GET => "GET",
        Method::HEAD => "HEAD",
        Method::POST => "POST",
        Method::PUT => "PUT",
        Method::DELETE => "DELETE",
        _ => "other",
    };
    let route = request.extensions().get::<MatchedPath>().cloned();
    let route = route.as_ref().map_or("other", MatchedPath::as_str);
    request.extensions_mut().insert(context.clone());
    let mut response = next.run(request).await;
    set_instance(&mut response, context.id());
    // Digits are a valid header value.
    if let Ok(id) = HeaderValue::try_from(context.id().to_string()) {
        response.headers_mut().insert(REQUEST_ID, id);
    }
    if app.is_closing() {
        // The connection will close soon, perhaps in the middle of the next request, so tell the client now.
        response.headers_mut().insert(CONNECTION, HeaderValue::from_static("close"));
        app.answered();
    }
    let response = pad_head(response);
    let took = context.elapsed();
    let status = response.status().as_u16();
    let problem = response.extensions().get::<ProblemKind>().map(|kind| kind.0);
    let kind = RequestKind { route, status, problem };
    app.metrics.request(&kind, took, context.token());
    if let Some(traces) = app.traces.as_ref().filter(|_| !OPEN.contains(&route)) {
        traces.request(&context, method, &kind);
    }
    // Requests without a token, and all refusals, are limited.
    let kind = (status, problem.unwrap_or(""));
    if (status < 400 && !OPEN.contains(&route)) || app.log_throttle.should_log(kind) {
        let (token, map, ms) = (context.token(), context.map(), took.as_secs_f64() * 1e3);
        tracing::info!(request = %context.id(), method, route, status, problem, token, map, ms, "answered");
    }
    response
}
