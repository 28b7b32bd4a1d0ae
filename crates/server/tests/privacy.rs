//! L8: no log line, metric or error holds anything of a query's content, nor a token, nor what an address held.
//!
//! One test in a program of its own, because it listens to everything the process logs, at the finest level.

mod common;

use std::io::Write;
use std::sync::{Arc, Mutex};

use common::http::Request;
use common::{Files, OPERATOR, PHONE, Running, seal_features, truth};
use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use tracing_subscriber::fmt::MakeWriter;
use veiloc_descriptor::{DescriptorKind, Descriptors};

/// Sixteen bytes nothing else would ever write.
const MARK: &[u8; 16] = b"XqZvKwJyQxVzWkYj";

#[derive(Clone, Default)]
struct Log(Arc<Mutex<Vec<u8>>>);

impl Log {
    fn text(&self) -> String {
        String::from_utf8_lossy(&self.0.lock().expect("not poisoned")).into_owned()
    }
}

impl Write for Log {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().expect("not poisoned").write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl<'a> MakeWriter<'a> for Log {
    type Writer = Self;

    fn make_writer(&'a self) -> Self {
        self.clone()
    }
}

/// The mark in all forms in which a program might print bytes; a third of it is enough to know it.
fn forms() -> Vec<String> {
    let list = |f: fn(&u8) -> String, by: &str| MARK[3..8].iter().map(f).collect::<Vec<_>>().join(by);
    let base64 = |skip: usize| {
        let alphabet = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
        MARK[skip..skip + 6].chunks(3).fold(String::new(), |text, c| {
            let bits = u32::from(c[0]) << 16 | u32::from(c[1]) << 8 | u32::from(c[2]);
            [18, 12, 6, 0]
                .iter()
                .fold(text, |t, s| t + &(alphabet[(bits >> s & 63) as usize] as char).to_string())
        })
    };
    vec![
        String::from_utf8(MARK[3..8].to_vec()).expect("ASCII"),
        list(|b| format!("{b:02x}"), ""),
        list(|b| format!("{b:02X}"), ""),
        list(|b| format!("{b:02x}"), " "),
        list(ToString::to_string, ", "),
        list(ToString::to_string, ","),
        list(ToString::to_string, " "),
        base64(0),
        base64(1),
        base64(2),
    ]
}

fn holds_the_mark(text: &str) -> Option<String> {
    forms().into_iter().find(|form| text.contains(form))
}

/// A query whose descriptors all are the mark, eight times.
fn marked(files: &Files) -> Vec<u8> {
    let mut features = files.place.features(&truth());
    let count = features.keypoints.len();
    features.descriptors =
        Descriptors::new(DescriptorKind::ROOT_SIFT, MARK.repeat(8 * count)).expect("whole rows");
    let mut rng = ChaCha20Rng::seed_from_u64(3);
    seal_features(features, &files.place.camera, &files.place.profile, &mut rng).encode()
}

#[test]
fn l8_nothing_of_a_query_is_ever_told() {
    let log = Log::default();
    tracing_subscriber::fmt()
        .with_max_level(tracing::Level::TRACE)
        .with_writer(log.clone())
        .with_ansi(false)
        .init();
    // The search finds the mark in every form, when there is something to find.
    for (form, text) in [
        ("text", String::from_utf8_lossy(MARK).into_owned()),
        ("hex", MARK.iter().fold(String::new(), |text, b| text + &format!("{b:02x}"))),
        ("a list", format!("{MARK:?}")),
        ("base64", "WHFadkt3Snk=".to_owned()),
    ] {
        tracing::trace!("{text}");
        assert!(holds_the_mark(&log.text()).is_some(), "{form} is not found");
        log.0.lock().expect("not poisoned").clear();
    }

    let files = Files::new();
    let server = Running::start(files.options());
    let good = files.place.sealed(&truth());
    let query = marked(&files);
    assert!(query.windows(16).any(|w| w == MARK), "the mark is sent");
    let mark = std::str::from_utf8(MARK).expect("ASCII");
    let mut version = query.clone();
    version[1] = 9;
    let mut broken = query.clone();
    broken.truncate(query.len() - 7);
    let other = {
        let mut files = Files::new();
        files.place.profile = common::Place::new(2).profile;
        marked(&files)
    };
    let localize = |body: &[u8]| Request::localize(body).token(PHONE);
    let mut told = String::new();
    for request in [
        localize(&query),
        localize(&good),
        localize(&version),
        localize(&broken),
        localize(&other),
        localize(MARK),
        localize(&MARK.repeat(60_000)),
        Request::localize(&query).token(mark),
        Request::localize(&query),
        Request::localize(&query).token(PHONE).header("x-mark", mark).header("accept", mark),
        Request::localize(&query).token(PHONE).header("cookie", mark),
        Request::post(&format!("/v1/maps/{mark}/localize"), &query).token(PHONE),
        Request::post("/v1/maps/place/localize", &query).token(PHONE).header("content-type", mark),
        Request::post(&format!("/{mark}?{mark}"), &query).token(PHONE),
        Request::get(&format!("/v1/maps/place/profile?{mark}")).token(PHONE),
        Request { head: format!("{mark} /healthz HTTP/1.1\r\nhost: {mark}\r\n"), body: Vec::new() },
        Request { head: format!("GET / HTTP/1.1\r\n{mark}\r\n"), body: Vec::new() },
    ] {
        let response = request.send(server.address);
        told += &response.head;
        told += &String::from_utf8_lossy(&response.body);
    }
    told += &server.get("/metrics", OPERATOR).text();
    drop(server);
    let logged = log.text();
    assert!(logged.lines().count() >= 15, "every request left its line:\n{logged}");
    assert!(logged.contains("sealed queries read") && logged.contains("wrong-profile"), "{logged}");
    assert_eq!(holds_the_mark(&logged), None, "in the log:\n{logged}");
    assert_eq!(holds_the_mark(&told), None, "in answers or metrics:\n{told}");
    for token in [PHONE, OPERATOR] {
        assert!(!logged.contains(token) && !told.contains(token), "a token was told");
    }
}
