//! Successful requests.

use super::{common, geopose};

use common::http::Request;
use common::{Files, OPERATOR, PHONE, Running, eventually, truth};
use veiloc_geometry::{CameraFromRig, CameraFromWorld};
use veiloc_localization::{LocalizeOptions, localize};
use veiloc_map::{GravityDirection, MapFile, MapModel};
use veiloc_protocol::{Answer, AnswerDocument, Pack, Profile, RigMessage, SealedFrame, SealedQuery};

#[test]
fn answer_equals_library_result() {
    let files = Files::new();
    let server = Running::start(files.options());
    let query = files.scene.sealed(&truth());
    let map = MapFile::open(&files.path("place.vmap")).expect("a map");
    let sealed = SealedQuery::decode(&query).expect("own bytes");
    let expected = localize(&sealed, &map, &LocalizeOptions::default()).expect("localized");

    let response = Request::localize(&query)
        .token(PHONE)
        .header("accept", "application/x-protobuf")
        .send(server.address);
    assert_eq!((response.status, response.header("content-type")), (200, Some("application/x-protobuf")));
    let answer = Answer::decode(&response.body).expect("an answer");
    let response = answer.pose.expect("a pose");
    let pose = CameraFromWorld::from_quaternion(response.rotation, response.translation).expect("a pose");
    assert!(pose.translation_error(&truth()) < 0.03 && pose.rotation_error_degrees(&truth()) < 0.5);
    assert_eq!(response.rotation, expected.cam_from_world.quaternion());
    assert_eq!(response.covariance, expected.covariance);
    assert_eq!((answer.inliers as usize, answer.matches as usize), (expected.inliers, expected.matches));
    assert_eq!((answer.trusted(), answer.doubts.len()), (true, 0));
    let center = pose.center().coords;
    assert!((0..3).all(|i| (center[i] - response.center()[i]).abs() < 1e-9));

    let center_covariance = response.center_covariance();
    // The covariance of the centre, propagated from that of the pose by finite differences.
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
                .map(|ij| jacobian[ij / 6][a] * response.covariance[ij / 6][ij % 6] * jacobian[ij % 6][b])
                .sum();
            let got = center_covariance[a][b];
            let scale = center_covariance[a][a].max(center_covariance[b][b]);
            assert!((got - expected).abs() < 1e-3 * scale, "[{a}][{b}] {got} {expected}");
        }
    }

    // The standard deviation of the position is the same in every form.
    assert!((response.position_sd() / expected.confidence.center_sd - 1.0).abs() < 1e-9);

    // The answer has the fit, and JSON has the same content except for the times.
    let fit = answer.fit.expect("a fit");
    assert_eq!((fit.noise_px, fit.focal_scale), (expected.noise_px, expected.focal_scale));
    assert_eq!(fit.principal_shift_px, expected.principal_shift_px);
    let response = server.localize(&query, PHONE);
    assert_eq!((response.status, response.header("content-type")), (200, Some("application/json")));
    let mut response = response.json();
    assert_eq!(response["state"], "trusted");
    // Parsed like the other document: the JSON parser of the tests does not keep the last digit of every number.
    let same = serde_json::to_string(&AnswerDocument::new(&answer)).expect("JSON");
    let mut same: serde_json::Value = serde_json::from_str(&same).expect("JSON");
    for document in [&mut response, &mut same] {
        let times = document["ms"].take();
        let names: Vec<&str> = times.as_object().expect("times").keys().map(String::as_str).collect();
        assert_eq!(names, ["match", "pose", "queue", "retrieve"]);
    }
    assert_eq!(response, same);
}

/// A doubtful pose is sent with its doubts, and withheld if the client wants trusted poses only, in every format.
#[test]
fn doubtful_poses_are_withheld_on_request() {
    let files = Files::new();
    let server = Running::start(files.options());
    let (trusted, doubtful) = (files.scene.sealed(&truth()), files.scene.sealed_with_doubts());
    let ask = |query: &[u8], accept: &str, only: &str| {
        let request = Request::localize(query).token(PHONE).header("accept", accept);
        request.header("veiloc-trusted-only", only).send(server.address)
    };
    for (only, has_pose) in [("false", true), ("true", false)] {
        let response = ask(&doubtful, "application/json", only);
        assert_eq!(response.status, 200);
        let response = response.json();
        assert_eq!(response["state"], "doubtful");
        assert!(response["doubts"].as_array().is_some_and(|doubts| !doubts.is_empty()), "{response}");
        for field in ["cam_from_world", "center", "covariance", "center_covariance", "position_sd"] {
            assert_eq!(response.get(field).is_some(), has_pose, "{field}: {response}");
        }
        let response = ask(&doubtful, "application/x-protobuf", only);
        let response = Answer::decode(&response.body).expect("an answer");
        assert_eq!(
            (response.pose.is_some(), response.trusted(), response.doubts.is_empty()),
            (has_pose, false, false)
        );
        // Trusted poses are sent in both cases.
        assert!(ask(&trusted, "application/json", only).json()["center"].is_array());
    }
    let response = server.get("/metrics", OPERATOR).text();
    assert!(response.contains("outcome=\"doubtful\"} 4"), "counted even if withheld: {response}");
    assert_eq!(ask(&trusted, "application/json", "please").problem(), "bad-option");
}

