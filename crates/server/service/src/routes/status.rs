//! Is it alive, is it ready, how is it doing.

use std::sync::Arc;

use axum::Extension;
use axum::extract::{Path, State};
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};

use crate::maps::Named;
use crate::problem::Problem;
use crate::state::{App, Readiness};
use crate::telemetry::Trail;

/// Whether the process answers at all.
#[utoipa::path(get, path = "/healthz", responses((status = 200, description = "It does", body = str)))]
pub(super) async fn health() -> &'static str {
    "alive\n"
}

/// Whether it takes queries: at least one map is served, there is a valid file of tokens if any is asked for, and it is
/// not about to stop. Which maps are not served is told on the operator's listener.
#[utoipa::path(get, path = "/readyz", responses(
    (status = 200, description = "It takes queries, perhaps not for every map", body = str),
    (status = 503, description = "It does not: it is about to stop, has no map, or no valid file of tokens", body = str),
))]
pub(super) async fn ready(State(app): State<Arc<App>>) -> (StatusCode, String) {
    match app.readiness() {
        Readiness::Ready { broken } if broken.is_empty() => (StatusCode::OK, "ready\n".to_owned()),
        Readiness::Ready { .. } => (StatusCode::OK, "ready, but not every map\n".to_owned()),
        Readiness::Not(why) => (StatusCode::SERVICE_UNAVAILABLE, format!("{why}\n")),
    }
}

/// The same for the operator: a line a map that is not served.
pub(super) async fn ready_for_operator(State(app): State<Arc<App>>) -> (StatusCode, String) {
    let readiness = app.readiness();
    let lines =
        |names: &[String]| names.iter().fold(String::new(), |text, name| text + "not served: " + name + "\n");
    match readiness {
        Readiness::Ready { broken } => (StatusCode::OK, "ready\n".to_owned() + &lines(&broken)),
        Readiness::Not(why) => {
            let slots = app.maps.slots();
            let broken: Vec<String> = slots
                .iter()
                .filter(|slot| slot.current().is_none())
                .map(|slot| slot.name().to_owned())
                .collect();
            (StatusCode::SERVICE_UNAVAILABLE, format!("{why}\n{}", lines(&broken)))
        }
    }
}

/// Whether it takes queries for one map. For the operator.
pub(super) async fn map_ready(
    State(app): State<Arc<App>>,
    Path(name): Path<String>,
) -> (StatusCode, &'static str) {
    match (app.readiness(), app.maps.find(&name)) {
        (_, Named::Unknown) => (StatusCode::NOT_FOUND, "no such map\n"),
        (Readiness::Ready { .. }, Named::Served(_)) => (StatusCode::OK, "ready\n"),
        (Readiness::Not(_), Named::Served(_)) => (StatusCode::SERVICE_UNAVAILABLE, "the service is not\n"),
        (_, Named::Broken) => (StatusCode::SERVICE_UNAVAILABLE, "its file cannot be opened\n"),
    }
}

/// Counts and times for Prometheus. For tokens marked `operator`.
#[utoipa::path(get, path = "/metrics", security(("token" = [])), responses(
    (status = 200, description = "Text format", body = String, content_type = "application/openmetrics-text"),
))]
pub(super) async fn metrics(
    State(app): State<Arc<App>>,
    Extension(trail): Extension<Arc<Trail>>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let caller = app.callers().identify(&headers)?;
    caller.sign(&trail);
    if !caller.is_operator() {
        return Err(Problem::Forbidden);
    }
    Ok(metrics_text(&app))
}

/// The same for whoever reaches the listener that is the operator's alone.
pub(super) async fn metrics_for_operator(State(app): State<Arc<App>>) -> Response {
    metrics_text(&app)
}

/// What Prometheus calls its text format.
pub(crate) const METRICS_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

fn metrics_text(app: &App) -> Response {
    ([(CONTENT_TYPE, METRICS_TYPE)], app.metrics_text()).into_response()
}
