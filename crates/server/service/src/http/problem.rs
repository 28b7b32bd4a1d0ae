//! Refusals: `application/problem+json` (RFC 9457) for the client, and a name for logs and metrics.
//!
//! A refusal names the wrong field and its allowed values, but never repeats the received value (rule L8). All
//! refusals have the same length (`padding.rs`).

use std::num::{NonZeroU32, NonZeroU64};
use std::sync::Arc;
use std::time::Duration;

use crate::telemetry::{RequestId, RequestKind};
use axum::body::Body;
use axum::http::header::{CONTENT_TYPE, RETRY_AFTER, WWW_AUTHENTICATE};
use axum::http::{HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;
use veiloc_protocol::{ContentAnchorError, QueryError};

use crate::http::padding::{self, PadLength};
use crate::routes::decoded_request::{LocalizeFailure, NoPose};

/// Why a request was refused. The messages are for developers of clients; logs contain only the name.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum Problem {
    #[error("send a token that this service knows, as `Authorization: Bearer TOKEN`")]
    Unauthenticated,
    #[error("this token may localize; reading the metrics is for operators")]
    Forbidden,
    #[error("writing anchors needs a token with the permission `anchors` (veiloc token new --anchors)")]
    AnchorsReadOnly,
    #[error(
        "another token owns this anchor; that token may change it, or one with the permissions `anchors` and `operator`"
    )]
    NotOwner,
    #[error("this token has used its allowance; send the same bytes again in {retry_after} s")]
    RateLimited { retry_after: NonZeroU64 },
    #[error("no such address; see /v1/openapi.json")]
    NotFound,
    #[error("an HTTP/1.1 request has exactly one Host header")]
    Host,
    #[error("another method is needed here; see /v1/openapi.json")]
    WrongMethod,
    #[error("no map of this name is served; /v1/maps lists them")]
    UnknownMap,
    #[error("no map that this token may use has a geographic reference; its operator can give it one")]
    NoGeoReference,
    #[error("the operator gives no pack of this map")]
    NoPack,
    #[error("this service is a gateway and keeps no anchors; ask a service that has the file of the map")]
    NoAnchors,
    #[error("this map has no anchor of this name; /v1/maps/{{name}}/anchors lists them")]
    UnknownAnchor,
    #[error("{0}")]
    BadAnchor(ContentAnchorError),
    #[error("the anchor is not the one that If-Match or If-None-Match demands; fetch it, and decide again")]
    PreconditionFailed,
    #[error(
        "the anchors of this map cannot be read or written at the moment; its operator finds the reason in the log"
    )]
    AnchorsUnavailable,
    #[error(
        "the anchors kept for this map are of another coordinate frame: it was replaced; its operator carries them with \
         `veiloc map anchors --carry`"
    )]
    OtherFrame,
    #[error(
        "this map cannot be opened at the moment; send the same bytes again later (the log of the service says why)"
    )]
    MapUnavailable,
    #[error(
        "no worker for this part of the map can be reached; send the same bytes again in {retry_after} s"
    )]
    Unreached { retry_after: NonZeroU64 },
    #[error("the service has no valid file of tokens and refuses all queries; its log says why")]
    NoTokens,
    #[error(
        "send a sealed query as application/x-protobuf or application/octet-stream, a GeoPose request or an anchor as \
         application/json, not compressed"
    )]
    MediaType,
    #[error("a sealed query for this map has at most {limit} bytes")]
    TooLarge { limit: usize },
    #[error("this token's allowance lets {most} images of a session through at once; send it in parts")]
    SessionTooLong { most: NonZeroU32 },
    #[error("the body did not arrive within {seconds} s; send the same bytes again over a better network")]
    TooSlow { seconds: u64 },
    #[error("the body broke off before its end; send the same bytes again")]
    Interrupted,
    #[error("{0}")]
    Malformed(String),
    #[error("{0}")]
    Version(String),
    #[error(
        "the query was sealed for another map or with an old profile; fetch the profile, and seal another frame of the \
         same session with its orientation, or move on first: several images of one position without a session reveal more"
    )]
    WrongProfile,
    #[error("{0}")]
    BadOption(&'static str),
    #[error(
        "no pose is supported by the query{0}; send another frame of the same session with its orientation, or move on by \
         a step or more first: several images of one position without a session reveal more"
    )]
    NotLocalized(&'static str),
    #[error("the map is empty; its operator must add images")]
    EmptyMap,
    #[error(
        "all workers are busy and the queue has no room for this token; send the same bytes again in {retry_after} s"
    )]
    QueueFull { retry_after: NonZeroU64 },
    #[error("the queue is too long for an answer in time; send the same bytes again in {retry_after} s")]
    Overdue { retry_after: NonZeroU64 },
    #[error("the service is stopping; send the same bytes again in {retry_after} s")]
    Stopping { retry_after: NonZeroU64 },
    #[error("no pose within {seconds} s; send the same bytes again later")]
    TimedOut { seconds: u64 },
    #[error("an internal error of veiloc; it was logged")]
    Broken,
}

