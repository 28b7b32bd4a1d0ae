//! The addresses of the service.

mod accept;
mod anchors;
mod authorize;
mod body;
pub(crate) mod decoded_request;
mod geopose;
mod host;
mod localize;
mod maps;
mod openapi;
mod page;
mod record;
mod request_options;
mod status;
mod versions;

use std::sync::Arc;

use axum::Router;
use axum::middleware::{from_fn, from_fn_with_state};
use axum::routing::{get, post};

pub use openapi::openapi_json;

use crate::http::cors::cors;
use crate::http::problem::Problem;
use crate::serve::state::App;

/// Router of the listeners for queries.
pub(crate) fn router(app: Arc<App>) -> Router {
    // Without a page, its addresses are unknown like any others.
    let page = match &app.options.page {
        Some(_) => Router::new()
            .route("/", get(page::index))
            .route("/page/{file}", get(page::file))
            .route("/page/points/{name}", get(page::points)),
        None => Router::new(),
    };
    page.route("/v1/maps", get(maps::list))
        .route("/v1/maps/{name}/profile", get(maps::profile))
        .route("/v1/maps/{name}/pack", get(maps::pack))
        .route("/v1/maps/{name}/anchors", get(anchors::list))
        .route(
            "/v1/maps/{name}/anchors/{anchor}",
            get(anchors::one).put(anchors::put).delete(anchors::delete),
        )
        .route("/v1/maps/{name}/localize", post(localize::localize))
        .route("/v1/maps/{name}/localize-rig", post(localize::localize_rig))
        .route("/v1/maps/{name}/regions/{region}/localize", post(localize::localize_region))
        .route("/v1/maps/{name}/regions/{region}/localize-rig", post(localize::localize_region_rig))
        .route("/geopose", post(geopose::geopose))
        .route("/v1/openapi.json", get(openapi::openapi))
        .route("/healthz", get(status::health))
        .route("/readyz", get(status::ready))
        .route("/metrics", get(status::metrics))
        .method_not_allowed_fallback(async || Problem::WrongMethod)
        .fallback(async || Problem::NotFound)
        .layer(from_fn(host::require_host))
        .layer(from_fn_with_state(app.clone(), cors))
        .layer(from_fn_with_state(app.clone(), record::record))
        .with_state(app)
}

/// Router of the operator's listener.
pub(crate) fn admin_router(app: Arc<App>) -> Router {
    Router::new()
        .route("/healthz", get(status::health))
        .route("/readyz", get(status::ready_for_operator))
        .route("/readyz/{name}", get(status::map_ready))
        .route("/metrics", get(status::metrics_for_operator))
        .method_not_allowed_fallback(async || Problem::WrongMethod)
        .fallback(async || Problem::NotFound)
        .layer(from_fn(host::require_host))
        .with_state(app)
}
