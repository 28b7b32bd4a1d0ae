//! The page that an operator may serve beside the service, and the points it shows. Not there unless the options have a page.
//!
//! Its files are everybody's: who may ask for a map is decided where the page asks. What the page may do in a browser is said by
//! [`POLICY`]: it reaches this service and nothing else, whatever is in it.
//!
//! Nothing here is padded, and compressing it tells nothing (rule L12): it is the same for all who may ask, and says nothing of a
//! query. Whoever counts its bytes learns which file was asked for, and that a browser has it already.

use std::sync::Arc;

use crate::queue::Guest;
use crate::telemetry::Trail;
use crate::web_page::{Page, PageFile};
use axum::Extension;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS};
use axum::http::{HeaderMap, HeaderName};
use axum::response::{IntoResponse, Response};

use super::admit::asked;
use super::versions::version;
use crate::problem::Problem;
use crate::state::App;

/// What the page may reach: its own server. Pixels of the user's own image are shown as `blob:`.
const POLICY: &str = "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; worker-src 'self'; style-src 'self'; \
                      img-src 'self' blob:; media-src 'self' blob:; connect-src 'self'; base-uri 'none'; \
                      form-action 'none'; frame-ancestors 'none'";
/// The browser's own doors: the camera, and how it is held.
const PERMISSIONS: &str = "camera=(self), accelerometer=(self), gyroscope=(self), magnetometer=(self), microphone=(), geolocation=()";
const PERMISSIONS_POLICY: HeaderName = HeaderName::from_static("permissions-policy");
const OPENER_POLICY: HeaderName = HeaderName::from_static("cross-origin-opener-policy");
const RESOURCE_POLICY: HeaderName = HeaderName::from_static("cross-origin-resource-policy");

/// The page itself.
pub(super) async fn index(State(app): State<Arc<App>>, headers: HeaderMap) -> Result<Response, Problem> {
    file_named(&app, "index.html", &headers)
}

/// A file of it.
pub(super) async fn file(
    State(app): State<Arc<App>>,
    name: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let Path(name) = name.map_err(|_| Problem::NotFound)?;
    file_named(&app, &name, &headers)
}

/// Points of a map, as many as the operator shows: `[N, 3]` 32-bit floats, little endian.
pub(super) async fn points(
    State(app): State<Arc<App>>,
    Extension(guest): Extension<Arc<Guest>>,
    Extension(trail): Extension<Arc<Trail>>,
    name: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let hosted = asked(&app, &guest, &trail, name, &headers)?;
    // For whoever may ask for the map, so for no cache that others share. Numbers of 32 bits are hardly shorter compressed.
    let common = [(CACHE_CONTROL, "private, no-cache")];
    Ok((common, version(&hosted.shown, None, "application/octet-stream", &headers)).into_response())
}

fn file_named(app: &App, name: &str, asked: &HeaderMap) -> Result<Response, Problem> {
    let PageFile { content_type, plain, gzip } =
        app.options.page.as_deref().and_then(|page: &Page| page.file(name)).ok_or(Problem::NotFound)?;
    let common = [
        // Names stay when a file changes: it is asked for each time, and mostly not sent.
        (CACHE_CONTROL, "no-cache"),
        (CONTENT_SECURITY_POLICY, POLICY),
        (PERMISSIONS_POLICY, PERMISSIONS),
        (OPENER_POLICY, "same-origin"),
        (RESOURCE_POLICY, "same-origin"),
        (REFERRER_POLICY, "no-referrer"),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
    ];
    Ok((common, version(plain, gzip.as_ref(), content_type, asked)).into_response())
}
