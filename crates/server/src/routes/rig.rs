//! Several sealed queries in, one pose out.

use std::sync::Arc;

use axum::Extension;
use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::HeaderMap;
use axum::response::Response;
use veiloc_query::AnswerDocument;

use super::localize::{Kind, serve};
use crate::problem::ProblemDocument;
use crate::state::App;
use veiloc_admission::Guest;

/// Where the device was that took the images of a session.
///
/// The body holds up to 32 sealed queries with their relative poses (docs/service.md). The answer is that of a single query
/// with the rig in the camera's place. After 408, 429, 503 or 504 the same bytes may be sent again.
#[utoipa::path(post, path = "/v1/maps/{name}/localize-rig", security(("token" = [])),
    params(
        ("name" = String, Path, description = "Name of the map"),
        ("veiloc-trusted-only" = Option<bool>, Header, description = "Withhold a doubtful pose: the answer has its doubts and no pose"),
        ("veiloc-near" = Option<String>, Header, description = "Where the camera roughly is: X,Y,Z,SD in map units"),
    ),
    request_body(content = Vec<u8>, content_type = "application/x-protobuf"),
    responses(
        (status = 200, description = "The pose; with `Accept: application/x-protobuf;version=3` (or `2`) a `veiloc.v1.Answer` of that version, without `version` one of version 1, with `application/geopose+json` a GeoPose", body = AnswerDocument),
        (status = 400, description = "Not a session of sealed queries, or an option that is none", body = ProblemDocument, content_type = "application/problem+json"),
        (status = 401, description = "No valid token", body = ProblemDocument, content_type = "application/problem+json"),
        (status = 404, description = "Unknown map", body = ProblemDocument, content_type = "application/problem+json"),
        (status = 406, description = "Nothing but a GeoPose is accepted, of a map nobody tied to Earth", body = ProblemDocument, content_type = "application/problem+json"),
        (status = 408, description = "The body was too slow", body = ProblemDocument, content_type = "application/problem+json"),
        (status = 409, description = "Sealed for another map, or the map is empty", body = ProblemDocument, content_type = "application/problem+json"),
        (status = 413, description = "Longer than any session for this map, or more images than the allowance lets through at once", body = ProblemDocument, content_type = "application/problem+json"),
        (status = 415, description = "Another media type", body = ProblemDocument, content_type = "application/problem+json"),
        (status = 422, description = "No pose is supported by the queries", body = ProblemDocument, content_type = "application/problem+json"),
        (status = 429, description = "Allowance used; see Retry-After", body = ProblemDocument, content_type = "application/problem+json"),
        (status = 503, description = "No room in the queue, or it is too long for an answer in time, or the map is unavailable; see Retry-After", body = ProblemDocument, content_type = "application/problem+json"),
        (status = 504, description = "No pose in time", body = ProblemDocument, content_type = "application/problem+json"),
))]
pub(super) async fn localize_rig(
    State(app): State<Arc<App>>,
    Extension(guest): Extension<Arc<Guest>>,
    name: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
    body: Body,
) -> Response {
    serve(app, &guest, name, headers, body, Kind::Rig).await
}
