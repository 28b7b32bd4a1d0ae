//! The page: there only when the operator serves one, everybody's but for what a map shows, and bound to its own server.

mod common;

use std::sync::Arc;

use common::http::Request;
use common::{Files, PHONE, Running};
use veiloc_page::Page;

fn page() -> Arc<Page> {
    let mut page = Page::default();
    for name in ["index.html", "veiloc.wasm", "page.js"] {
        page.add(name, name.as_bytes().to_vec()).expect("a file of a page");
    }
    Arc::new(page)
}

#[test]
fn a_page_reaches_its_own_server_alone() {
    let files = Files::new();
    let mut options = files.options();
    options.page = Some(page());
    let server = Running::start(options);
    for (path, content_type, body) in [
        ("/", "text/html; charset=utf-8", "index.html"),
        ("/page/page.js", "text/javascript; charset=utf-8", "page.js"),
        ("/page/veiloc.wasm", "application/wasm", "veiloc.wasm"),
    ] {
        let got = Request::get(path).send(server.address);
        assert_eq!((got.status, got.text().as_str()), (200, body), "{path}: without a token");
        assert_eq!(got.header("content-type"), Some(content_type));
        let policy = got.header("content-security-policy").expect("a policy");
        let mut sources = policy.split(';').flat_map(|rule| rule.split_whitespace().skip(1));
        let own = ["'none'", "'self'", "'wasm-unsafe-eval'", "blob:"];
        assert!(policy.starts_with("default-src 'none'") && sources.all(|s| own.contains(&s)), "{policy}");
        assert!(policy.contains("connect-src 'self'"), "{policy}");
        for (name, value) in [("x-content-type-options", "nosniff"), ("referrer-policy", "no-referrer")] {
            assert_eq!(got.header(name), Some(value), "{path}");
        }
    }
    for path in
        ["/page/no.js", "/page/", "/page", "/page/..%2Findex.html", "/page/%2e%2e/index.html", "/index.html"]
    {
        assert_eq!(Request::get(path).send(server.address).status, 404, "{path}");
    }
    assert_eq!(Request::post("/", b"x").send(server.address).status, 405);
}

#[test]
fn points_are_shown_when_the_operator_says_so_and_to_whom_the_map_is() {
    let files = Files::new();
    let start = |points: usize| {
        let mut options = files.options();
        options.page = Some(page());
        options.page_points = points;
        Running::start(options)
    };
    let server = start(50);
    let ask = |server: &Running, map: &str, token: &str| {
        Request::get(&format!("/page/points/{map}")).token(token).send(server.address)
    };
    let shown = ask(&server, "place", PHONE);
    assert_eq!((shown.status, shown.body.len()), (200, 50 * 12));
    let first = f32::from_le_bytes(shown.body[..4].try_into().expect("four bytes"));
    assert!(first.abs() <= 3.0, "{first} is in no point of the place");
    assert_eq!(ask(&server, "place", "guess").status, 401);
    assert_eq!(ask(&server, "atlantis", PHONE).status, 404);
    assert_eq!(Request::get("/page/points/place").send(server.address).status, 401);
    let none = ask(&start(0), "place", PHONE);
    assert_eq!((none.status, none.body.len()), (200, 0), "by default nothing of a map is shown");
}

#[test]
fn without_a_page_there_is_nothing_of_it() {
    let files = Files::new();
    let server = Running::start(files.options());
    for path in ["/", "/page/index.html", "/page/points/place"] {
        assert_eq!(Request::get(path).token(PHONE).send(server.address).status, 404, "{path}");
    }
}
