//! Content anchors: who reads and writes them, what is refused, and what survives.

use super::common;

use std::fs;
use std::sync::Arc;
use std::time::Duration;

use common::http::{Request, Response};
use common::{Files, Running, eventually, tokens_file};
use serde_json::{Value, json};
use veiloc_geometry::{CameraFromWorld, nalgebra::Vector3};
use veiloc_map::{MapFile, anchors_path};
use veiloc_service::{AnswerFuture, MapDescription, RemoteBackend, RemoteMap, RemoteRequest};

const LIST: &str = "/v1/maps/place/anchors";
const DOOR: &str = "/v1/maps/place/anchors/door";

/// Tokens whose names are themselves: two that write, one that reads, an operator that writes and one that does not, and
/// one of another map.
fn files() -> Files {
    let files = Files::new();
    let roles = [
        ("ann", "anchors"),
        ("bob", "anchors"),
        ("visitor", ""),
        ("chief", "operator anchors"),
        ("watcher", "operator"),
        ("stranger", "anchors maps=elsewhere"),
    ];
    let line = |(name, role): &(&str, &str)| tokens_file(&[(name, role)]).replace("someone", name);
    fs::write(files.path("tokens"), roles.iter().map(line).collect::<String>()).expect("written");
    files
}

fn at(x: f64) -> Value {
    json!({"map_from_anchor": {"q": [1, 0, 0, 0], "t": [x, 2, 3]}, "content": {"text": "mind the step"}})
}

fn put(path: &str, body: &str) -> Request {
    let head = format!("PUT {path} HTTP/1.1\r\nhost: test\r\ncontent-length: {}\r\n", body.len());
    Request { head, body: body.as_bytes().to_vec() }.header("content-type", "application/json")
}

struct Client<'a>(&'a Running, &'a str);

impl Client<'_> {
    fn send(&self, request: Request) -> Response {
        request.token(self.1).send(self.0.address)
    }
    fn put(&self, path: &str, body: &Value) -> Response {
        self.send(put(path, &body.to_string()))
    }
    fn delete(&self, path: &str) -> Response {
        self.send(Request::with_method("DELETE", path))
    }
    fn get(&self, path: &str) -> Response {
        self.send(Request::get(path))
    }
    fn names(&self) -> Vec<String> {
        let list = self.get(LIST).json();
        let all = list["anchors"].as_array().expect("anchors").iter();
        all.map(|anchor| anchor["name"].as_str().expect("a name").to_owned()).collect()
    }
}

#[test]
fn anchors_are_written_listed_and_deleted_and_survive_a_restart() {
    let files = files();
    let server = Running::start(files.options());
    let (ann, visitor) = (Client(&server, "ann"), Client(&server, "visitor"));
    assert_eq!(ann.get(LIST).json(), json!({"version": 1, "anchors": []}));
    let first = ann.put(DOOR, &at(1.0));
    assert_eq!(first.status, 201, "{first:?}");
    assert_eq!((first.json()["name"].as_str(), first.json()["owner"].as_str()), (Some("door"), Some("ann")));
    assert_eq!(ann.put(DOOR, &at(1.5)).status, 200);
    assert_eq!(ann.put("/v1/maps/place/anchors/a.1", &at(4.0)).status, 201);
    assert_eq!(visitor.names(), ["a.1", "door"]);
    let one = visitor.get(DOOR);
    let mut expected = at(1.5);
    expected["name"] = "door".into();
    for (a, b) in [("q", [1.0, 0.0, 0.0, 0.0].as_slice()), ("t", &[1.5, 2.0, 3.0])] {
        expected["map_from_anchor"][a] = b.into();
    }
    assert_eq!(one.json(), expected, "visitors do not get the owner");
    let tag = one.header("etag").expect("a tag");
    let again = |tag: &str| visitor.send(Request::get(DOOR).header("if-none-match", tag)).status;
    assert_eq!((again(tag), again("\"other\"")), (304, 200));
    let kept = server.get(LIST, "ann").json();
    server.stop();

    let server = Running::start(files.options());
    let ann = Client(&server, "ann");
    assert_eq!(ann.get(LIST).json(), kept);
    assert_eq!((ann.delete(DOOR).status, ann.delete(DOOR).problem().as_str()), (204, "unknown-anchor"));
    assert_eq!(ann.get(DOOR).problem(), "unknown-anchor");
    assert_eq!(ann.delete("/v1/maps/place/anchors/a.1").status, 204);
    assert!(!anchors_path(&files.path("place.vmap")).exists(), "no empty file is left");
}

