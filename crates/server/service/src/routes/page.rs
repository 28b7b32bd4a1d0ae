//! The optional web page and the map points that it shows.
//!
//! Its files need no token; access to maps is checked when the page requests them. [`POLICY`] restricts the page in
//! the browser to requests to this service, whatever its content.
//!
//! Nothing here is padded, and compression reveals nothing (rule L12): the content is the same for all clients and
//! independent of queries. An observer of lengths learns which file was requested, and whether the browser had it
//! already.

use std::sync::Arc;

use crate::queue::Connection;
use crate::telemetry::RequestContext;
use crate::web_page::{Page, PageFile};
use axum::Extension;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS};
use axum::http::{HeaderMap, HeaderName};
use axum::response::{IntoResponse, Response};

use super::authorize::authorize_map;
use super::versions::version;
use crate::http::problem::Problem;
use crate::serve::state::App;

/// The page may reach only its own server. Pixels of the user's own image are shown as `blob:`.
const POLICY: &str = "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; worker-src 'self'; style-src 'self'; \
                      img-src 'self' blob:; media-src 'self' blob:; connect-src 'self'; base-uri 'none'; \
                      form-action 'none'; frame-ancestors 'none'";
/// Browser permissions: the camera and the motion sensors.
const PERMISSIONS: &str = "camera=(self), accelerometer=(self), gyroscope=(self), magnetometer=(self), microphone=(), geolocation=()";
const PERMISSIONS_POLICY: HeaderName = HeaderName::from_static("permissions-policy");
const OPENER_POLICY: HeaderName = HeaderName::from_static("cross-origin-opener-policy");
const RESOURCE_POLICY: HeaderName = HeaderName::from_static("cross-origin-resource-policy");

/// The page itself.
pub(super) async fn index(State(app): State<Arc<App>>, headers: HeaderMap) -> Result<Response, Problem> {
    file_named(&app, "index.html", &headers)
}

/// A file of the page.
pub(super) async fn file(
    State(app): State<Arc<App>>,
    name: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let Path(name) = name.map_err(|_| Problem::NotFound)?;
    file_named(&app, &name, &headers)
}

/// Points of a map, as many as the operator allows: `[N, 3]` 32-bit floats, little endian.
pub(super) async fn points(
    State(app): State<Arc<App>>,
    Extension(connection): Extension<Arc<Connection>>,
    Extension(context): Extension<Arc<RequestContext>>,
    name: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let loaded = authorize_map(&app, &connection, &context, name, &headers)?;
    // For clients that may use the map, so shared caches must not store it. Floats hardly compress.
    let common = [(CACHE_CONTROL, "private, no-cache")];
    Ok((common, version(&loaded.shown, None, "application/octet-stream", &headers)).into_response())
}

fn file_named(app: &App, name: &str, headers: &HeaderMap) -> Result<Response, Problem> {
    let PageFile { content_type, plain, gzip } =
        app.options.page.as_deref().and_then(|page: &Page| page.file(name)).ok_or(Problem::NotFound)?;
    let common = [
        // File names are stable, so browsers must revalidate; mostly the answer is 304.
        (CACHE_CONTROL, "no-cache"),
        (CONTENT_SECURITY_POLICY, POLICY),
        (PERMISSIONS_POLICY, PERMISSIONS),
        (OPENER_POLICY, "same-origin"),
        (RESOURCE_POLICY, "same-origin"),
        (REFERRER_POLICY, "no-referrer"),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
    ];
    Ok((common, version(plain, gzip.as_ref(), content_type, headers)).into_response())
}