impl Problem {
    /// The problem of a body that cannot be decoded: the field, and its allowed values.
    pub(crate) fn of_query(error: &QueryError) -> Self {
        match error {
            QueryError::TooLong { limit, .. } => Self::TooLarge { limit: *limit },
            QueryError::Version { .. } => Self::Version(error.without_values()),
            QueryError::WrongProfile { .. } => Self::WrongProfile,
            _ => Self::Malformed(error.without_values()),
        }
    }

    pub(crate) fn of_failure(why: LocalizeFailure, within: Duration) -> Self {
        match why {
            LocalizeFailure::WrongProfile => Self::WrongProfile,
            LocalizeFailure::EmptyMap => Self::EmptyMap,
            // A cancelled job has no client any more; if it has one after all, the client may retry.
            LocalizeFailure::Stopped => Self::Stopping { retry_after: NonZeroU64::MIN },
            LocalizeFailure::NoPose(NoPose::OneSided) => {
                Self::NotLocalized(": all lines that match run through one anchor")
            }
            LocalizeFailure::NoPose(NoPose::TooFew) => {
                Self::NotLocalized(": too few of its rows match the map")
            }
            LocalizeFailure::NoPose(NoPose::Unsupported) => Self::NotLocalized(""),
            LocalizeFailure::Busy { retry_after } => Self::QueueFull { retry_after },
            LocalizeFailure::Unreached { retry_after } => Self::Unreached { retry_after },
            LocalizeFailure::TimedOut => Self::TimedOut { seconds: within.as_secs().max(1) },
            LocalizeFailure::Broken => Self::Broken,
        }
    }