/// A query without a pose is refused, with the third state.
#[test]
fn not_localized_query_has_state_not_found() {
    let files = Files::new();
    let server = Running::start(files.open_options());
    let response = server.localize(&files.scene.sealed_without_features(), "");
    assert_eq!((response.status, response.problem()), (422, "not-localized".to_owned()));
    assert_eq!(response.json()["state"], "not-found");
    assert!(server.localize(b"", "").json().get("state").is_none(), "the query was not decoded");
}

/// A position prior of the client reaches the estimator unchanged.
#[test]
fn position_prior_is_applied_to_one_request() {
    let files = Files::new();
    let server = Running::start(files.open_options());
    let query = files.scene.sealed(&truth());
    let map = MapFile::open(&files.path("place.vmap")).expect("a map");
    let sealed = SealedQuery::decode(&query).expect("own bytes");
    let center = truth().center();
    let mut options = LocalizeOptions::default();
    options.position = Some(veiloc_pose::PositionPrior { center, sd: 0.5 });
    let expected = localize(&sealed, &map, &options).expect("localized");
    let near = format!("{},{},{},0.5", center.coords.x, center.coords.y, center.coords.z);
    let response = Request::localize(&query)
        .header("accept", "application/x-protobuf")
        .header("veiloc-near", &near)
        .send(server.address);
    let response = Answer::decode(&response.body).expect("an answer").pose.expect("a pose");
    assert_eq!(response.rotation, expected.cam_from_world.quaternion());
    assert_eq!(response.covariance, expected.covariance);
    for bad in ["1,2,3", "1,2,3,0", "NaN,2,3,1", "here"] {
        let refused = Request::localize(&query).header("veiloc-near", bad).send(server.address);
        assert_eq!((refused.status, refused.problem()), (400, "bad-option".to_owned()), "{bad}");
    }
}

