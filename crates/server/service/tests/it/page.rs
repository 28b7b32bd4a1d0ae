//! The web page: served only when configured, without a token except for map points, restricted to its own server,
//! and cached.

use super::common;

use std::io::Read as _;
use std::sync::Arc;

use common::http::{Request, Response};
use common::{Files, PHONE, Running, TestScene, eventually};
use flate2::read::GzDecoder;
use veiloc_service::web_page::Page;

fn page() -> Arc<Page> {
    let mut page = Page::default();
    for name in ["index.html", "veiloc.wasm", "page.js"] {
        page.add(name, name.as_bytes().to_vec()).expect("a file of a page");
    }
    Arc::new(page)
}

#[test]
fn page_policy_allows_only_its_own_server() {
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
fn points_need_the_option_and_access_to_the_map() {
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
    assert!(first.abs() <= 3.0, "{first} is outside of the scene");
    assert_eq!(ask(&server, "place", "guess").status, 401);
    assert_eq!(ask(&server, "atlantis", PHONE).status, 404);
    assert_eq!(Request::get("/page/points/place").send(server.address).status, 401);
    let none = ask(&start(0), "place", PHONE);
    assert_eq!((none.status, none.body.len()), (200, 0), "by default no points are shown");
}

#[test]
fn without_a_page_its_addresses_are_unknown() {
    let files = Files::new();
    let server = Running::start(files.options());
    for path in ["/", "/page/index.html", "/page/points/place"] {
        assert_eq!(Request::get(path).token(PHONE).send(server.address).status, 404, "{path}");
    }
}

/// A server whose page has a compressible file.
fn with_long_files() -> (Files, Running) {
    let mut page = Page::clone(&page());
    page.add("long.js", "// the same again\n".repeat(500).into_bytes()).expect("a file of a page");
    page.add("image.png", vec![0; 4096]).expect("a file of a page");
    let files = Files::new();
    let mut options = files.options();
    options.page = Some(Arc::new(page));
    (files, Running::start(options))
}

fn get_with_headers(server: &Running, path: &str, headers: &[(&str, &str)]) -> Response {
    let request =
        headers.iter().fold(Request::get(path), |request, (name, value)| request.header(name, value));
    request.send(server.address)
}

#[test]
fn compressible_files_are_sent_compressed_on_request() {
    let (_files, server) = with_long_files();
    let plain = get_with_headers(&server, "/page/long.js", &[]);
    let short = get_with_headers(&server, "/page/long.js", &[("accept-encoding", "br, gzip")]);
    assert_eq!((plain.header("content-encoding"), short.header("content-encoding")), (None, Some("gzip")));
    assert_eq!(plain.text(), "// the same again\n".repeat(500));
    let mut read = Vec::new();
    GzDecoder::new(&*short.body).read_to_end(&mut read).expect("gzip");
    assert!(read == plain.body && short.body.len() < plain.body.len() / 10, "{}", short.body.len());
    for response in [&plain, &short] {
        assert_eq!(response.header("vary"), Some("accept-encoding"), "caches must distinguish the forms");
        assert_eq!(response.header("cache-control"), Some("no-cache"));
        assert!(response.header("content-security-policy").is_some());
    }
    assert_ne!(plain.header("etag"), short.header("etag"), "other bytes, another tag");

    // Images are compressed already, and a file that does not get shorter stays as it is.
    for path in ["/page/image.png", "/page/page.js"] {
        let response = get_with_headers(&server, path, &[("accept-encoding", "gzip")]);
        assert_eq!((response.header("content-encoding"), response.header("vary")), (None, None), "{path}");
    }
}

#[test]
fn cached_files_are_revalidated() {
    let (_files, server) = with_long_files();
    for encoding in ["identity", "gzip"] {
        let with = |tag: &str| {
            get_with_headers(
                &server,
                "/page/long.js",
                &[("accept-encoding", encoding), ("if-none-match", tag)],
            )
        };
        let first = with("\"none\"");
        let tag = first.header("etag").expect("a tag");
        assert!(tag.len() == 66 && tag.starts_with('"'), "{tag} is a strong tag");
        let again = with(tag);
        assert_eq!((first.status, again.status, again.body.len()), (200, 304, 0), "{encoding}");
        for name in ["etag", "vary", "cache-control", "content-security-policy"] {
            assert_eq!(again.header(name), first.header(name), "{encoding}: {name}");
        }
        assert_eq!(with(&format!("\"other\", W/{tag}")).status, 304);
    }
    let plain = get_with_headers(&server, "/page/long.js", &[]);
    let tag = plain.header("etag").expect("a tag");
    let other =
        get_with_headers(&server, "/page/long.js", &[("accept-encoding", "gzip"), ("if-none-match", tag)]);
    assert_eq!(other.status, 200, "the tag of the other form does not match");
}

#[test]
fn points_follow_the_current_map() {
    let files = Files::new();
    let mut options = files.options();
    options.page = Some(page());
    options.page_points = 100;
    options.watch = Some(std::time::Duration::from_millis(20));
    let server = Running::start(options);
    let ask = |tag: &str| {
        Request::get("/page/points/place").token(PHONE).header("if-none-match", tag).send(server.address)
    };
    let first = ask("\"none\"");
    let tag = first.header("etag").expect("a tag").to_owned();
    assert_eq!(first.header("cache-control"), Some("private, no-cache"), "not for shared caches");
    let again = ask(&tag);
    assert_eq!((first.body.len(), again.status, again.body.len()), (1200, 304, 0));

    let other = TestScene::new(2);
    veiloc_map::write(&other.map(6), &files.path("place.vmap")).expect("written");
    eventually("the other map", || ask(&tag).status == 200);
    let now = ask(&tag);
    assert!(now.body.len() == 1200 && now.body != first.body);
    assert_ne!(now.header("etag"), Some(tag.as_str()));
}