    /// HTTP status, a name for programs, metrics and logs, and a title for people.
    const fn facts(&self) -> (StatusCode, &'static str, &'static str) {
        use StatusCode as S;
        match self {
            Self::Unauthenticated => (S::UNAUTHORIZED, "unauthenticated", "No valid token"),
            Self::Forbidden => (S::FORBIDDEN, "forbidden", "Not allowed"),
            Self::AnchorsReadOnly => (S::FORBIDDEN, "anchors-read-only", "May not write anchors"),
            Self::NotOwner => (S::FORBIDDEN, "not-owner", "Anchor of another token"),
            Self::RateLimited { .. } => (S::TOO_MANY_REQUESTS, "rate-limited", "Too many requests"),
            Self::NotFound => (S::NOT_FOUND, "not-found", "Not found"),
            Self::Host => (S::BAD_REQUEST, "bad-host", "Not one Host header"),
            Self::WrongMethod => (S::METHOD_NOT_ALLOWED, "wrong-method", "Method not allowed"),
            Self::UnknownMap => (S::NOT_FOUND, "unknown-map", "Unknown map"),
            Self::NoPack => (S::NOT_FOUND, "no-pack", "No pack"),
            Self::NoAnchors => (S::NOT_FOUND, "no-anchors", "No anchors"),
            Self::UnknownAnchor => (S::NOT_FOUND, "unknown-anchor", "Unknown anchor"),
            Self::BadAnchor(ContentAnchorError::TooMany | ContentAnchorError::TooLong) => {
                (S::CONFLICT, "anchors-full", "No space for more anchors")
            }
            Self::BadAnchor(_) => (S::BAD_REQUEST, "bad-anchor", "Not an anchor"),
            Self::PreconditionFailed => (S::PRECONDITION_FAILED, "precondition-failed", "Anchor changed"),
            Self::AnchorsUnavailable => {
                (S::SERVICE_UNAVAILABLE, "anchors-unavailable", "Anchors unavailable")
            }
            Self::OtherFrame => (S::SERVICE_UNAVAILABLE, "other-frame", "Anchors of another map"),
            Self::NoGeoReference => (S::NOT_FOUND, "no-geo-reference", "No geographic reference"),
            Self::MapUnavailable => (S::SERVICE_UNAVAILABLE, "map-unavailable", "Map unavailable"),
            Self::Unreached { .. } => (S::SERVICE_UNAVAILABLE, "unreached", "Workers unreachable"),
            Self::NoTokens => (S::SERVICE_UNAVAILABLE, "no-tokens", "No valid tokens"),
            Self::MediaType => (S::UNSUPPORTED_MEDIA_TYPE, "media-type", "Unsupported media type"),
            Self::TooLarge { .. } => (S::PAYLOAD_TOO_LARGE, "too-large", "Body too large"),
            Self::SessionTooLong { .. } => (S::PAYLOAD_TOO_LARGE, "session-too-long", "Session too long"),
            Self::TooSlow { .. } => (S::REQUEST_TIMEOUT, "too-slow", "Body too slow"),
            Self::Interrupted => (S::BAD_REQUEST, "interrupted", "Body incomplete"),
            Self::Malformed(_) => (S::BAD_REQUEST, "malformed-query", "Not a sealed query"),
            Self::Version(_) => (S::BAD_REQUEST, "unsupported-version", "Unsupported version"),
            Self::BadOption(_) => (S::BAD_REQUEST, "bad-option", "Not an option"),
            Self::WrongProfile => (S::CONFLICT, "wrong-profile", "Sealed for another map"),
            Self::NotLocalized(_) => (S::UNPROCESSABLE_ENTITY, "not-localized", "Not localized"),
            Self::EmptyMap => (S::CONFLICT, "empty-map", "Empty map"),
            Self::QueueFull { .. } => (S::SERVICE_UNAVAILABLE, "queue-full", "Busy"),
            Self::Overdue { .. } => (S::SERVICE_UNAVAILABLE, "overdue", "Busy"),
            Self::Stopping { .. } => (S::SERVICE_UNAVAILABLE, "stopping", "Stopping"),
            Self::TimedOut { .. } => (S::GATEWAY_TIMEOUT, "timed-out", "Timed out"),
            Self::Broken => (S::INTERNAL_SERVER_ERROR, "broken", "Internal error"),
        }
    }

    const fn retry_after(&self) -> Option<NonZeroU64> {
        match self {
            Self::RateLimited { retry_after }
            | Self::QueueFull { retry_after }
            | Self::Overdue { retry_after }
            | Self::Unreached { retry_after }
            | Self::Stopping { retry_after } => Some(*retry_after),
            Self::MapUnavailable | Self::NoTokens | Self::AnchorsUnavailable | Self::OtherFrame => {
                Some(OPERATOR_RETRY)
            }
            _ => None,
        }
    }
}

/// Retry interval for failures that an operator has to fix, seconds.
const OPERATOR_RETRY: NonZeroU64 = NonZeroU64::MIN.saturating_add(29);

