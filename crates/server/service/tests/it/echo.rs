//! No refusal repeats input: neither in its head nor in its body, wherever in the request it was.

use super::common;

use common::http::Request;
use common::{Files, PHONE, Running, truth};

/// A number and a word that occur nowhere else.
const NUMBER: u32 = 1_515_852_340;
const WORD: &str = "XqZvKwJyQx";

/// A valid query for another map.
fn known_query() -> Vec<u8> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../core/protocol/tests/data/dcl.vquery");
    std::fs::read(path).expect("the known answer")
}

/// The query with `NUMBER` in one field after another.
fn with_a_wrong_number() -> Vec<(String, Vec<u8>)> {
    let query = known_query();
    // Version, then the profile id (18 bytes with key and length), then eight numbers of five bytes, the name of the
    // kind (6 bytes) and three more.
    let offsets = std::iter::once((1, 0))
        .chain((3..=10).map(|field| (field, 23 + 5 * (field - 3))))
        .chain((12..=14).map(|field| (field, 69 + 5 * (field - 12))));
    let wrong = |(field, at): (usize, usize)| {
        assert_eq!(usize::from(query[at]), field << 3 | 5, "field {field} is a fixed32 there");
        let mut bytes = query.clone();
        bytes[at + 1..at + 5].copy_from_slice(&NUMBER.to_le_bytes());
        (format!("field {field}"), bytes)
    };
    offsets.map(wrong).collect()
}

#[test]
fn refusals_do_not_echo_input() {
    let files = Files::new();
    let server = Running::start(files.options());
    let query = files.scene.sealed(&truth());
    let localize = |body: &[u8]| Request::localize(body).token(PHONE);
    let mut requests: Vec<(String, Request)> =
        with_a_wrong_number().into_iter().map(|(what, bytes)| (what, localize(&bytes))).collect();
    let whole = known_query();
    let global = whole.len() - 600;
    let with_word = |at: usize| [&whole[..at], WORD.repeat(4).as_bytes(), &whole[at..]].concat();
    let get = |path: &str| Request::get(path).token(PHONE);
    let post = |path: &str| Request::post(path, &query).token(PHONE);
    let named = [
        ("a number as text", localize(NUMBER.to_string().as_bytes())),
        ("a word", localize(WORD.as_bytes())),
        ("a key of protobuf", localize(&[&[0xFD, 0xFF, 0xFF, 0xFF, 0x0F][..], WORD.as_bytes()].concat())),
        ("another map's query", localize(&whole)),
        ("rows of another length", localize(&with_word(90))),
        ("a longer descriptor", localize(&with_word(global))),
        ("a field more", localize(&with_word(whole.len()))),
        ("a name of a map", post(&format!("/v1/maps/{WORD}/localize"))),
        ("a name of a map, escaped", get(&format!("/v1/maps/%FF{WORD}/profile"))),
        ("an address", get(&format!("/{WORD}/{NUMBER}?{WORD}={NUMBER}"))),
        ("a query string", Request::get(&format!("/v1/maps?{WORD}={NUMBER}"))),
        (
            "a method",
            Request { head: format!("{WORD} /v1/maps HTTP/1.1\r\nhost: {WORD}\r\n"), body: Vec::new() },
        ),
        ("a token", Request::localize(&query).token(WORD)),
        ("an authorization", Request::localize(&query).header("authorization", &format!("Basic {WORD}"))),
        ("a media type", post("/v1/maps/place/localize").header("content-type", &format!("{WORD}/{NUMBER}"))),
        ("an accept parameter", localize(&whole).header("accept", &format!("application/json;x={WORD}"))),
        ("an accept range", localize(&whole).header("accept", &format!("{WORD}/*"))),
        ("a position prior", localize(&whole).header("veiloc-near", &format!("{NUMBER},{NUMBER},{WORD},1"))),
        ("an option", localize(&whole).header("veiloc-trusted-only", WORD)),
        ("other headers", localize(&whole).header(WORD, WORD).header("cookie", WORD).header("origin", WORD)),
        (
            "a length",
            Request {
                head: format!(
                    "POST /v1/maps/place/localize HTTP/1.1\r\nhost: t\r\ncontent-length: {NUMBER}\r\n"
                ),
                body: Vec::new(),
            }
            .token(PHONE)
            .header("content-type", "application/x-protobuf")
            // A client that waits for `100 Continue` is refused before it sends the body.
            .header("expect", "100-continue"),
        ),
    ];
    requests.extend(named.map(|(what, request)| (what.to_owned(), request)));
    let forms = [
        NUMBER.to_string(),
        format!("{NUMBER:x}"),
        WORD.to_lowercase(),
        format!("{:?}", &WORD.as_bytes()[..4]),
    ];
    for (what, request) in requests {
        let response = request.send(server.address);
        assert!((400..500).contains(&response.status), "{what}: {response:?}");
        let name = response.problem();
        let response_text = (response.head.clone() + &response.text()).to_lowercase();
        let echoed = forms.iter().find(|form| response_text.contains(form.trim_matches(['[', ']'])));
        assert_eq!(echoed, None, "{what}, {name}: {response_text}");
    }
}

/// Refusals name the field and its allowed values.
#[test]
fn refusals_name_the_field_and_allowed_values() {
    let files = Files::new();
    let server = Running::start(files.open_options());
    for (what, bytes) in with_a_wrong_number().into_iter().skip(1) {
        let detail = server.localize(&bytes, "").json()["detail"].as_str().expect("a detail").to_owned();
        assert!(
            detail.contains("must be") || detail.contains("the length of") || detail.contains("out of range"),
            "{what}: {detail}"
        );
    }
    let scheme = server.localize(&with_a_wrong_number()[1].1, "").json()["detail"].clone();
    assert!(scheme.as_str().is_some_and(|s| s.starts_with("scheme must be")), "{scheme}");
}
