//! What a client gets when all is well.

use super::common;

use common::http::Request;
use common::{Files, OPERATOR, PHONE, Running, eventually, truth};
use veiloc_geometry::{CameraFromRig, CameraFromWorld};
use veiloc_localization::{LocalizeOptions, localize};
use veiloc_map::MapFile;
use veiloc_protocol::{Answer, AnswerDocument, Profile, RigMessage, SealedFrame, SealedQuery};

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
    let told = answer.pose.expect("a pose");
    let pose = CameraFromWorld::from_quaternion(told.rotation, told.translation).expect("a pose");
    assert!(pose.translation_error(&truth()) < 0.03 && pose.rotation_error_degrees(&truth()) < 0.5);
    assert_eq!(told.rotation, expected.cam_from_world.quaternion());
    assert_eq!(told.covariance, expected.covariance);
    assert_eq!((answer.inliers as usize, answer.matches as usize), (expected.inliers, expected.matches));
    assert_eq!((answer.trusted, answer.doubts.len()), (true, 0));
    let center = pose.center().coords;
    assert!((0..3).all(|i| (center[i] - told.center[i]).abs() < 1e-9));

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
                .map(|ij| jacobian[ij / 6][a] * told.covariance[ij / 6][ij % 6] * jacobian[ij % 6][b])
                .sum();
            let got = told.center_covariance[a][b];
            let scale = told.center_covariance[a][a].max(told.center_covariance[b][b]);
            assert!((got - expected).abs() < 1e-3 * scale, "[{a}][{b}] {got} {expected}");
        }
    }

    // The ± is one number, however it is asked for.
    assert!((told.position_sd() / expected.confidence.center_sd - 1.0).abs() < 1e-9);

    // It says how well the query fits, and JSON tells the same, but for the times.
    let fit = answer.fit.expect("it is told");
    assert_eq!((fit.noise_px, fit.focal_scale), (expected.noise_px, expected.focal_scale));
    let response = server.localize(&query, PHONE);
    assert_eq!((response.status, response.header("content-type")), (200, Some("application/json")));
    let mut told = response.json();
    assert_eq!(told["state"], "trusted");
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

/// A doubtful pose is told with its doubts, and withheld from who asked for trusted ones only, in every form.
#[test]
fn doubtful_poses_are_withheld_when_asked() {
    let files = Files::new();
    let server = Running::start(files.options());
    let (trusted, doubtful) = (files.place.sealed(&truth()), files.place.sealed_doubtfully());
    let ask = |query: &[u8], accept: &str, only: &str| {
        let request = Request::localize(query).token(PHONE).header("accept", accept);
        request.header("veiloc-trusted-only", only).send(server.address)
    };
    for (only, has_pose) in [("false", true), ("true", false)] {
        let told = ask(&doubtful, "application/json", only);
        assert_eq!(told.status, 200);
        let told = told.json();
        assert_eq!((&told["state"], &told["trusted"]), (&"doubtful".into(), &false.into()));
        assert!(told["doubts"].as_array().is_some_and(|doubts| !doubts.is_empty()), "{told}");
        for field in ["cam_from_world", "center", "covariance", "center_covariance", "position_sd"] {
            assert_eq!(told.get(field).is_some(), has_pose, "{field}: {told}");
        }
        let told = ask(&doubtful, "application/x-protobuf", only);
        let told = Answer::decode(&told.body).expect("an answer");
        assert_eq!((told.pose.is_some(), told.trusted, told.doubts.is_empty()), (has_pose, false, false));
        // Trusted ones are told in any case.
        assert!(ask(&trusted, "application/json", only).json()["center"].is_array());
    }
    let told = server.get("/metrics", OPERATOR).text();
    assert!(told.contains("outcome=\"doubtful\"} 4"), "withheld or not: {told}");
    assert_eq!(ask(&trusted, "application/json", "please").problem(), "bad-option");
}

/// A query for which there is no pose is refused, and the refusal has the third state.
#[test]
fn what_is_not_found_says_so() {
    let files = Files::new();
    let server = Running::start(files.open_options());
    let response = server.localize(&files.place.sealed_without_features(), "");
    assert_eq!((response.status, response.problem()), (422, "not-localized".to_owned()));
    assert_eq!(response.json()["state"], "not-found");
    assert!(server.localize(b"", "").json().get("state").is_none(), "nothing was looked for");
}

/// A place that the caller names reaches the estimator as it is.
#[test]
fn a_place_nearby_goes_along_with_one_request() {
    let files = Files::new();
    let server = Running::start(files.open_options());
    let query = files.place.sealed(&truth());
    let map = MapFile::open(&files.path("place.vmap")).expect("a map");
    let sealed = SealedQuery::decode(&query).expect("own bytes");
    let center = truth().center();
    let mut options = LocalizeOptions::default();
    options.position = Some(veiloc_pose::PositionPrior { center, sd: 0.5 });
    let expected = localize(&sealed, &map, &options).expect("localized");
    let near = format!("{},{},{},0.5", center.coords.x, center.coords.y, center.coords.z);
    let told = Request::localize(&query)
        .header("accept", "application/x-protobuf")
        .header("veiloc-near", &near)
        .send(server.address);
    let told = Answer::decode(&told.body).expect("an answer").pose.expect("a pose");
    assert_eq!(told.rotation, expected.cam_from_world.quaternion());
    assert_eq!(told.covariance, expected.covariance);
    for bad in ["1,2,3", "1,2,3,0", "NaN,2,3,1", "here"] {
        let refused = Request::localize(&query).header("veiloc-near", bad).send(server.address);
        assert_eq!((refused.status, refused.problem()), (400, "bad-option".to_owned()), "{bad}");
    }
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
    // A worker is done a moment after its reply has left.
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

/// A session of one image, which is the rig.
fn session_of_one(files: &Files) -> Vec<u8> {
    let query = SealedQuery::decode(&files.place.sealed(&truth())).expect("own bytes");
    let frame = SealedFrame {
        query,
        cam_from_rig: CameraFromRig::identity(),
        rotation_sd_deg: 0.0,
        translation_sd: 0.0,
    };
    RigMessage { frames: vec![frame] }.encode()
}

/// Every address of the document answers, and every field of an answer is in it.
#[test]
fn the_openapi_document_is_true() {
    let files = Files::new();
    let server = Running::start(files.options());
    let document = server.get("/v1/openapi.json", "").json();
    assert!(document["openapi"].as_str().is_some_and(|v| v.starts_with("3.1")), "{}", document["openapi"]);
    let paths = document["paths"].as_object().expect("paths");
    assert_eq!(paths.len(), 8);
    for (path, methods) in paths {
        for method in methods.as_object().expect("methods").keys() {
            let path = path.replace("{name}", "place");
            let request = match method.as_str() {
                "get" => Request::get(&path),
                "post" if path.ends_with("-rig") => Request::post(&path, &session_of_one(&files))
                    .header("content-type", "application/octet-stream"),
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
    let headers = &document["paths"]["/v1/maps/{name}/localize"]["post"]["parameters"];
    let names: Vec<&str> =
        headers.as_array().expect("a list").iter().filter_map(|p| p["name"].as_str()).collect();
    assert_eq!(names, ["name", "veiloc-trusted-only", "veiloc-near"]);
}
