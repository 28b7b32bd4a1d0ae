//! `veiloc serve` and `veiloc query send` as two processes, with the errors between them.
#![cfg(unix)]

use super::common;
#[path = "../../../server/service/tests/it/common/http.rs"]
mod http;

use std::fs;
use std::io::{BufRead as _, BufReader, Lines, Read, Write};
use std::net::{SocketAddr, TcpListener};
use std::os::unix::net::UnixStream;
use std::process::{Child, ChildStderr, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use common::{CAMERA, POSITION_TOLERANCE, TestScene, pose, scene};
use veiloc_geometry::CameraFromWorld;

/// `veiloc serve` on a free port, killed when dropped.
struct Service {
    child: Child,
    url: String,
    address: SocketAddr,
    log: Arc<Mutex<String>>,
    reader: Option<std::thread::JoinHandle<()>>,
}

impl Service {
    fn start(scene: &TestScene, arguments: &str) -> Self {
        let (mut service, lines) = Self::start_unread(scene, arguments);
        let kept = service.log.clone();
        service.reader = Some(std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                let mut log = kept.lock().expect("not poisoned");
                *log = format!("{log}{line}\n");
            }
        }));
        service
    }

    /// The log is read up to the line with the address, and no further; it has the lines before it.
    fn start_unread(scene: &TestScene, arguments: &str) -> (Self, Lines<BufReader<ChildStderr>>) {
        let mut child = scene
            .command(&format!("serve --listen 127.0.0.1:0 --drain-delay 0 --answer-quantum 0 --unauthenticated-max-age 3600 --connection-max-age 3600 {arguments}"))
            .spawn()
            .expect("the binary runs");
        let mut lines = BufReader::new(child.stderr.take().expect("piped")).lines();
        let mut message = String::new();
        let url = loop {
            let Some(Ok(line)) = lines.next() else { panic!("the service did not start: {message}") };
            if let Some((_, url)) = line.split_once(" on http").filter(|_| line.starts_with("serving ")) {
                break format!("http{url}");
            }
            message = message + &line + "\n";
        };
        let address = url.split("//").nth(1).and_then(|a| a.parse().ok()).expect("an address");
        (Self { child, url, address, log: Arc::new(message.into()), reader: None }, lines)
    }

    fn log(&self) -> String {
        self.log.lock().expect("not poisoned").clone()
    }

    /// The log, once it has this many lines with `what`: a line may be written after its answer was sent.
    fn log_with(&self, what: &str, count: usize) -> String {
        loop {
            let log = self.log();
            if log.lines().filter(|line| line.contains(what)).count() >= count {
                return log;
            }
            std::thread::yield_now();
        }
    }

    fn signal(&self, name: &str) {
        let status =
            Command::new("kill").args([name, &self.child.id().to_string()]).status().expect("kill runs");
        assert!(status.success(), "{name}");
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// What the documentation does not say of a trusted answer, which has no doubts.
fn mistakes(fields: &common::documented::Fields, document: &serde_json::Value) -> Vec<String> {
    let mut mistakes = common::documented::mistakes(fields, std::slice::from_ref(document));
    mistakes.retain(|mistake| mistake != "doubts never had an entry");
    mistakes
}

fn send(image: &str, url: &str) -> String {
    send_with_cache(image, url, "cache")
}

/// The same, with a profile cache in this folder.
fn send_with_cache(image: &str, url: &str, cache: &str) -> String {
    format!("query send images/{image} --camera {CAMERA} --map place --cache {cache} --server {url}")
}

/// The same query gives the same document, field by field: over HTTP, from the program, and through `query send`.
#[test]
fn one_answer_everywhere() {
    let scene = scene();
    let service = Service::start(scene, "--map place=place.vmap");
    let sealed = scene.run(&format!(
        "seal images/query-0.png --camera {CAMERA} --profile place.vprofile -o one-answer.vquery"
    ));
    sealed.succeeded();
    let bytes = fs::read(scene.path("one-answer.vquery")).expect("it was sealed");
    let over_http = http::Request::post("/v1/maps/place/localize", &bytes)
        .header("content-type", "application/x-protobuf")
        .send(service.address);
    let run = scene.run("localize --map place.vmap one-answer.vquery --json").succeeded();
    let rig = r#"{"frames": [{"query": "one-answer.vquery", "cam_from_rig": {"q": [1, 0, 0, 0], "t": [0, 0, 0]}, "rotation_sd_deg": 0, "translation_sd": 0}]}"#;
    scene.write("one-answer.json", rig);
    let sent =
        format!("query send --rig one-answer.json --map place --server {} --cache own --json", service.url);
    let rigs = [
        scene.run("localize --map place.vmap --rig one-answer.json --json").succeeded().json(),
        scene.run(&sent).succeeded().json(),
    ];
    // Without what the program adds, and times.
    let document = |mut document: serde_json::Value| {
        for own in ["file", "map", "rig", "frames", "ms"] {
            document.as_object_mut().expect("an object").remove(own);
        }
        document
    };
    let [over_http, local] = [over_http.json(), run.json()["queries"][0].clone()].map(document);
    assert_eq!(over_http, local);
    let [local, sent] = rigs.map(document);
    assert_eq!(local, sent);
    assert_eq!(
        local.as_object().map(|d| d.keys().cloned().collect::<Vec<_>>()),
        over_http.as_object().map(|d| d.keys().cloned().collect())
    );
}

/// With the pack of the service, a query has no descriptor; without one it says what to ask for.
#[test]
fn matches_are_sent_with_the_pack_of_the_service() {
    let scene = scene();
    let service = Service::start(scene, "--map place=place.vmap --packs");
    let send = send_with_cache("query-0.png", &service.url, "packs");
    let run = scene.run(&format!("{send} --send matches --json")).succeeded();
    let found = pose(&run.json()["cam_from_world"]);
    assert!(found.translation_error(&scene.pose_of("query-0.png")) < POSITION_TOLERANCE, "{run}");
    assert_eq!(run.json()["state"], "trusted");
    // The pack was sent once, and then confirmed.
    scene.run(&format!("{send} --send explained")).succeeded();
    let log = service.log_with("/pack", 2);
    let fetched = |status: u16| {
        log.lines().filter(|l| l.contains("/pack") && l.contains(&format!("status={status}"))).count()
    };
    assert_eq!((fetched(200), fetched(304)), (1, 1), "{log}");
    let other = "00112233445566778899aabbccddeeff";
    scene.run(&format!("{send} --send matches --pack-id {other}")).refused(&[other, "operator"]);
    let without = Service::start(scene, "--map place=place.vmap");
    let refused =
        scene.run(&format!("{} --send matches", send_with_cache("query-0.png", &without.url, "no-packs")));
    refused.refused(&["no pack of this map"]);
}

#[test]
fn image_is_localized() {
    let scene = scene();
    let service = Service::start(scene, "--map place=place.vmap");
    for i in 0..common::QUERIES {
        let image = format!("query-{i}.png");
        let run = scene.run(&format!("{} --json", send_with_cache(&image, &service.url, "own"))).succeeded();
        let truth = scene.pose_of(&image);
        let found = pose(&run.json()["cam_from_world"]);
        assert!(found.translation_error(&truth) < POSITION_TOLERANCE, "{run}");
        assert!(found.rotation_error_degrees(&truth) < 1.0, "{run}");
        assert_eq!(run.json()["state"], "trusted");
        let fields = &common::documented::tables()["query send"];
        assert_eq!(mistakes(fields, &run.json()), [""; 0]);
        assert!(run.stderr.contains("sent as dcl"), "{run}");
    }
    let text = scene.run(&send_with_cache("query-0.png", &service.url, "own")).succeeded();
    assert!(text.stdout.starts_with("trusted  at (") && text.stdout.contains("matches agree"), "{text}");
    // The profile was sent once, and then confirmed.
    let log = service.log_with("/profile", 1 + common::QUERIES);
    let fetched = |status: &str| {
        log.lines().filter(|l| l.contains("/profile") && l.contains(&format!("status={status}"))).count()
    };
    assert_eq!((fetched("200"), fetched("304")), (1, common::QUERIES), "{log}");
    // A damaged profile in the cache is fetched again.
    let kept = fs::read_dir(scene.path("own/profiles")).expect("the cache").next().expect("a profile");
    let kept = kept.expect("an entry").path();
    fs::write(&kept, b"damaged").expect("written");
    scene.run(&send_with_cache("query-0.png", &service.url, "own")).succeeded();
    assert!(fs::read(&kept).expect("kept") == scene.read("place.vprofile"), "whole again");
}

/// A rendered room needs few rows; an unreachable accuracy needs all.
#[test]
fn progressive_query_stops_at_trusted_pose() {
    let scene = scene();
    let service = Service::start(scene, "--map place=place.vmap");
    let sent = |more: &str| {
        let run = scene
            .run(&format!(
                "{} --progressive {more} --json",
                send_with_cache("query-0.png", &service.url, "steps")
            ))
            .succeeded();
        // With half of the rows the error may be larger.
        let error = scene.position_error("query-0.png", &pose(&run.json()["cam_from_world"]));
        assert!(error < 2.0 * POSITION_TOLERANCE, "{run}");
        let fields = &common::documented::tables()["query send"];
        assert_eq!(mistakes(fields, &run.json()), [""; 0]);
        assert!(run.stderr.contains("sealed as dcl") && run.stderr.contains(" rows in "), "{run}");
        let steps = run.json()["steps"].as_array().expect("steps").clone();
        steps.iter().map(|step| step["rows"].as_u64().expect("a count")).collect::<Vec<_>>()
    };
    let first = sent("");
    assert_eq!(first, [256], "a trusted pose ends it");
    assert_eq!(sent("--accuracy 1e-9"), [256, 512]);
    // One request per step.
    let log = service.log_with("/localize", first.len() + 2);
    assert_eq!(log.lines().filter(|line| line.contains("/localize")).count(), first.len() + 2, "{log}");
    for (more, part) in [
        ("--progressive --accuracy 0", "above 0"),
        ("--progressive --accuracy nan", "above 0"),
        ("--accuracy 0.1", "--progressive"),
    ] {
        let run = scene.run(&format!("{} {more}", send("query-0.png", &service.url)));
        assert!(run.code == Some(2) && run.stderr.contains(part), "{run}");
    }
}

/// Sealed queries of a session, sent unchanged.
#[test]
fn a_session_gets_one_pose() {
    let scene = scene();
    scene.write("session/none", "");
    // The third has turned so far that two halves coincide for it.
    let striped = "dcl:axis=115:sectors=20:anchors=0.23/-0.33+-0.88/-0.47";
    let seal = |image: &str, words: &str, out: &str| {
        let seal =
            format!("seal images/{image} --camera {CAMERA} --profile place.vprofile --scheme {striped}");
        scene.run(&format!("{seal} {words} -o {out}")).succeeded();
    };
    let first = scene.pose_of("query-0.png");
    let frame = |k: usize| {
        let image = format!("query-{k}.png");
        let [w, x, y, z] = scene.pose_of(&image).quaternion();
        let words = format!("--session session/sent.session --orientation={w},{x},{y},{z}");
        seal(&image, &words, &format!("session/{k}.vquery"));
        seal(&image, "", &format!("session/alone-{k}.vquery"));
        let relative = scene.pose_of(&image).compose(&first.inverse());
        let t = relative.translation();
        let q = CameraFromWorld::new(*relative.rotation(), *t).quaternion();
        let sd = if k == 0 { 0.0 } else { 0.01 };
        serde_json::json!({
            "query": format!("{k}.vquery"), "cam_from_rig": {"q": q, "t": [t.x, t.y, t.z]},
            "rotation_sd_deg": 10.0 * sd, "translation_sd": sd,
        })
    };
    let frames: Vec<_> = (0..common::QUERIES).map(frame).collect();
    scene.write("session/sent.json", serde_json::json!({"frames": frames}).to_string());
    let service = Service::start(scene, "--map place=place.vmap");
    let command = format!("query send --rig session/sent.json --map place --server {}", service.url);
    let run = scene.run(&format!("{command} --json")).succeeded();
    let found = pose(&run.json()["cam_from_world"]);
    assert!(found.translation_error(&first) < POSITION_TOLERANCE, "{run}");
    assert_eq!(run.json()["state"], "trusted");
    let fields = &common::documented::tables()["query send"];
    assert_eq!(mistakes(fields, &run.json()), [""; 0]);
    let text = scene.run(&command).succeeded();
    assert!(text.stdout.starts_with("trusted  at (") && text.stderr.contains("sealed queries"), "{text}");
    assert!(!service.log().contains("/profile"), "nothing was sealed: {}", service.log());
    // Frames that were sealed alone are not sent, unless they say that they are of one session.
    let sent = fs::read_to_string(scene.path("session/sent.json")).expect("written");
    let alone = sent.replace("\"0.vquery", "\"alone-0.vquery").replace("\"1.vquery", "\"alone-1.vquery");
    scene.write("session/alone.json", &alone);
    let run = scene.run(&command.replace("sent.json", "alone.json"));
    assert!(run.code == Some(1) && run.stderr.contains("frames 0 and 1 of the rig"), "{run}");
    assert!(run.stderr.contains("--session FILE") && run.stderr.contains("--rig-cameras"), "{run}");
    scene.run("localize --map place.vmap --rig session/alone.json").succeeded();
    let named = alone.replace("\"query\"", "\"session\": \"0123456789abcdef\", \"query\"");
    scene.write("session/alone.json", named);
    scene.run(&command.replace("sent.json", "alone.json")).succeeded();
    let log = service.log_with("/localize", 3);
    assert_eq!(
        log.lines().filter(|line| line.contains("/localize")).count(),
        3,
        "those that were refused were not sent: {log}"
    );
    scene.write("session/alone.json", alone.replace("\"query\"", "\"session\": \"mine\", \"query\""));
    let run = scene.run(&command.replace("sent.json", "alone.json"));
    assert!(run.code == Some(1) && run.stderr.contains("16 hexadecimal digits"), "{run}");
    // Options of sealing are refused.
    for (more, word) in
        [("--scheme points", "--scheme"), ("images/query-0.png", "IMAGE"), ("--progressive", "--progressive")]
    {
        let run = scene.run(&format!("{command} {more}"));
        assert!(run.code == Some(2) && run.stderr.contains(word), "{run}");
    }
    let run = scene.run(&format!("query send --rig session/gone.json --map place --server {}", service.url));
    assert!(run.code == Some(1) && run.stderr.contains("gone.json"), "{run}");
}

#[test]
fn tls_and_tokens() {
    let scene = scene();
    let data = concat!(env!("CARGO_MANIFEST_DIR"), "/../server/service/tests/data");
    // SHA-256 of `phone-token`, by openssl.
    let hash = Command::new("sh").args(["-c", "printf %s phone-token | sha256sum | cut -d' ' -f1"]).output();
    scene.write(
        "tokens",
        format!("phone {}", String::from_utf8(hash.expect("sh runs").stdout).expect("text")),
    );
    scene.write("token", "phone-token\n");
    let service = Service::start(
        scene,
        &format!("--map place=place.vmap --tokens tokens --cert {data}/cert.pem --key {data}/key.pem"),
    );
    assert!(service.url.starts_with("https://"), "{}", service.url);
    let url = format!("https://localhost:{}", service.address.port());
    let with = |more: &str| scene.run(&format!("{} --retries 0 {more}", send("query-0.png", &url)));
    with(&format!("--ca {data}/cert.pem --token-file token")).succeeded();
    for (more, part) in [
        (format!("--ca {data}/cert.pem"), "--token-file"),
        (format!("--ca {data}/cert.pem --token wrong"), "No valid token"),
        ("--token-file token".to_owned(), "--ca"),
        (format!("--ca {data}/key.pem --token-file token"), "holds no certificate"),
        (format!("--ca {data}/cert.pem --token-file none"), "none"),
    ] {
        let run = with(&more);
        assert!(run.code == Some(1) && run.stderr.contains(part), "{part}: {run}");
        assert!(!run.stderr.contains("phone-token"), "{run}");
    }
    assert!(!service.log().contains("phone-token"));
    let url = format!("http://localhost:{}", service.address.port());
    let run = scene.run(&format!("{} --retries 0", send("query-0.png", &url)));
    assert!(run.code == Some(1) && run.stderr.contains("use https://"), "{run}");
    let run = scene.run(&format!("serve --map place=place.vmap --listen {}", service.address));
    assert!(run.code == Some(1) && run.stderr.contains("choose another address"), "{run}");
    assert!(!run.stderr.contains("help"), "the message has its remedy: {run}");
    // A service without TLS at an address that asks for it.
    let plain = Service::start(scene, "--map place=place.vmap");
    let url = format!("https://localhost:{}", plain.address.port());
    let run = scene.run(&format!("{} --retries 0", send("query-0.png", &url)));
    assert!(run.code == Some(1) && run.stderr.contains("answers plain HTTP on this port"), "{run}");
    // The certificate that `openssl req -x509` makes without further options; the remedy is the operator's.
    let service = Service::start(
        scene,
        &format!(
            "--map place=place.vmap --tokens tokens --cert {data}/authority-cert.pem --key {data}/key.pem"
        ),
    );
    let url = format!("https://localhost:{}", service.address.port());
    let given = format!("--retries 0 --ca {data}/authority-cert.pem --token-file token");
    let run = scene.run(&format!("{} {given}", send("query-0.png", &url)));
    assert!(run.code == Some(1) && run.stderr.contains("CA:FALSE"), "{run}");
}

#[test]
fn unsafe_configurations_are_refused() {
    let scene = scene();
    scene.write("broken.vmap", &scene.read("place.vmap")[..5000]);
    for (arguments, code, part) in [
        ("serve --map place=none.vmap", 1, "none.vmap"),
        ("serve --map place=broken.vmap", 1, "broken.vmap"),
        ("serve --map place.vmap", 2, "NAME=FILE"),
        ("serve --map a/b=place.vmap", 1, "cannot name a map"),
        ("serve --map a=place.vmap --map a=place.vmap", 1, "two maps"),
        ("serve --map a=place.vmap --listen 0.0.0.0:0", 1, "plain HTTP"),
        ("serve --map a=place.vmap --listen 0.0.0.0:0 --insecure-http", 1, "--allow-anonymous"),
        ("serve --map a=place.vmap --cert a.pem", 2, "--key"),
        ("serve --map a=place.vmap --cert place.txt --key place.txt", 1, "place.txt"),
        ("serve --map a=place.vmap --tokens map.txt", 1, "line 1"),
        ("serve --map a=place.vmap --queue 0", 2, "--queue"),
        ("query send images/query-0.png --camera PINHOLE,1,1,1,1,1,1 --map a --server place", 1, "https://"),
        (
            "query send images/query-0.png --camera PINHOLE,1,1,1,1,1,1 --map a --server http://example.org",
            1,
            "plain HTTP",
        ),
        (
            "query send images/query-0.png --camera PINHOLE,1,1,1,1,1,1 --map a/b --server http://localhost",
            1,
            "is not a map name",
        ),
    ] {
        let run = scene.run(arguments);
        assert!(run.code == Some(code) && run.stderr.contains(part), "{part}: {run}");
    }
    // No service at this address.
    let run = scene.run(&format!("{} --retries 1", send("query-0.png", "http://127.0.0.1:1")));
    assert!(run.code == Some(1) && run.stderr.contains("sending the same bytes again"), "{run}");
    assert!(run.stderr.contains("that the service runs"), "{run}");
}

/// The device detects the paper's degenerate case, and sends nothing.
#[test]
fn one_sided_image_is_not_sent() {
    let scene = scene();
    let service = Service::start(scene, "--map place=place.vmap");
    let mut image = image::open(scene.path("images/query-0.png")).expect("an image").to_rgb8();
    for (x, _, pixel) in image.enumerate_pixels_mut() {
        if x > 190 {
            *pixel = image::Rgb([127; 3]);
        }
    }
    image.save(scene.path("images/half.png")).expect("written");
    let run = scene.run(&format!("{} --scheme dcl:paper", send("half.png", &service.url)));
    assert!(run.code == Some(1) && run.stderr.contains("side of the dividing line"), "{run}");
    assert!(run.stderr.contains("turn"), "the message has a remedy: {run}");
    assert!(!service.log().contains("/localize"), "nothing was sent: {}", service.log());
}

/// L7: a busy service gets the same bytes again.
#[test]
fn retry_sends_identical_bytes() {
    let scene = scene();
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let url = format!("http://{}", listener.local_addr().expect("an address"));
    let profile = scene.read("place.vprofile");
    let server = std::thread::spawn(move || {
        let mut bodies: Vec<Vec<u8>> = Vec::new();
        let answers = ["503 Busy", "429 Slow down", "504 Late", "", "422 Not localized"];
        while bodies.len() < answers.len() {
            let (mut stream, _) = listener.accept().expect("a client");
            let mut reader = BufReader::new(stream.try_clone().expect("a clone"));
            let (mut length, mut line, mut posted) = (0, String::new(), false);
            while reader.read_line(&mut line).expect("a line") > 2 {
                let lower = line.to_ascii_lowercase();
                posted |= lower.starts_with("post ");
                if let Some(n) = lower.strip_prefix("content-length:") {
                    length = n.trim().parse().expect("a number");
                }
                line.clear();
            }
            let mut body = vec![0; length];
            Read::read_exact(&mut reader, &mut body).expect("a body");
            let (status, answer): (&str, &[u8]) = if posted {
                bodies.push(body);
                (answers[bodies.len() - 1], b"")
            } else {
                ("200 OK", &profile)
            };
            // One of the connections ends without an answer.
            if !status.is_empty() {
                let head = format!(
                    "HTTP/1.1 {status}\r\ncontent-type: application/x-protobuf\r\nretry-after: 0\r\nconnection: close\r\n\
                     content-length: {}\r\n\r\n",
                    answer.len()
                );
                stream.write_all(&[head.as_bytes(), answer].concat()).expect("written");
            }
        }
        bodies
    });
    let run = scene.run(&send("query-0.png", &url));
    let bodies = server.join().expect("five requests");
    assert!(run.code == Some(1) && run.stderr.contains("422"), "{run}");
    assert!(bodies[0].len() > 15_000, "a sealed query");
    assert!(bodies.iter().all(|body| *body == bodies[0]), "sealed once, sent five times");
}

#[test]
fn signals_stop_and_reload() {
    let scene = scene();
    fs::create_dir_all(scene.path("signals")).expect("folder");
    fs::copy(scene.path("place.vmap"), scene.path("signals/place.vmap")).expect("copied");
    let mut service = Service::start(
        scene,
        "--map place=signals/place.vmap --watch 1000 --geo-reference place=47.3769,8.5417,455",
    );
    assert_eq!(http::Request::get("/readyz").send(service.address).status, 200);
    let images = |service: &Service| {
        http::Request::get("/v1/maps").send(service.address).json()["maps"][0]["images"].clone()
    };
    let before = images(&service);
    scene.run("map remove signals/place.vmap map-00.png").succeeded();
    assert_eq!(images(&service), before, "not yet reloaded");
    service.signal("-HUP");
    while images(&service) == before {
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    service.signal("-TERM");
    let status = service.child.wait().expect("ended");
    let log = service.log();
    assert_eq!(status.code(), Some(0), "{log}");
    let warnings = log.matches("the unit of this map is not known to be metres").count();
    assert_eq!(warnings, 2, "when it starts, and when it reloads the map:\n{log}");
}

/// A connection of a client.
trait Stream: Read + Write {}

impl<S: Read + Write> Stream for S {}

/// A full pipe, a closed pipe, a full disk: requests are answered, and SIGTERM stops the service.
#[test]
fn blocked_log_does_not_block_service() {
    let scene = scene();
    let answered = |stream: &mut dyn Stream| {
        let request = http::Request::get("/v1/maps").bytes();
        // About ten times the capacity of a pipe.
        for _ in 0..6000 {
            stream.write_all(&request).expect("written");
            assert_eq!(http::Response::read(&mut &mut *stream).status, 200);
        }
    };
    let end = |mut service: Service| {
        service.signal("-TERM");
        assert_eq!(service.child.wait().expect("ended").code(), Some(0));
    };
    let (service, unread) = Service::start_unread(scene, "--map place=place.vmap --rate 1000000");
    answered(&mut http::connect(service.address));
    end(service);
    drop(unread);
    let (service, gone) = Service::start_unread(scene, "--map place=place.vmap --rate 1000000");
    drop(gone);
    answered(&mut http::connect(service.address));
    end(service);
    if let Ok(full) = fs::File::options().write(true).open("/dev/full") {
        // The port cannot be printed, so the service listens on a socket.
        let command = "serve --map place=place.vmap --listen unix:full.sock --admin-listen 127.0.0.1:0 \
                       --unauthenticated-max-age 3600 --connection-max-age 3600 --rate 1000000";
        let child = scene.command(command).stderr(Stdio::from(full)).spawn().expect("the binary runs");
        let nowhere = SocketAddr::from(([127, 0, 0, 1], 0));
        let service =
            Service { child, url: String::new(), address: nowhere, log: Arc::default(), reader: None };
        let mut stream = loop {
            match UnixStream::connect(scene.path("full.sock")) {
                Ok(stream) => break stream,
                Err(_) => std::thread::sleep(std::time::Duration::from_millis(10)),
            }
        };
        answered(&mut stream);
        drop(stream);
        end(service);
    }
}

/// With `--log-json` every line is JSON, including messages for people.
#[test]
fn json_log_has_only_json_lines() {
    let scene = scene();
    for (arguments, code) in [("", 0), (" --map place=none.vmap", 1)] {
        let maps = if arguments.is_empty() { " --map place=place.vmap" } else { arguments };
        let command =
            format!("serve --listen 127.0.0.1:0 --admin-listen 127.0.0.1:0 --drain-delay 0 --log-json{maps}");
        let mut child = scene.command(&command).spawn().expect("the binary runs");
        let mut all = BufReader::new(child.stderr.take().expect("piped")).lines().map_while(Result::ok);
        let mut lines = Vec::new();
        if code == 0 {
            let address: SocketAddr = loop {
                let line = all.next().expect("it starts");
                let address = line.split_once("serving place on http://").map(|(_, rest)| {
                    rest.chars().take_while(|c| c.is_ascii_digit() || ".:".contains(*c)).collect::<String>()
                });
                lines.push(line);
                if let Some(address) = address {
                    break address.parse().expect("an address");
                }
            };
            assert_eq!(http::Request::get("/v1/maps").send(address).status, 200);
            let status = Command::new("kill").args(["-TERM", &child.id().to_string()]).status();
            assert!(status.expect("kill runs").success());
        }
        lines.extend(all);
        assert_eq!(child.wait().expect("ended").code(), Some(code), "{lines:?}");
        assert!(!lines.is_empty());
        for line in &lines {
            let value: serde_json::Value =
                serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}"));
            assert!(value["fields"]["message"].is_string(), "{line}");
        }
        let served = lines.iter().filter(|line| line.contains("serving place on http")).count();
        assert_eq!(served, usize::from(code == 0), "{lines:?}");
    }
}

/// A connection limit above the system's is an error at the start, not a service that stops accepting.
#[test]
fn connection_limit_above_system_limit_is_refused() {
    let scene = scene();
    let limited = |connections: &str| {
        let serve =
            format!("{} serve --map place=place.vmap --listen 127.0.0.1:0", env!("CARGO_BIN_EXE_veiloc"));
        let mut command = Command::new("sh");
        command.args(["-c", &format!("ulimit -n 300; exec {serve} --connections {connections}")]);
        command.current_dir(&scene.folder).stderr(Stdio::piped()).spawn().expect("sh runs")
    };
    let output = limited("1024").wait_with_output().expect("ended");
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(
        message.contains("open files") && message.contains("ulimit -n 1216") && message.contains("300"),
        "{message}"
    );
    let mut child = limited("100");
    let mut lines = BufReader::new(child.stderr.take().expect("piped")).lines().map_while(Result::ok);
    assert!(lines.any(|line| line.starts_with("serving ")), "100 fit");
    child.kill().expect("killed");
    child.wait().expect("ended");
}

/// `kill -9` during requests and the replacement of the map: the map is complete, and a new service answers.
#[test]
fn killed_service_leaves_complete_map() {
    let scene = scene();
    fs::create_dir_all(scene.path("kill")).expect("folder");
    let large = scene.read("place.vmap");
    scene.write("kill/place.vmap", &large);
    scene.run("map remove kill/place.vmap map-00.png").succeeded();
    let small = scene.read("kill/place.vmap");
    scene.seal("query-0.png", "", "kill.vquery");
    let query = scene.read("kill.vquery");
    for after in [1, 20, 60] {
        let mut service = Service::start(scene, "--map place=kill/place.vmap --watch 0.005 --rate 100000");
        let address = service.address;
        let (stop, answered) = (AtomicBool::new(false), AtomicUsize::new(0));
        std::thread::scope(|scope| {
            scope.spawn(|| {
                for bytes in [&small, &large].into_iter().cycle() {
                    if stop.load(Ordering::Relaxed) {
                        break;
                    }
                    scene.write("kill/new", bytes);
                    fs::rename(scene.path("kill/new"), scene.path("kill/place.vmap")).expect("renamed");
                    std::thread::sleep(std::time::Duration::from_millis(3));
                }
            });
            for _ in 0..3 {
                scope.spawn(|| {
                    let bytes = http::Request::localize(&query).header("connection", "close").bytes();
                    // Until the service has ended: then connecting fails, or no answer comes.
                    while let Ok(mut stream) = std::net::TcpStream::connect(address) {
                        if stream.write_all(&bytes).is_err() {
                            break;
                        }
                        let Some(response) = http::Response::try_read(&mut stream) else { break };
                        assert!(matches!(response.status, 200 | 503), "{response:?}");
                        answered.fetch_add(1, Ordering::Relaxed);
                    }
                });
            }
            while answered.load(Ordering::Relaxed) < after {
                std::thread::yield_now();
            }
            service.child.kill().expect("killed");
            service.child.wait().expect("ended");
            stop.store(true, Ordering::Relaxed);
        });
        assert!(!service.log().contains("refused"), "{}", service.log());
        scene.run("map info kill/place.vmap").succeeded();
        let again = Service::start(scene, "--map place=kill/place.vmap");
        assert_eq!(http::Request::localize(&query).send(again.address).status, 200);
    }
}