#[test]
fn profile_etag_allows_revalidation() {
    let files = Files::new();
    let server = Running::start(files.options());
    let first = server.get("/v1/maps/place/profile", PHONE);
    assert_eq!(first.status, 200);
    let profile = Profile::decode(&first.body).expect("a profile");
    assert_eq!(profile, files.scene.profile);
    let etag = first.header("etag").expect("an ETag").to_owned();
    assert!(etag.trim_matches('"').starts_with(&profile.id().to_string()), "begins with the profile id");

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

/// An app sees the unit of a map before it asks for a pose, and with each: the metre, or none that is known.
#[test]
fn maps_and_answers_state_unit_and_down() {
    let files = Files::new();
    let mut options = files.open_options();
    let mut metric = options.maps[0].clone();
    (metric.name, metric.path) = ("metric".to_owned(), metric.path.with_file_name("metric.vmap"));
    let down = GravityDirection::new([0.0, 1.0, 0.0]).ok();
    let model = MapModel { is_metric: true, down, ..files.scene.map(6) };
    veiloc_map::write(&model, &metric.path).expect("written");
    options.maps.push(metric);
    let server = Running::start(options);
    let list = server.get("/v1/maps", PHONE).json();
    let query = files.scene.sealed(&truth());
    for (at, (name, unit, down)) in [
        ("place", serde_json::Value::Null, serde_json::Value::Null),
        ("metric", 1.0.into(), serde_json::json!([0.0, 1.0, 0.0])),
    ]
    .into_iter()
    .enumerate()
    {
        let entry = &list["maps"][at];
        assert_eq!((&entry["name"], &entry["metres_per_unit"], &entry["down"]), (&name.into(), &unit, &down));
        // Its answers say the same.
        let request = Request::post(&format!("/v1/maps/{name}/localize"), &query);
        let answer = request.header("content-type", "application/x-protobuf").send(server.address).json();
        assert_eq!((&answer["metres_per_unit"], &answer["down"]), (&unit, &down), "{answer}");
        assert_eq!(answer["sd_includes"], "map");
    }
}

#[test]
fn map_is_served_under_several_names() {
    let files = Files::new();
    let mut options = files.open_options();
    let mut second = options.maps[0].clone();
    second.name = "second".to_owned();
    options.maps.push(second);
    let server = Running::start(options);
    let query = files.scene.sealed(&truth());
    let center = server.localize(&query, "").json()["center"].clone();
    for name in ["place", "second"] {
        let request = Request::post(&format!("/v1/maps/{name}/localize"), &query)
            .header("content-type", "application/octet-stream; x=y");
        let response = request.send(server.address);
        assert_eq!((response.status, &response.json()["center"]), (200, &center));
    }
}

/// Several requests on one connection.
#[test]
fn connection_is_reused() {
    let files = Files::new();
    let server = Running::start(files.open_options());
    let request = Request::localize(&files.scene.sealed(&truth())).bytes();
    let mut stream = common::http::connect(server.address);
    for _ in 0..3 {
        std::io::Write::write_all(&mut stream, &request).expect("written");
        assert_eq!(common::http::Response::read(&mut stream).status, 200);
    }
}

#[test]
fn metrics_and_probes_for_operators() {
    let files = Files::new();
    let server = Running::start(files.options());
    assert_eq!((server.get("/healthz", "").status, server.get("/readyz", "").status), (200, 200));
    let query = files.scene.sealed(&truth());
    assert_eq!(server.localize(&query, PHONE).status, 200);
    assert_eq!(server.localize(&query, "wrong").status, 401);

    assert_eq!(server.get("/metrics", PHONE).problem(), "forbidden");
    assert_eq!(server.get("/metrics", "").problem(), "unauthenticated");
    // A worker becomes free a moment after its response was sent.
    let mut text = String::new();
    eventually("a free worker", || {
        text = server.get("/metrics", OPERATOR).text();
        text.contains("veiloc_workers_busy 0")
    });
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

/// A session of one image, whose camera is the rig.
fn session_of_one(files: &Files) -> Vec<u8> {
    let query = SealedQuery::decode(&files.scene.sealed(&truth())).expect("own bytes");
    let frame = SealedFrame {
        query,
        cam_from_rig: CameraFromRig::identity(),
        rotation_sd_deg: 0.0,
        translation_sd: 0.0,
    };
    RigMessage { frames: vec![frame] }.encode()
}

/// Every address of the document answers, and every field of an answer is documented.
#[test]
fn openapi_document_matches_the_service() {
    let files = Files::new();
    let server = geopose::start(&files);
    let document = server.get("/v1/openapi.json", "").json();
    assert!(document["openapi"].as_str().is_some_and(|v| v.starts_with("3.1")), "{}", document["openapi"]);
    let paths = document["paths"].as_object().expect("paths");
    assert_eq!(paths.len(), 14);
    for (path, methods) in paths {
        for method in methods.as_object().expect("methods").keys() {
            // Regions, anchors and packs have tests of their own.
            if path.contains("/regions/") || path.contains("/anchors") || path.ends_with("/pack") {
                continue;
            }
            let path = path.replace("{name}", "place");
            let request = match method.as_str() {
                "get" => Request::get(&path),
                "post" if path.ends_with("-rig") => Request::post(&path, &session_of_one(&files))
                    .header("content-type", "application/octet-stream"),
                "post" if path == "/geopose" => {
                    let request = geopose::request(&files.scene.sealed(&truth())).to_string();
                    Request::post(&path, request.as_bytes()).header("content-type", "application/json")
                }
                "post" => Request::localize(&files.scene.sealed(&truth())),
                other => panic!("{other} is not used here"),
            };
            assert_eq!(request.token(OPERATOR).send(server.address).status, 200, "{method} {path}");
        }
    }
    let schemas = &document["components"]["schemas"];
    let answer = server.localize(&files.scene.sealed(&truth()), PHONE).json();
    let described = schemas["AnswerDocument"]["properties"].as_object().expect("fields");
    let mut response: Vec<&str> = answer.as_object().expect("fields").keys().map(String::as_str).collect();
    // The query has no gravity.
    response.push("gravity");
    response.sort_unstable();
    assert!(described.keys().eq(&response), "{described:?} {response:?}");
    let headers = &document["paths"]["/v1/maps/{name}/localize"]["post"]["parameters"];
    let names: Vec<&str> =
        headers.as_array().expect("a list").iter().filter_map(|p| p["name"].as_str()).collect();
    assert_eq!(names, ["name", "veiloc-trusted-only", "veiloc-near"]);
}

/// Devices get the pack where the operator gives it, and the service answers their match queries.
#[test]
fn packs_are_given_where_the_operator_does() {
    let files = Files::new();
    let map = MapFile::open(&files.path("place.vmap")).expect("a map");
    let (pack, _) = map.pack().expect("it has points");
    let get =
        |server: &Running, token: &str| Request::get("/v1/maps/place/pack").token(token).send(server.address);
    let mut options = files.options();
    let without = Running::start(options.clone());
    let response = get(&without, PHONE);
    assert_eq!((response.status, response.problem()), (404, "no-pack".to_owned()));
    let listed = Request::get("/v1/maps").token(PHONE).send(without.address).json();
    assert!(listed["maps"][0]["pack_id"].is_null());

    options.packs = true;
    let server = Running::start(options);
    let response = get(&server, PHONE);
    assert_eq!((response.status, response.header("content-type")), (200, Some("application/x-protobuf")));
    let received = Pack::decode(&response.body).expect("a pack");
    assert_eq!(received, pack);
    let tag = response.header("etag").expect("a tag").to_owned();
    let again =
        Request::get("/v1/maps/place/pack").token(PHONE).header("if-none-match", &tag).send(server.address);
    assert_eq!((again.status, again.body.len()), (304, 0));
    let listed = Request::get("/v1/maps").token(PHONE).send(server.address).json();
    assert_eq!(listed["maps"][0]["pack_id"], pack.id().to_string());
    assert_eq!(Request::get("/v1/maps/place/pack").send(server.address).status, 401);

    let response = server.localize(&files.scene.matched(&truth(), received), PHONE);
    assert_eq!((response.status, &response.json()["state"]), (200, &"trusted".into()));
}
