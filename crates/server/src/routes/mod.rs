//! The addresses of the service, and their description as an OpenAPI document.

mod accept;
mod body;
mod localize;
mod maps;
mod record;
mod status;

use std::sync::Arc;

use axum::Router;
use axum::http::HeaderMap;
use axum::middleware::from_fn_with_state;
use axum::routing::{get, post};
use utoipa::openapi::security::{Http, HttpAuthScheme, SecurityScheme};
use utoipa::{Modify, OpenApi};

use crate::problem::Problem;
use crate::state::App;
use crate::tokens::Caller;

/// All addresses.
pub(crate) fn router(app: Arc<App>) -> Router {
    Router::new()
        .route("/v1/maps", get(maps::list))
        .route("/v1/maps/{name}/profile", get(maps::profile))
        .route("/v1/maps/{name}/localize", post(localize::localize))
        .route("/v1/openapi.json", get(status::openapi))
        .route("/healthz", get(status::health))
        .route("/readyz", get(status::ready))
        .route("/metrics", get(status::metrics))
        .method_not_allowed_fallback(async || Problem::WrongMethod)
        .fallback(async || Problem::NotFound)
        .layer(from_fn_with_state(app.clone(), record::record))
        .with_state(app)
}

/// Who asks, one request taken from its allowance.
fn admit(app: &App, headers: &HeaderMap) -> Result<Arc<Caller>, Problem> {
    let caller = app.callers().identify(headers)?;
    caller.spend()?;
    Ok(caller)
}

/// The service as an OpenAPI 3.1 document.
pub fn openapi_json() -> String {
    // A document of strings always serializes.
    Description::openapi().to_pretty_json().unwrap_or_default()
}

#[derive(OpenApi)]
#[openapi(
    info(
        title = "veiloc",
        description = "Where an image was taken, without the image: sealed queries in, poses out. \
                       Bodies are described in docs/wire-format.md and proto/veiloc/v1."
    ),
    paths(
        localize::localize,
        maps::list,
        maps::profile,
        status::openapi,
        status::health,
        status::ready,
        status::metrics
    ),
    modifiers(&Bearer)
)]
struct Description;

struct Bearer;

impl Modify for Bearer {
    fn modify(&self, document: &mut utoipa::openapi::OpenApi) {
        let scheme = SecurityScheme::Http(Http::new(HttpAuthScheme::Bearer));
        document.components.get_or_insert_default().add_security_scheme("token", scheme);
    }
}
