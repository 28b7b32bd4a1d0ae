//! The `Host` header (RFC 9112, 3.2): an HTTP/1.1 request without it, or with several, is answered with 400, because a
//! proxy in front may have understood it otherwise.

use axum::extract::Request;
use axum::http::Version;
use axum::http::header::HOST;
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};

use crate::http::problem::Problem;

pub(super) async fn require_host(request: Request, next: Next) -> Response {
    let hosts = request.headers().get_all(HOST).iter().count();
    // HTTP/1.0 had no such header.
    let is_valid = hosts == 1 || (hosts == 0 && request.version() < Version::HTTP_11);
    if is_valid { next.run(request).await } else { Problem::Host.into_response() }
}
