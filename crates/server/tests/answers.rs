//! What a client gets when all is well.

mod common;

use common::http::Request;
use common::{Files, OPERATOR, PHONE, Running, truth};
use veiloc_geometry::CameraFromWorld;
use veiloc_localize::{LocalizeOptions, localize};
use veiloc_map::MapFile;
use veiloc_query::{Answer, AnswerDocument, Profile, SealedQuery};

#[test]
fn a_sealed_query_gets_the_pose_the_library_finds() {
    let files = Files::new();
    let server = Running::start(files.options());
    let query = files.place.sealed(&truth());
    let map = MapFile::open(&files.path("place.vmap")).expect("a map");
    let sealed = SealedQuery::decode(&query).expect("own bytes");
    let expected = localize(&sealed, &map, &LocalizeOptions::default()).expect("localized");

    let response = Request::localize(&query)
        .token(PHONE)
        .header("accept", "application/x-protobuf")
        .send(server.address);
    assert_eq!((response.status, response.header("content-type")), (200, Some("application/x-protobuf")));
    let answer = Answer::decode(&response.body).expect("an answer");
    let pose = CameraFromWorld::from_quaternion(answer.rotation, answer.translation).expect("a pose");
    assert!(pose.translation_error(&truth()) < 0.03 && pose.rotation_error_degrees(&truth()) < 0.5);
    assert_eq!(answer.rotation, expected.cam_from_world.quaternion());
    assert_eq!(answer.covariance, expected.covariance);
    assert_eq!((answer.inliers as usize, answer.matches as usize), (expected.inliers, expected.matches));
    assert_eq!((answer.trusted, answer.doubts.len()), (true, 0));
    let center = pose.center().coords;
    assert!((0..3).all(|i| (center[i] - answer.center[i]).abs() < 1e-9));

    // The centre's covariance, by pushing the pose's through finite differences of the centre.
    let jacobian: Vec<[f64; 3]> = (0..6)
        .map(|i| {
            let mut step = [0.0; 6];
            step[i] = 1e-6;
            let moved = pose.perturbed(&step).center().coords - center;
            std::array::from_fn(|k| moved[k] / 1e-6)
        })
        .collect();
    for a in 0..3 {
        for b in 0..3 {
            let expected: f64 = (0..36)
                .map(|ij| jacobian[ij / 6][a] * answer.covariance[ij / 6][ij % 6] * jacobian[ij % 6][b])
                .sum();
            let got = answer.center_covariance[a][b];
            let scale = answer.center_covariance[a][a].max(answer.center_covariance[b][b]);
            assert!((got - expected).abs() < 1e-3 * scale, "[{a}][{b}] {got} {expected}");
        }
    }

    // JSON tells the same, but for the times.
    let response = server.localize(&query, PHONE);
    assert_eq!((response.status, response.header("content-type")), (200, Some("application/json")));
    let mut told = response.json();
    // Read back as the other was: the reader of the tests does not keep the last digit of every number.
    let same = serde_json::to_string(&AnswerDocument::new("place", &answer)).expect("JSON");
    let mut same: serde_json::Value = serde_json::from_str(&same).expect("JSON");
    for document in [&mut told, &mut same] {
        let times = document["ms"].take();
        let names: Vec<&str> = times.as_object().expect("times").keys().map(String::as_str).collect();
        assert_eq!(names, ["match", "pose", "queue", "retrieve"]);
    }
    assert_eq!(told, same);
}

#[test]
fn profiles_are_fetched_once() {
    let files = Files::new();
    let server = Running::start(files.options());
    let first = server.get("/v1/maps/place/profile", PHONE);
    assert_eq!(first.status, 200);
    let profile = Profile::decode(&first.body).expect("a profile");
    assert_eq!(profile, files.place.profile);
    let etag = first.header("etag").expect("an ETag").to_owned();
    assert!(etag.trim_matches('"').starts_with(&profile.id().to_string()), "the profile's own name and more");

    let with = |tag: &str| {
        Request::get("/v1/maps/place/profile").token(PHONE).header("if-none-match", tag).send(server.address)
    };
    for tag in [etag.clone(), format!("\"other\", {etag}"), format!("W/{etag}"), "*".to_owned()] {
        let response = with(&tag);
        assert_eq!((response.status, response.body.len()), (304, 0), "{tag}");
        assert_eq!(response.header("etag"), Some(etag.as_str()));
    }
    assert_eq!(with("\"other\"").status, 200);

    let list = server.get("/v1/maps", PHONE).json();
    assert_eq!(list["maps"][0]["name"], "place");
    assert_eq!(list["maps"][0]["images"], 6);
    assert_eq!(list["maps"][0]["profile_id"], profile.id().to_string());
}

