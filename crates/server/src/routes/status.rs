//! Is it alive, is it ready, how is it doing.

use std::sync::Arc;

use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};

use crate::problem::{Problem, ProblemDocument};
use crate::state::App;
use crate::tokens::Role;

/// Whether the process answers at all.
#[utoipa::path(get, path = "/healthz", responses((status = 200, description = "It does", body = str)))]
pub(super) async fn health() -> &'static str {
    "alive\n"
}

/// Whether it takes queries: all maps are open and it is not about to stop.
#[utoipa::path(get, path = "/readyz", responses(
    (status = 200, description = "It takes queries", body = str),
    (status = 503, description = "It is about to stop", body = str),
))]
pub(super) async fn ready(State(app): State<Arc<App>>) -> (StatusCode, &'static str) {
    if app.is_closing() {
        (StatusCode::SERVICE_UNAVAILABLE, "stopping\n")
    } else {
        (StatusCode::OK, "ready\n")
    }
}

/// Counts and times for Prometheus. For tokens marked `operator`.
#[utoipa::path(get, path = "/metrics", security(("token" = [])), responses(
    (status = 200, description = "Text format", body = String, content_type = "application/openmetrics-text"),
    (status = 401, description = "No valid token", body = ProblemDocument, content_type = "application/problem+json"),
    (status = 403, description = "Not an operator's", body = ProblemDocument, content_type = "application/problem+json"),
))]
pub(super) async fn metrics(State(app): State<Arc<App>>, headers: HeaderMap) -> Result<Response, Problem> {
    if app.callers().identify(&headers)?.role != Role::Operator {
        return Err(Problem::Forbidden);
    }
    Ok(metrics_text(&app))
}

/// The same for whoever reaches the listener that is the operator's alone.
pub(super) async fn metrics_for_operator(State(app): State<Arc<App>>) -> Response {
    metrics_text(&app)
}

fn metrics_text(app: &App) -> Response {
    let text = app.metrics.text(app.pool.queued(), app.pool.busy(), app.connections.open());
    let kind = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    ([(CONTENT_TYPE, kind)], text).into_response()
}