#[test]
fn only_permitted_tokens_write_and_only_their_own() {
    let files = files();
    let server = Running::start(files.options());
    let ann = Client(&server, "ann");
    assert_eq!(ann.put(DOOR, &at(1.0)).status, 201);
    for (token, problem) in [
        ("visitor", "anchors-read-only"),
        ("watcher", "anchors-read-only"),
        ("bob", "not-owner"),
        ("stranger", "unknown-map"),
        ("nobody-knows-it", "unauthenticated"),
    ] {
        let client = Client(&server, token);
        assert_eq!(client.put(DOOR, &at(2.0)).problem(), problem, "{token}");
        assert_eq!(client.delete(DOOR).problem(), problem, "{token}");
    }
    assert_eq!(Client(&server, "stranger").get(LIST).problem(), "unknown-map");
    // Owners and operators get the name of the owner.
    let owner = |token: &str| {
        Client(&server, token).get(LIST).json()["anchors"][0]["owner"].as_str().map(str::to_owned)
    };
    assert_eq!(["ann", "watcher"].map(owner), [Some("ann".to_owned()), Some("ann".to_owned())]);
    assert_eq!(["bob", "visitor"].map(owner), [None, None]);
    // A client cannot name an owner, and an operator does not become it.
    let mut forged = at(5.0);
    forged["owner"] = "ann".into();
    let bob = Client(&server, "bob");
    assert_eq!(bob.put("/v1/maps/place/anchors/sofa", &forged).json()["owner"], "bob");
    let corrected = Client(&server, "chief").put(DOOR, &at(3.0));
    assert_eq!((corrected.status, corrected.json()["owner"].as_str()), (200, Some("ann")));
    assert_eq!(Client(&server, "chief").delete(DOOR).status, 204);

    // Without tokens nobody may write.
    let open = Running::start(files.open_options());
    assert_eq!(Client(&open, "").put(DOOR, &at(1.0)).problem(), "anchors-read-only");
    assert_eq!(Client(&open, "").names(), ["sofa"]);
}

