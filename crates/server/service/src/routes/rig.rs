//! Localization of a rig: several sealed queries in, one pose out.

use std::sync::Arc;

use axum::Extension;
use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::HeaderMap;
use axum::response::Response;
use veiloc_protocol::AnswerDocument;

use super::localize::serve;
use crate::decoded_request::BodyKind;
use crate::queue::Connection;
use crate::state::App;
use crate::telemetry::RequestContext;

/// The pose of the rig of a session.
///
/// The body holds up to 32 sealed queries with their relative poses (docs/reference/http.md). The answer is like that of a
/// single query, with the pose of the rig. After 408, 429, 503 or 504 the client may send the same bytes again.
#[utoipa::path(post, path = "/v1/maps/{name}/localize-rig", security(("token" = [])),
    params(
        ("name" = String, Path, description = "Name of the map"),
        ("veiloc-trusted-only" = Option<bool>, Header, description = "Withhold a doubtful pose: the answer has its doubts and no pose"),
        ("veiloc-near" = Option<String>, Header, description = "Where the camera roughly is: X,Y,Z,SD in map units"),
    ),
    request_body(content(
        (Vec<u8> = "application/x-protobuf"),
        (Vec<u8> = "application/octet-stream"),
    )),
    responses(
        (status = 200, description = "The pose, in the form that `Accept` requests", content(
            (AnswerDocument = "application/json"),
            (Vec<u8> = "application/x-protobuf"),
        )),
))]
pub(super) async fn localize_rig(
    State(app): State<Arc<App>>,
    Extension(connection): Extension<Arc<Connection>>,
    Extension(context): Extension<Arc<RequestContext>>,
    name: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
    body: Body,
) -> Response {
    serve(app, &connection, context, name, headers, body, BodyKind::Rig).await
}
