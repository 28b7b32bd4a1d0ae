//! CORS: allowed origins, exposed headers, and no effect without the option.

use super::common;

use common::http::{Request, Response};
use common::{Files, PHONE, Running, truth};

const PAGE: &str = "https://app.example";

fn preflight(server: &Running, origin: &str) -> Response {
    Request::with_method("OPTIONS", "/v1/maps/place/localize")
        .header("origin", origin)
        .header("access-control-request-method", "POST")
        .header("access-control-request-headers", "authorization,content-type")
        .send(server.address)
}

#[test]
fn only_allowed_origins_get_cors_headers() {
    let files = Files::new();
    let mut options = files.options();
    options.cors =
        vec![PAGE.parse().expect("an origin"), "http://localhost:5173".parse().expect("an origin")];
    let server = Running::start(options);
    let allowed = |response: &Response| response.header("access-control-allow-origin").map(str::to_owned);

    let preflight_response = preflight(&server, PAGE);
    assert_eq!(
        (preflight_response.status, allowed(&preflight_response).as_deref()),
        (204, Some(PAGE)),
        "without a token"
    );
    let header = |name: &str| preflight_response.header(name).unwrap_or_default().to_owned();
    assert_eq!(header("access-control-allow-methods"), "GET, POST, PUT, DELETE");
    for name in ["authorization", "content-type", "veiloc-near", "veiloc-trusted-only"] {
        assert!(header("access-control-allow-headers").contains(name), "{name}");
    }
    assert_eq!(preflight_response.header("access-control-allow-credentials"), None);
    assert_eq!(header("vary").to_lowercase(), "origin");
    for other in ["https://evil.example", "https://app.example.evil", "http://app.example", "null"] {
        let refused = preflight(&server, other);
        assert_eq!((refused.status, allowed(&refused)), (405, None), "{other}");
    }

    // The requesting page, and no other, may read answers and refusals.
    let query = files.scene.sealed(&truth());
    for (token, status) in [(PHONE, 200), ("guess", 401)] {
        let ask = |origin: &str| {
            Request::localize(&query).token(token).header("origin", origin).send(server.address)
        };
        let own = ask(PAGE);
        assert_eq!((own.status, allowed(&own).as_deref()), (status, Some(PAGE)));
        assert!(
            own.header("access-control-expose-headers").is_some_and(|shown| shown.contains("retry-after"))
        );
        let other = ask("https://evil.example");
        assert_eq!((other.status, allowed(&other)), (status, None), "CORS restricts browsers only");
        assert_eq!(server.localize(&query, token).status, status);
    }
}

#[test]
fn without_the_option_no_cors_headers_are_sent() {
    let files = Files::new();
    let server = Running::start(files.options());
    let refused = preflight(&server, PAGE);
    assert_eq!(refused.status, 405);
    let list = Request::get("/v1/maps").token(PHONE).header("origin", PAGE).send(server.address);
    assert_eq!(list.status, 200);
    for response in [refused, list] {
        assert!(
            !response.head.contains("access-control") && !response.head.contains("vary"),
            "{}",
            response.head
        );
    }
}
