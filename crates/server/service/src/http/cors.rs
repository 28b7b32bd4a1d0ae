//! CORS (Fetch standard): requests from browser pages of other origins. Disabled unless the operator lists allowed
//! origins.
//!
//! Before a cross-origin request, a browser sends a preflight request without a token, and it shows a page only the
//! headers that the server exposes. An origin is allowed by name, never by `*`. Credentials of the browser (cookies,
//! certificates) are never allowed: the page itself sets the token header.

use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::header::{
    ACCESS_CONTROL_ALLOW_HEADERS, ACCESS_CONTROL_ALLOW_METHODS, ACCESS_CONTROL_ALLOW_ORIGIN,
    ACCESS_CONTROL_EXPOSE_HEADERS, ACCESS_CONTROL_MAX_AGE, ACCESS_CONTROL_REQUEST_METHOD, ORIGIN, VARY,
};
use axum::http::{HeaderName, HeaderValue, Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};

use crate::serve::state::App;

/// Methods of all addresses.
const ALLOWED_METHODS: &str = "GET, POST, PUT, DELETE";

/// Request headers that a page may send.
const ALLOWED_HEADERS: &str =
    "authorization, content-type, accept, if-match, if-none-match, veiloc-near, veiloc-trusted-only";

/// Response headers that a page may read, in addition to the headers that the Fetch standard always exposes.
const EXPOSED_HEADERS: &str = "etag, retry-after, veiloc-request-id";

/// Seconds for which a browser may cache the answer to a preflight.
const MAX_AGE_SECONDS: &str = "600";

/// Answers preflights of allowed origins and adds the CORS headers to their responses. Responses for other origins
/// are not changed.
pub(crate) async fn cors(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    let allowed = &app.options.cors;
    if allowed.is_empty() {
        return next.run(request).await;
    }
    let origin = request.headers().get(ORIGIN);
    let origin = origin.and_then(|origin| allowed.iter().find(|known| known.is(origin))).cloned();
    let is_preflight =
        request.method() == Method::OPTIONS && request.headers().contains_key(ACCESS_CONTROL_REQUEST_METHOD);
    let mut response = match &origin {
        Some(_) if is_preflight => {
            let preflight = [
                (ACCESS_CONTROL_ALLOW_METHODS, ALLOWED_METHODS),
                (ACCESS_CONTROL_ALLOW_HEADERS, ALLOWED_HEADERS),
                (ACCESS_CONTROL_MAX_AGE, MAX_AGE_SECONDS),
            ];
            (StatusCode::NO_CONTENT, preflight).into_response()
        }
        _ => next.run(request).await,
    };
    let headers = response.headers_mut();
    // Without `Vary`, a cache would reuse the response for another origin.
    headers.append(VARY, HeaderValue::from_name(ORIGIN_NAME));
    if let Some(origin) = origin {
        headers.insert(ACCESS_CONTROL_ALLOW_ORIGIN, origin.into());
        headers.insert(ACCESS_CONTROL_EXPOSE_HEADERS, HeaderValue::from_static(EXPOSED_HEADERS));
    }
    response
}

const ORIGIN_NAME: HeaderName = ORIGIN;
