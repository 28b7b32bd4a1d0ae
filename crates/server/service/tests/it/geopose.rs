//! The GeoPose Protocol: a sealed query in JSON in, a GeoPose out; and invalid requests.

use super::common;

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use common::http::{Request, Response};
use common::{Files, OPERATOR, PHONE, Running, TestScene, tokens_file, truth};
use serde_json::{Value, json};
use veiloc_geometry::Geodetic;
use veiloc_geometry::nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use veiloc_protocol::Answer;
use veiloc_service::{Server, ServerError};

const REFERENCE: &str = "place=47.3769,8.5417,455,30";

/// A request as `@oarc/gpp-access` 0.2.1 makes it.
pub(super) fn request(query: &[u8]) -> Value {
    let privacy = |applied: &[&str]| {
        json!({"dataRetention": [], "dataAcceptableUse": [], "dataSanitizationApplied": applied,
               "dataSanitizationRequested": []})
    };
    json!({
        "id": "9d9e1d4c", "timestamp": 1_700_000_000_123_u64, "type": "geopose",
        "sensors": [{"id": "0", "type": "camera"}, {"id": "1", "type": "geolocation"}],
        "sensorReadings": {
            "cameraReadings": [{
                "timestamp": 1_700_000_000_100_u64, "sensorId": "0", "privacy": privacy(&["dcl"]), "sequenceNumber": 0,
                "imageFormat": "VEILOC_SEALED_QUERY", "size": [640, 480], "imageBytes": BASE64_STANDARD.encode(query),
                "imageOrientation": {"mirrored": false, "rotation": 0},
            }],
            "geolocationReadings": [{
                "timestamp": 1_700_000_000_100_u64, "sensorId": "1", "privacy": privacy(&[]), "latitude": 47.4,
                "longitude": 8.5, "altitude": 0, "accuracy": 20, "altitudeAccuracy": 0, "heading": 0, "speed": 0,
            }],
        },
    })
}

fn ask(server: &Running, request: &Value) -> Response {
    send(server, request.to_string().as_bytes(), PHONE)
}

fn send(server: &Running, body: &[u8], token: &str) -> Response {
    Request::post("/geopose", body)
        .token(token)
        .header("content-type", "application/json")
        .header("accept", "application/vnd.oscp+json;version=2.0;")
        .send(server.address)
}

/// A server that knows where its map is on earth.
pub(super) fn start(files: &Files) -> Running {
    let mut options = files.options();
    options.geo_references = vec![REFERENCE.parse().expect("valid")];
    Running::start(options)
}

#[test]
fn geopose_is_that_of_the_camera() {
    let files = Files::new();
    let server = start(&files);
    let response = ask(&server, &request(&files.scene.sealed(&truth())));
    assert_eq!((response.status, response.body.len()), (200, Answer::PADDED_BYTES), "{}", response.text());
    let found = response.json();
    assert_eq!(found["id"], "9d9e1d4c");
    assert_eq!((&found["timestamp"], &found["type"]), (&json!(1_700_000_000_123.0), &json!("geopose")));
    let number = |pointer: &str| found.pointer(pointer).and_then(Value::as_f64).expect("a number");

    // Position: the centre of the camera, turned by 30 degrees from east to north, about the origin.
    let origin = Geodetic { latitude: 47.3769, longitude: 8.5417, altitude: 455.0 };
    let [latitude, longitude, altitude] =
        ["lat", "lon", "h"].map(|name| number(&format!("/geopose/position/{name}")));
    let enu = origin.east_north_up(&Geodetic { latitude, longitude, altitude });
    let (sin, cos) = 30_f64.to_radians().sin_cos();
    let turn = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
    assert!((enu - turn * truth().center().coords).norm() < 0.03, "{enu}");

    // Orientation: where the camera looks is the body's second axis, and its right the first one.
    let [x, y, z, w] = ["x", "y", "z", "w"].map(|name| number(&format!("/geopose/quaternion/{name}")));
    let enu_from_body = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    let map_from_cam = truth().rotation().inverse();
    for (in_body, in_camera) in
        [(Vector3::y(), Vector3::z()), (Vector3::x(), Vector3::x()), (Vector3::z(), -Vector3::y())]
    {
        let apart = enu_from_body * in_body - turn * (map_from_cam * in_camera);
        assert!(apart.norm() < 0.02, "{apart}");
    }
    assert!((1e-5..0.1).contains(&number("/accuracy/position")), "{found}");
    assert!((1e-4..2.0).contains(&number("/accuracy/orientation")), "{found}");
    let metrics = server.get("/metrics", OPERATOR).text();
    assert!(
        metrics.contains("veiloc_requests_total{route=\"/geopose\",status=\"200\",problem=\"\"} 1"),
        "{metrics}"
    );
}