#[test]
fn hostile_input_is_refused() {
    let files = files();
    let server = Running::start(files.options());
    let ann = Client(&server, "ann");
    for (body, problem) in [
        ("", "bad-anchor"),
        ("null", "bad-anchor"),
        (r#"{"map_from_anchor":{"q":[1,0,0,0],"t":[0,0,0]},"content":NaN}"#, "bad-anchor"),
        (r#"{"map_from_anchor":{"q":[1,0,0,0],"t":[0,0,1e400]}}"#, "bad-anchor"),
        (r#"{"map_from_anchor":{"q":[1,0,0,0],"t":[0,0,1e9]}}"#, "bad-anchor"),
        (r#"{"map_from_anchor":{"q":[0,0,0,0],"t":[0,0,0]}}"#, "bad-anchor"),
        (r#"{"map_from_anchor":{"q":[1,1,1,1],"t":[0,0,0]}}"#, "bad-anchor"),
        (r#"{"map_from_anchor":{"q":[1,0,0,0],"t":[0,0,0]},"more":1}"#, "bad-anchor"),
        (r#"{"name":"gate","map_from_anchor":{"q":[1,0,0,0],"t":[0,0,0]}}"#, "bad-anchor"),
    ] {
        let refused = ann.send(put(DOOR, body));
        assert_eq!(refused.problem(), problem, "{body}");
    }
    let deep =
        format!(r#"{{"map_from_anchor":{{"q":[1,0,0,0],"t":[0,0,0]}},"content":{}}}"#, "[".repeat(2000));
    assert_eq!(ann.send(put(DOOR, &deep)).problem(), "bad-anchor");
    for length in [4095, 9000, 2_000_000] {
        let long = json!({"map_from_anchor": at(0.0)["map_from_anchor"], "content": "x".repeat(length)});
        let refused = ann.put(DOOR, &long);
        assert!(
            refused.problem() == "bad-anchor" && refused.text().contains("4096"),
            "{length}: {}",
            refused.text()
        );
    }
    for name in ["..", "a%20b", "%C3%A4", &"x".repeat(65)] {
        let refused = ann.put(&format!("{LIST}/{name}"), &at(0.0)).problem();
        assert!(refused == "bad-anchor" || refused == "wrong-method", "{name}: {refused}");
    }
    let untyped =
        Request { head: put(DOOR, "").head.replace("application/json", "text/plain"), body: Vec::new() };
    assert_eq!(ann.send(untyped).problem(), "media-type");
    assert_eq!(ann.send(Request::with_method("POST", DOOR)).problem(), "wrong-method");
    assert_eq!(ann.names(), [""; 0]);

    // A full map, whose file an operator imported.
    let anchor =
        |i: usize| json!({"name": i.to_string(), "map_from_anchor": {"q": [1, 0, 0, 0], "t": [0, 0, 0]}});
    let full = json!({"version": 1, "anchors": (0..1000).map(anchor).collect::<Vec<_>>()});
    fs::write(anchors_path(&files.path("place.vmap")), full.to_string()).expect("written");
    assert_eq!(ann.put(DOOR, &at(0.0)).problem(), "anchors-full");
    assert_eq!(ann.put(&format!("{LIST}/7"), &at(0.0)).problem(), "not-owner", "nobody owns it");
    assert_eq!(Client(&server, "chief").put(&format!("{LIST}/7"), &at(0.0)).status, 200, "replaced");
    fs::write(anchors_path(&files.path("place.vmap")), &full.to_string()[..500]).expect("written");
    for response in [ann.get(LIST), ann.put(DOOR, &at(0.0)), ann.delete(DOOR)] {
        assert_eq!(response.problem(), "anchors-unavailable");
    }
}

#[test]
fn concurrent_writers_lose_nothing() {
    let files = files();
    let server = Running::start(files.options());
    let created: usize = std::thread::scope(|scope| {
        let server = &server;
        let write = |i: usize| {
            scope.spawn(move || {
                let ann = Client(server, if i.is_multiple_of(2) { "ann" } else { "bob" });
                assert_eq!(ann.put(&format!("{LIST}/{i}"), &at(i as f64)).status, 201);
                let once = put(DOOR, &at(0.0).to_string()).header("if-none-match", "*");
                usize::from(ann.send(once).status == 201)
            })
        };
        (0..12).map(write).collect::<Vec<_>>().into_iter().map(|thread| thread.join().expect("written")).sum()
    });
    assert_eq!((created, Client(&server, "visitor").names().len()), (1, 13));

    // With a tag a change is refused when another came first; without one the last writer wins.
    let ann = Client(&server, "ann");
    let path = format!("{LIST}/0");
    let tag = ann.get(&path).header("etag").expect("a tag").to_owned();
    let with_tag = |tag: &str, x: f64| ann.send(put(&path, &at(x).to_string()).header("if-match", tag));
    let next = with_tag(&tag, 7.0);
    assert_eq!((next.status, with_tag(&tag, 8.0).problem().as_str()), (200, "precondition-failed"));
    let stale = Request::with_method("DELETE", &path).header("if-match", &tag);
    assert_eq!(ann.send(stale).problem(), "precondition-failed");
    assert_eq!(with_tag(next.header("etag").expect("a tag"), 8.0).status, 200);
    assert_eq!(ann.put(&path, &at(9.0)).status, 200);
    assert_eq!(ann.get(&path).json()["map_from_anchor"]["t"][0], 9.0);
    let absent = Request::with_method("DELETE", &format!("{LIST}/none")).header("if-match", "*");
    assert_eq!(ann.send(absent).problem(), "precondition-failed");
}

/// A map that is replaced keeps its anchors if its coordinate frame stays, and none are given for another frame.
#[test]
fn anchors_stay_with_their_coordinate_frame() {
    let files = files();
    let mut options = files.options();
    options.watch = Some(Duration::from_millis(10));
    let server = Running::start(options);
    let ann = Client(&server, "ann");
    assert_eq!(ann.put(DOOR, &at(1.0)).status, 201);
    let path = files.path("place.vmap");
    let old = MapFile::open(&path).expect("the map").to_model();
    let points = |count: usize| {
        eventually("the new map", || server.get("/v1/maps", "ann").json()["maps"][0]["points"] == count);
    };
    let mut fewer = old.clone();
    fewer.points.pop();
    fewer.link_keypoints();
    veiloc_map::write(&fewer, &path).expect("written");
    points(fewer.points.len());
    assert_eq!((ann.get(DOOR).status, ann.put(DOOR, &at(2.0)).status), (200, 200));

    let mut moved = old;
    for image in &mut moved.images {
        let pose = image.cam_from_world;
        let shift = Vector3::new(0.01, 0.0, 0.0);
        image.cam_from_world =
            CameraFromWorld::new(*pose.rotation(), pose.translation() - pose.rotation() * shift);
    }
    for point in &mut moved.points {
        point.position.coords.x += 0.01;
    }
    veiloc_map::write(&moved, &path).expect("written");
    points(moved.points.len());
    for response in [ann.get(LIST), ann.get(DOOR), ann.put(DOOR, &at(0.0)), ann.delete(DOOR)] {
        assert!(
            response.problem() == "other-frame" && response.text().contains("--carry"),
            "{}",
            response.text()
        );
    }
}

#[test]
fn a_gateway_says_that_it_keeps_no_anchors() {
    struct Elsewhere(Arc<MapDescription>);
    impl RemoteBackend for Elsewhere {
        fn describe(&self) -> Option<Arc<MapDescription>> {
            Some(self.0.clone())
        }
        fn is_complete(&self) -> bool {
            true
        }
        fn localize(&self, _: RemoteRequest) -> AnswerFuture<'_> {
            unreachable!("no query is sent")
        }
    }
    let files = files();
    let map = MapFile::open(&files.path("place.vmap")).expect("the map");
    let (profile, coordinates) = (map.profile().clone(), map.coordinates());
    let backend =
        Arc::new(Elsewhere(Arc::new(MapDescription { profile, images: 1, points: 1, coordinates })));
    let mut options = files.options();
    (options.maps, options.remote_maps) = (Vec::new(), vec![RemoteMap { name: "place".to_owned(), backend }]);
    let server = Running::start(options);
    let ann = Client(&server, "ann");
    for response in [ann.get(LIST), ann.get(DOOR), ann.put(DOOR, &at(0.0)), ann.delete(DOOR)] {
        assert_eq!((response.status, response.problem().as_str()), (404, "no-anchors"));
    }
}