/// A refusal (RFC 9457).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct ProblemDocument {
    /// `urn:veiloc:problem:` and a stable name.
    #[serde(rename = "type")]
    #[schema(example = "urn:veiloc:problem:queue-full")]
    pub kind: String,
    /// The name as text.
    pub title: &'static str,
    /// The status of the response.
    pub status: u16,
    /// What is wrong with this request, and the remedy.
    pub detail: String,
    /// `not-found` if the query was valid but no pose was found: the third state next to those of an answer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub state: Option<&'static str>,
    /// Seconds after which to send the same bytes again.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub retry_after: Option<u64>,
    /// `urn:veiloc:request:` and the request id, as in the header `veiloc-request-id`; report it to the operator.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "urn:veiloc:request:4bf92f3577b34da6a3ce929d0e0e4736")]
    pub instance: Option<String>,
}

impl ProblemDocument {
    fn body(&self) -> Vec<u8> {
        // Strings and numbers always serialize.
        padding::json(serde_json::to_vec(self).unwrap_or_default())
    }
}

/// Writes the request id into a refusal; other responses are not changed.
pub(crate) fn set_instance(response: &mut Response, id: RequestId) {
    let Some(document) = response.extensions_mut().remove::<Arc<ProblemDocument>>() else { return };
    let mut document = Arc::unwrap_or_clone(document);
    document.instance = Some(format!("urn:veiloc:request:{id}"));
    *response.body_mut() = Body::from(document.body());
}

/// Refusals of queries: status and name, as in the table of docs/reference/http.md.
const QUERY_PROBLEMS: [(u16, &str); 25] = [
    (400, "bad-host"),
    (400, "malformed-query"),
    (400, "unsupported-version"),
    (400, "bad-option"),
    (400, "interrupted"),
    (401, "unauthenticated"),
    (404, "unknown-map"),
    (404, "no-geo-reference"),
    (405, "wrong-method"),
    (408, "too-slow"),
    (409, "wrong-profile"),
    (409, "empty-map"),
    (413, "too-large"),
    (413, "session-too-long"),
    (415, "media-type"),
    (422, "not-localized"),
    (429, "rate-limited"),
    (500, "broken"),
    (503, "map-unavailable"),
    (503, "unreached"),
    (503, "no-tokens"),
    (503, "queue-full"),
    (503, "overdue"),
    (503, "stopping"),
    (504, "timed-out"),
];

/// All outcomes of queries, for all addresses that accept queries.
pub(crate) fn query_outcomes() -> Vec<RequestKind<'static>> {
    let answers = || {
        std::iter::once((200, None)).chain(QUERY_PROBLEMS.map(|(status, problem)| (status, Some(problem))))
    };
    ["/v1/maps/{name}/localize", "/v1/maps/{name}/localize-rig", "/geopose"]
        .into_iter()
        .flat_map(|route| answers().map(move |(status, problem)| RequestKind { route, status, problem }))
        .collect()
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let (status, kind, title) = self.facts();
        let document = ProblemDocument {
            kind: format!("urn:veiloc:problem:{kind}"),
            title,
            status: status.as_u16(),
            detail: self.to_string(),
            state: matches!(self, Self::NotLocalized(_)).then_some("not-found"),
            retry_after: self.retry_after().map(NonZeroU64::get),
            instance: None,
        };
        let mut response =
            (status, [(CONTENT_TYPE, "application/problem+json")], document.body()).into_response();
        let headers = response.headers_mut();
        if let Some(seconds) = self.retry_after() {
            headers.insert(RETRY_AFTER, seconds.get().into());
        }
        if self == Self::Unauthenticated {
            headers.insert(WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        response.extensions_mut().insert(ProblemKind(kind));
        response.extensions_mut().insert(Arc::new(document));
        response.extensions_mut().insert(PadLength);
        response
    }
}

/// Response extension with the name of the problem, for the log.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ProblemKind(pub(crate) &'static str);