#[test]
fn doubtful_poses_are_refused() {
    let files = Files::new();
    let server = start(&files);
    for query in [files.scene.sealed_with_doubts(), files.scene.sealed_without_consensus()] {
        let response = ask(&server, &request(&query));
        assert_eq!(
            (response.status, response.problem()),
            (422, "not-localized".into()),
            "{}",
            response.text()
        );
        assert_eq!(response.body.len(), Answer::PADDED_BYTES);
    }
}

#[test]
fn invalid_requests_are_refused() {
    let files = Files::new();
    let server = start(&files);
    let query = files.scene.sealed(&truth());
    let with = |pointer: &str, value: Value| {
        let mut request = request(&query);
        *request.pointer_mut(pointer).expect("a field") = value;
        request
    };
    let camera = "/sensorReadings/cameraReadings/0";
    let readings = |count: usize| {
        let reading = request(&query)["sensorReadings"]["cameraReadings"][0].clone();
        with("/sensorReadings/cameraReadings", json!(vec![reading; count]))
    };
    let other = TestScene::new(2).sealed(&truth());
    for (what, request, problem) in [
        ("an image", with(&format!("{camera}/imageFormat"), json!("JPG")), "malformed-query"),
        (
            "not protected",
            with(&format!("{camera}/privacy/dataSanitizationApplied"), json!([])),
            "malformed-query",
        ),
        (
            "another scheme",
            with(&format!("{camera}/privacy/dataSanitizationApplied"), json!(["random-lines"])),
            "malformed-query",
        ),
        ("no base64", with(&format!("{camera}/imageBytes"), json!("?")), "malformed-query"),
        ("no query", with(&format!("{camera}/imageBytes"), json!("AAAA")), "malformed-query"),
        ("rotated", with(&format!("{camera}/imageOrientation/rotation"), json!(90)), "malformed-query"),
        ("mirrored", with(&format!("{camera}/imageOrientation/mirrored"), json!(true)), "malformed-query"),
        ("another type", with("/type", json!("objectpose")), "malformed-query"),
        ("a long id", with("/id", json!("x".repeat(257))), "malformed-query"),
        ("no readings", readings(0), "malformed-query"),
        ("two readings", readings(2), "malformed-query"),
        ("no request", json!({}), "malformed-query"),
        (
            "another map",
            with(&format!("{camera}/imageBytes"), json!(BASE64_STANDARD.encode(other))),
            "wrong-profile",
        ),
        ("too large", with("/id", json!("x".repeat(2_000_000))), "too-large"),
    ] {
        let response = ask(&server, &request);
        assert_eq!(response.problem(), problem, "{what}: {}", response.text());
        assert_eq!(response.body.len(), Answer::PADDED_BYTES, "{what}");
    }
    assert_eq!(send(&server, b"{", PHONE).problem(), "malformed-query");
    let quoted = ask(&server, &with("/timestamp", json!("0")));
    assert!(quoted.text().contains("timestamp is a number"), "{}", quoted.text());
    assert_eq!(send(&server, request(&query).to_string().as_bytes(), "").problem(), "unauthenticated");
    let protobuf =
        Request::post("/geopose", &query).token(PHONE).header("content-type", "application/x-protobuf");
    assert_eq!(protobuf.send(server.address).problem(), "media-type");
    // Valid requests are answered still, also with the line breaks of Android's encoder, and without padding.
    let text = BASE64_STANDARD.encode(&query);
    let lines = text.as_bytes().chunks(76).map(|line| String::from_utf8_lossy(line).into_owned() + "\r\n");
    for text in [text.clone(), lines.collect(), text.trim_end_matches('=').to_owned()] {
        assert_eq!(ask(&server, &with(&format!("{camera}/imageBytes"), json!(text))).status, 200);
    }
}

#[test]
fn maps_without_a_reference_give_no_geopose() {
    let files = Files::new();
    let request = request(&files.scene.sealed(&truth()));
    let server = Running::start(files.options());
    let response = ask(&server, &request);
    assert_eq!(
        (response.status, response.problem()),
        (404, "no-geo-reference".into()),
        "{}",
        response.text()
    );
    drop(server);
    // The same for a token that may not use the map.
    std::fs::write(files.path("tokens"), tokens_file(&[(PHONE, "maps=garage")])).expect("written");
    let server = start(&files);
    assert_eq!(ask(&server, &request).problem(), "no-geo-reference");
}

#[test]
fn references_to_maps_that_are_not_served_are_refused() {
    let files = Files::new();
    let mut options = files.options();
    options.geo_references = vec!["plaza=47,8,400".parse().expect("valid")];
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let refused = runtime.block_on(Server::bind(options)).err();
    assert!(matches!(&refused, Some(ServerError::GeoReference { name }) if name == "plaza"), "{refused:?}");
}
