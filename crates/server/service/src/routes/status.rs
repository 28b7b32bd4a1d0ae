//! Liveness, readiness and metrics.

use std::sync::Arc;

use axum::Extension;
use axum::extract::{Path, State};
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};

use crate::http::problem::Problem;
use crate::maps::MapLookup;
use crate::serve::state::{App, Readiness};
use crate::telemetry::RequestContext;

/// Liveness: the process answers.
#[utoipa::path(get, path = "/healthz", responses((status = 200, description = "The process is alive", body = str)))]
pub(super) async fn health() -> &'static str {
    "alive\n"
}

/// Readiness: at least one map is served, the token file is valid if one is configured, and no shutdown has begun.
/// The operator's listener lists the maps that are not served.
#[utoipa::path(get, path = "/readyz", responses(
    (status = 200, description = "Queries are accepted, perhaps not for every map", body = str),
    (status = 503, description = "Not ready: shutting down, no map, or no valid file of tokens", body = str),
))]
pub(super) async fn ready(State(app): State<Arc<App>>) -> (StatusCode, String) {
    match app.readiness() {
        Readiness::Ready { broken } if broken.is_empty() => (StatusCode::OK, "ready\n".to_owned()),
        Readiness::Ready { .. } => (StatusCode::OK, "ready, but not every map\n".to_owned()),
        Readiness::Not(why) => (StatusCode::SERVICE_UNAVAILABLE, format!("{why}\n")),
    }
}

/// Readiness for the operator, with one line per map that is not served.
pub(super) async fn ready_for_operator(State(app): State<Arc<App>>) -> (StatusCode, String) {
    let readiness = app.readiness();
    let lines =
        |names: &[String]| names.iter().fold(String::new(), |text, name| text + "not served: " + name + "\n");
    match readiness {
        Readiness::Ready { broken } => (StatusCode::OK, "ready\n".to_owned() + &lines(&broken)),
        Readiness::Not(why) => {
            let slots = app.maps.slots();
            let broken: Vec<String> =
                slots.iter().filter(|slot| !slot.is_complete()).map(|slot| slot.name().to_owned()).collect();
            (StatusCode::SERVICE_UNAVAILABLE, format!("{why}\n{}", lines(&broken)))
        }
    }
}

/// Readiness of one map, for the operator.
pub(super) async fn map_ready(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
) -> (StatusCode, &'static str) {
    match (app.readiness(), app.maps.find(&name)) {
        (_, MapLookup::Unknown) => (StatusCode::NOT_FOUND, "no such map\n"),
        (Readiness::Ready { .. }, MapLookup::Served(_)) => (StatusCode::OK, "ready\n"),
        (Readiness::Not(_), MapLookup::Served(_)) => {
            (StatusCode::SERVICE_UNAVAILABLE, "the service is not\n")
        }
        (_, MapLookup::Pending) => (StatusCode::SERVICE_UNAVAILABLE, "its manifest has not been read yet\n"),
        (_, MapLookup::Broken) => (StatusCode::SERVICE_UNAVAILABLE, "its file cannot be opened\n"),
    }
}

/// Metrics for Prometheus, for tokens marked `operator`.
#[utoipa::path(get, path = "/metrics", security(("token" = [])), responses(
    (status = 200, description = "Text format", body = String, content_type = "application/openmetrics-text"),
))]
pub(super) async fn metrics(
    State(app): State<Arc<App>>,
    Extension(context): Extension<Arc<RequestContext>>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let caller = app.callers().identify(&headers)?;
    caller.record_in(&context);
    if !caller.is_operator() {
        return Err(Problem::Forbidden);
    }
    Ok(metrics_text(&app))
}

/// Metrics on the operator's listener, without a token.
pub(super) async fn metrics_for_operator(State(app): State<Arc<App>>) -> Response {
    metrics_text(&app)
}

/// Media type of the text format of Prometheus.
pub(crate) const METRICS_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

fn metrics_text(app: &App) -> Response {
    ([(CONTENT_TYPE, METRICS_TYPE)], app.metrics_text()).into_response()
}
