//! The OpenAPI document, and its address. `answers.rs` adds refusals and headers that many addresses share.

mod answers;

use std::sync::LazyLock;

use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use utoipa::openapi::security::{Http, HttpAuthScheme, SecurityScheme};
use utoipa::{Modify, OpenApi};

use self::answers::Answers;
use super::{anchors, geopose, localize, maps, status};
use crate::http::problem::ProblemDocument;

/// This document.
#[utoipa::path(get, path = "/v1/openapi.json", responses((status = 200, description = "OpenAPI 3.1", body = Object)))]
pub(super) async fn openapi() -> Response {
    static DOCUMENT: LazyLock<String> = LazyLock::new(openapi_json);
    ([(CONTENT_TYPE, "application/json")], DOCUMENT.as_str()).into_response()
}

/// The service as an OpenAPI 3.1 document.
pub fn openapi_json() -> String {
    // A document of strings always serializes.
    ApiDocument::openapi().to_pretty_json().unwrap_or_default()
}

#[derive(OpenApi)]
#[openapi(
    info(
        title = "veiloc",
        description = "Where an image was taken, without the image: sealed queries in, poses out. \
                       Bodies are described in docs/reference/wire-format.md and proto/veiloc/v1."
    ),
    paths(
        localize::localize,
        localize::localize_rig,
        localize::localize_region,
        localize::localize_region_rig,
        geopose::geopose,
        maps::list,
        maps::profile,
        maps::pack,
        anchors::list,
        anchors::one,
        anchors::put,
        anchors::delete,
        openapi,
        status::health,
        status::ready,
        status::metrics
    ),
    components(schemas(ProblemDocument)),
    modifiers(&Bearer, &Answers)
)]
struct ApiDocument;

struct Bearer;

impl Modify for Bearer {
    fn modify(&self, document: &mut utoipa::openapi::OpenApi) {
        let scheme = SecurityScheme::Http(Http::new(HttpAuthScheme::Bearer));
        document.components.get_or_insert_default().add_security_scheme("token", scheme);
    }
}
