//! Refusals and headers that addresses have in common, for the OpenAPI document.

use axum::http::Method;
use utoipa::Modify;
use utoipa::openapi::header::{Header, HeaderBuilder};
use utoipa::openapi::path::{Operation, PathItem};
use utoipa::openapi::schema::{ObjectBuilder, Type};
use utoipa::openapi::{ContentBuilder, OpenApi, Ref, RefOr, Response, ResponseBuilder};

/// Statuses and descriptions; the names of problems are in docs/reference/http.md.
const REFUSALS: [(u16, &str); 15] = [
    (
        400,
        "Not a sealed query of a known version, an option or anchor that is none, or a body that broke off",
    ),
    (401, "No valid token"),
    (403, "The token is not an operator's, or may not write this anchor"),
    (404, "Unknown map or anchor, or no map with a geographic reference"),
    (405, "Another method is needed; see Allow"),
    (408, "The body was too slow; send the same bytes again"),
    (
        409,
        "Sealed for another map or with an older profile, the map is empty, or it has no space for more anchors",
    ),
    (412, "The anchor is not the one that If-Match or If-None-Match demands"),
    (413, "Longer than any query for this map, or more images than the allowance lets through at once"),
    (415, "Another media type, or a compressed body"),
    (422, "The query supports no pose"),
    (429, "Allowance used; see Retry-After"),
    (500, "A bug in veiloc; it was logged"),
    (503, "Busy, stopping, without a valid file of tokens, or the map is unavailable; see Retry-After"),
    (504, "No pose in time; send the same bytes again later"),
];

/// Refusals of an operation.
fn refusals_of(path: &str, method: &Method) -> &'static [u16] {
    match path {
        "/v1/maps/{name}/localize"
        | "/v1/maps/{name}/localize-rig"
        | "/v1/maps/{name}/regions/{region}/localize"
        | "/v1/maps/{name}/regions/{region}/localize-rig"
        | "/geopose" => &[400, 401, 404, 405, 408, 409, 413, 415, 422, 429, 500, 503, 504],
        "/v1/maps/{name}/profile" | "/v1/maps/{name}/pack" => &[401, 404, 405, 429, 503],
        "/v1/maps/{name}/anchors" => &[401, 404, 405, 429, 500, 503],
        "/v1/maps/{name}/anchors/{anchor}" if *method == Method::PUT => {
            &[400, 401, 403, 404, 405, 408, 409, 412, 415, 429, 500, 503]
        }
        "/v1/maps/{name}/anchors/{anchor}" if *method == Method::DELETE => {
            &[400, 401, 403, 404, 405, 412, 429, 500, 503]
        }
        "/v1/maps/{name}/anchors/{anchor}" => &[401, 404, 405, 429, 500, 503],
        "/v1/maps" => &[401, 405, 429, 500, 503],
        "/metrics" => &[401, 403, 405, 503],
        _ => &[405],
    }
}

/// Adds them to all operations.
pub(super) struct Answers;

impl Modify for Answers {
    fn modify(&self, document: &mut OpenApi) {
        for (path, item) in &mut document.paths.paths {
            for (method, operation) in operations(item) {
                for status in refusals_of(path, &method) {
                    let described = REFUSALS.iter().find(|(known, _)| known == status);
                    let description = described.map_or("", |(_, description)| description);
                    let known = operation.responses.responses.entry(status.to_string());
                    // `/readyz` has its own form of 503.
                    known.or_insert_with(|| RefOr::T(refusal(*status, description, &method)));
                }
                for (status, response) in &mut operation.responses.responses {
                    if let RefOr::T(response) = response {
                        let id = "Id of this request, drawn by the service; report it to the operator";
                        response
                            .headers
                            .insert("veiloc-request-id".to_owned(), pattern(id, "^[0-9a-f]{32}$"));
                        if path.ends_with("/profile") && ["200", "304"].contains(&status.as_str()) {
                            let etag = "SHA-256 of the profile in quotation marks, for If-None-Match";
                            response.headers.insert("etag".to_owned(), pattern(etag, "^\"[0-9a-f]{64}\"$"));
                        }
                    }
                }
            }
        }
    }
}

fn operations(item: &mut PathItem) -> impl Iterator<Item = (Method, &mut Operation)> {
    let all = [
        (Method::GET, item.get.as_mut()),
        (Method::POST, item.post.as_mut()),
        (Method::PUT, item.put.as_mut()),
        (Method::DELETE, item.delete.as_mut()),
    ];
    all.into_iter().filter_map(|(method, operation)| Some((method, operation?)))
}

fn refusal(status: u16, description: &str, method: &Method) -> Response {
    let document = ContentBuilder::new().schema(Some(Ref::from_schema_name("ProblemDocument"))).build();
    let response =
        ResponseBuilder::new().description(description).content("application/problem+json", document);
    let response = match status {
        401 => response.header("www-authenticate", pattern("Authentication scheme", "^Bearer$")),
        405 => response.header("allow", pattern("Methods of this address", method.as_str())),
        429 => response.header(
            "retry-after",
            pattern("Seconds after which to send the same bytes again", "^[1-9][0-9]*$"),
        ),
        503 => response.header(
            "retry-after",
            pattern("Seconds after which to send the same bytes again", "^[1-9][0-9]*$"),
        ),
        _ => response,
    };
    response.build()
}

/// A header whose value matches this pattern.
fn pattern(description: &str, form: &str) -> Header {
    let schema = ObjectBuilder::new().schema_type(Type::String).pattern(Some(form)).build();
    HeaderBuilder::new().schema(schema).description(Some(description)).build()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::http::problem::query_outcomes;

    /// Every counted status is described.
    #[test]
    fn every_status_of_a_query_is_described() {
        for route in ["/v1/maps/{name}/localize", "/v1/maps/{name}/localize-rig", "/geopose"] {
            let kinds = query_outcomes();
            let counted =
                kinds.iter().filter(|kind| kind.route == route && kind.status >= 400).map(|kind| kind.status);
            assert_eq!(
                counted.collect::<BTreeSet<_>>(),
                refusals_of(route, &Method::POST).iter().copied().collect()
            );
        }
        let described = |status: &u16| REFUSALS.iter().any(|(known, _)| known == status);
        let paths = [
            "/v1/maps/{name}/localize",
            "/v1/maps/{name}/profile",
            "/v1/maps/{name}/anchors/{anchor}",
            "/v1/maps",
            "/metrics",
            "/healthz",
        ];
        assert!(paths.iter().flat_map(|path| refusals_of(path, &Method::PUT)).all(described));
    }
}