#[test]
fn a_map_is_served_under_each_of_its_names() {
    let files = Files::new();
    let mut options = files.open_options();
    let mut second = options.maps[0].clone();
    second.name = "second".to_owned();
    options.maps.push(second);
    let server = Running::start(options);
    let query = files.place.sealed(&truth());
    for name in ["place", "second"] {
        let request = Request::post(&format!("/v1/maps/{name}/localize"), &query)
            .header("content-type", "application/octet-stream; x=y");
        let response = request.send(server.address);
        assert_eq!((response.status, &response.json()["map"]), (200, &name.into()));
    }
}

/// A map at a known place on Earth tells where on Earth an image was taken.
#[test]
fn a_map_tied_to_earth_tells_geo_poses() {
    let files = Files::new();
    let mut options = files.open_options();
    // The map's axes are the camera's of an upright image looking north: x east, y down, z north.
    options.maps[0].geo = Some("47.5,8.5,400,0.70710678,-0.70710678,0,0".parse().expect("a frame"));
    let server = Running::start(options);
    let request =
        Request::localize(&files.place.sealed(&truth())).header("accept", "application/geopose+json");
    let response = request.send(server.address);
    assert_eq!((response.status, response.header("content-type")), (200, Some("application/geopose+json")));
    let told = response.json();
    let number = |pointer: &str| told.pointer(pointer).and_then(serde_json::Value::as_f64).expect("a number");
    let center = truth().center().coords;
    // East and north by the radii of curvature at this latitude: 111 179 m and 75 342 m a degree.
    assert!(((number("/position/lon") - 8.5) * 75_342.0 - center.x).abs() < 0.03, "{told}");
    assert!(((number("/position/lat") - 47.5) * 111_179.0 - center.z).abs() < 0.03, "{told}");
    assert!((number("/position/h") - 400.0 + center.y).abs() < 0.03, "{told}");
    let q = ["w", "x", "y", "z"].map(|c| number(&format!("/quaternion/{c}")));
    assert!((q.iter().map(|c| c * c).sum::<f64>() - 1.0).abs() < 1e-9);
    assert!(number("/accuracy/horizontal") > 0.0 && number("/accuracy/horizontal") < 0.1, "{told}");
    assert_eq!(told["trusted"], true);
}

/// Many requests on one connection.
#[test]
fn a_connection_is_used_again() {
    let files = Files::new();
    let server = Running::start(files.open_options());
    let request = Request::localize(&files.place.sealed(&truth())).bytes();
    let mut stream = common::http::connect(server.address);
    for _ in 0..3 {
        std::io::Write::write_all(&mut stream, &request).expect("written");
        assert_eq!(common::http::Response::read(&mut stream).status, 200);
    }
}

#[test]
fn operators_see_how_it_is_doing() {
    let files = Files::new();
    let server = Running::start(files.options());
    assert_eq!((server.get("/healthz", "").status, server.get("/readyz", "").status), (200, 200));
    let query = files.place.sealed(&truth());
    assert_eq!(server.localize(&query, PHONE).status, 200);
    assert_eq!(server.localize(&query, "wrong").status, 401);

    assert_eq!(server.get("/metrics", PHONE).problem(), "forbidden");
    assert_eq!(server.get("/metrics", "").problem(), "unauthenticated");
    let text = server.get("/metrics", OPERATOR).text();
    for line in [
        "veiloc_requests_total{route=\"/v1/maps/{name}/localize\",status=\"200\",problem=\"\"} 1",
        "veiloc_requests_total{route=\"/v1/maps/{name}/localize\",status=\"401\",problem=\"unauthenticated\"} 1",
        "veiloc_localizations_total{map=\"place\",outcome=\"trusted\"} 1",
        "veiloc_stage_seconds_count{stage=\"pose\"} 1",
        "veiloc_stage_seconds_count{stage=\"queue\"} 1",
        "veiloc_queue_length 0",
        "veiloc_workers_busy 0",
        "# EOF",
    ] {
        assert!(text.lines().any(|l| l == line), "{line} is not in\n{text}");
    }
}

/// Every address of the document answers, and every field of an answer is in it.
#[test]
fn the_openapi_document_is_true() {
    let files = Files::new();
    let server = Running::start(files.options());
    let document = server.get("/v1/openapi.json", "").json();
    assert!(document["openapi"].as_str().is_some_and(|v| v.starts_with("3.1")), "{}", document["openapi"]);
    let paths = document["paths"].as_object().expect("paths");
    assert_eq!(paths.len(), 7);
    for (path, methods) in paths {
        for method in methods.as_object().expect("methods").keys() {
            let path = path.replace("{name}", "place");
            let request = match method.as_str() {
                "get" => Request::get(&path),
                "post" => Request::localize(&files.place.sealed(&truth())),
                other => panic!("{other} is not used here"),
            };
            assert_eq!(request.token(OPERATOR).send(server.address).status, 200, "{method} {path}");
        }
    }
    let schemas = &document["components"]["schemas"];
    let answer = server.localize(&files.place.sealed(&truth()), PHONE).json();
    let described = schemas["AnswerDocument"]["properties"].as_object().expect("fields");
    let told = answer.as_object().expect("fields");
    assert!(described.keys().eq(told.keys()), "{described:?} {told:?}");
}
