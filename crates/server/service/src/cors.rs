//! Pages of other origins that ask from within a browser (CORS, the Fetch standard): off unless the operator names origins.
//!
//! A browser asks first whether it may (a preflight, without token), and shows a page only what it is told it may see. An
//! origin is allowed by its own name, never by `*`, and credentials of the browser (cookies, certificates) never: a token is
//! a header that the page itself sets.

use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::header::{
    ACCESS_CONTROL_ALLOW_HEADERS, ACCESS_CONTROL_ALLOW_METHODS, ACCESS_CONTROL_ALLOW_ORIGIN,
    ACCESS_CONTROL_EXPOSE_HEADERS, ACCESS_CONTROL_MAX_AGE, ACCESS_CONTROL_REQUEST_METHOD, ORIGIN, VARY,
};
use axum::http::{HeaderName, HeaderValue, Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};

use crate::state::App;

/// The methods there are.
const METHODS: &str = "GET, POST";

/// What a client says beside a query, and how it says who it is.
const ASKED: &str = "authorization, content-type, accept, if-none-match, veiloc-near, veiloc-trusted-only";

/// What a page may see of an answer beside what every page may.
const SHOWN: &str = "etag, retry-after, veiloc-request-id";

/// Seconds that a browser may remember the answer to a preflight.
const REMEMBERED: &str = "600";

/// Answers preflights of allowed origins, and lets their pages see what is answered. Without allowed origins, or for others,
/// nothing is added and nothing is answered differently.
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
            let told = [
                (ACCESS_CONTROL_ALLOW_METHODS, METHODS),
                (ACCESS_CONTROL_ALLOW_HEADERS, ASKED),
                (ACCESS_CONTROL_MAX_AGE, REMEMBERED),
            ];
            (StatusCode::NO_CONTENT, told).into_response()
        }
        _ => next.run(request).await,
    };
    let headers = response.headers_mut();
    // Caches on the way must not give one origin's answer to another.
    headers.append(VARY, HeaderValue::from_name(ORIGIN_NAME));
    if let Some(origin) = origin {
        headers.insert(ACCESS_CONTROL_ALLOW_ORIGIN, origin.into());
        headers.insert(ACCESS_CONTROL_EXPOSE_HEADERS, HeaderValue::from_static(SHOWN));
    }
    response
}

const ORIGIN_NAME: HeaderName = ORIGIN;
