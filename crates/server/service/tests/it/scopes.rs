//! Tokens restricted to some maps, and expired tokens: a client learns nothing about other maps.

use super::common;

use common::http::Request;
use common::{Files, OPERATOR, PHONE, Running, tokens_file, truth};
use veiloc_service::MapSource;

/// Serves `place` and `garage`.
fn two_maps(files: &Files, tokens: &[(&str, &str)]) -> Running {
    std::fs::copy(files.path("place.vmap"), files.path("garage.vmap")).expect("copied");
    std::fs::write(files.path("tokens"), tokens_file(tokens)).expect("written");
    let mut options = files.options();
    options.maps.push(MapSource { name: "garage".to_owned(), path: files.path("garage.vmap") });
    Running::start(options)
}

fn names(server: &Running, token: &str) -> Vec<String> {
    let list = server.get("/v1/maps", token).json();
    let maps = list["maps"].as_array().expect("maps");
    maps.iter().map(|map| map["name"].as_str().expect("a name").to_owned()).collect()
}

#[test]
fn restricted_token_learns_nothing_of_other_maps() {
    let files = Files::new();
    let server =
        two_maps(&files, &[(PHONE, "maps=place"), ("visitor", "maps=elsewhere"), (OPERATOR, "operator")]);
    assert_eq!(names(&server, PHONE), ["place"]);
    assert_eq!(names(&server, OPERATOR), ["place", "garage"]);
    assert!(names(&server, "visitor").is_empty());
    let query = files.scene.sealed(&truth());
    assert_eq!(server.localize(&query, PHONE).status, 200);
    assert_eq!(server.localize(&query, "visitor").problem(), "unknown-map");
    // The response is the same as for a map that does not exist, except for the request id.
    let rig = |map: &str| {
        Request::post(&format!("/v1/maps/{map}/localize-rig"), b"vqrig1\n")
            .header("content-type", "application/octet-stream")
    };
    let one = |map: &str| {
        Request::post(&format!("/v1/maps/{map}/localize"), &query)
            .header("content-type", "application/x-protobuf")
    };
    let profile = |map: &str| Request::get(&format!("/v1/maps/{map}/profile"));
    let same = |request: &dyn Fn(&str) -> Request| {
        let [there, nowhere] =
            ["garage", "nowhere"].map(|map| request(map).token(PHONE).send(server.address));
        let own = |line: &&str| line.starts_with("date:") || line.starts_with("veiloc-request-id:");
        let without_date =
            |head: &str| head.lines().filter(|line| !own(line)).map(str::to_owned).collect::<Vec<_>>();
        let unnamed = |reply: &common::http::Response| {
            let mut problem = reply.json();
            problem["instance"] = "".into();
            (reply.body.len(), problem)
        };
        assert_eq!(there.problem(), "unknown-map");
        assert_eq!(without_date(&there.head), without_date(&nowhere.head));
        assert_eq!(unnamed(&there), unnamed(&nowhere));
        assert_eq!(request("garage").token(OPERATOR).send(server.address).status, 200);
    };
    same(&one);
    same(&profile);
    assert_eq!(rig("garage").token(PHONE).send(server.address).problem(), "unknown-map");
    assert_eq!(rig("garage").token(OPERATOR).send(server.address).problem(), "malformed-query");
}

#[test]
fn expired_token_is_unknown() {
    let files = Files::new();
    let server =
        two_maps(&files, &[(PHONE, "expires=2020-01-01"), ("later", "expires=9999-01-01T00:00:00Z")]);
    assert_eq!(server.get("/v1/maps", PHONE).problem(), "unauthenticated");
    assert_eq!(server.get("/v1/maps", "no token at all").problem(), "unauthenticated");
    assert_eq!(server.get("/v1/maps", "later").status, 200);
    // Its connection does not count as authenticated either.
    let mut stream = common::http::connect(server.address);
    let ask = |stream: &mut std::net::TcpStream| {
        use std::io::Write as _;
        stream.write_all(&Request::get("/v1/maps").token(PHONE).bytes()).expect("written");
        common::http::Response::read(stream).status
    };
    assert_eq!(ask(&mut stream), 401);
}
