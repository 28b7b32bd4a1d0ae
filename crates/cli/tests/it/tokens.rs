//! `veiloc token`: operations on the token file, and what of it is printed.

use super::common;

use common::folder;
use serde_json::Value;
use veiloc_service::auth::{TokenKey, TokenList};

fn list(folder: &common::TestScene) -> TokenList {
    TokenList::parse(&folder.read("tokens")).expect("a file of tokens")
}

#[test]
fn token_is_printed_once_and_stored_as_hash() {
    let folder = folder();
    let text = |folder: &common::TestScene| String::from_utf8(folder.read("tokens")).expect("text");
    let made =
        folder.run("token new phone --tokens tokens --maps lobby,garage --expires 2199-01-31").succeeded();
    let token = made.stdout.trim_end();
    assert_eq!(token.len(), 64);
    assert!(made.stderr.contains("Authorization: Bearer") && !made.stderr.contains(token));
    assert!(!text(&folder).contains(token), "the file has only the hash");
    let file = list(&folder);
    let entry = file.find(&TokenKey::of_token(token.as_bytes())).expect("its line");
    assert!(entry.allows_map("garage") && !entry.allows_map("attic") && !entry.operator);
    folder.run("token new ops --operator --anchors --days 30 --tokens tokens").succeeded();

    let shown = folder.run("token list --tokens tokens").succeeded();
    let listed = folder.run("token list --tokens tokens --json").succeeded();
    let hash = text(&folder).split_whitespace().nth(1).expect("a hash").to_owned();
    for text in [&shown.stdout, &listed.stdout] {
        assert!(text.contains("phone") && text.contains("garage") && text.contains("2199-01-31"), "{text}");
        assert!(text.contains(&hash[..8]) && !text.contains(&hash[..9]), "never the whole hash: {text}");
    }
    let document = listed.json();
    assert_eq!(document["tokens"][1]["operator"], true);
    assert_eq!([0, 1].map(|i| document["tokens"][i]["anchors"] == true), [false, true]);
    assert_eq!(document["tokens"][1]["expired"], false);
    assert_eq!(document["tokens"][1]["maps"], Value::Null);

    folder.run("token revoke phone --tokens tokens").succeeded();
    assert_eq!(list(&folder).entries().len(), 1);
    let last = folder.run("token revoke ops --tokens tokens").succeeded();
    assert!(last.stderr.contains("no client may send requests"));
    assert!(list(&folder).entries().is_empty(), "no partial file remains");
    folder.run("token new again --tokens tokens").succeeded();
    assert_eq!(list(&folder).entries().len(), 1);
}

#[cfg(unix)]
#[test]
fn token_file_is_readable_by_its_owner_only() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = folder();
    let made = folder.run("token new phone --tokens tokens --out phone.token").succeeded();
    assert_eq!(made.stdout, "", "the token is in the file only");
    let token = String::from_utf8(folder.read("phone.token")).expect("text");
    assert!(list(&folder).find(&TokenKey::of_token(token.trim_end().as_bytes())).is_some());
    assert!(!made.stderr.contains(token.trim_end()));
    let mode = std::fs::metadata(folder.path("phone.token")).expect("a file").permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
    // Nothing is written for a token that is refused.
    let again = folder.run("token new phone --tokens tokens --out other.token");
    assert_eq!(again.code, Some(1), "{again}");
    assert!(!folder.path("other.token").exists());
}

/// A link has the token in its fragment, which browsers do not send.
#[test]
fn link_and_its_code_hold_the_token() {
    let folder = folder();
    let command = "token new visitors --tokens tokens --maps lobby --link https://places.example:8443/ --qr visitors.svg";
    let made = folder.run(command).succeeded();
    let token = made.stdout.trim_end().strip_prefix("https://places.example:8443/#token=").expect("a link");
    assert!(list(&folder).find(&TokenKey::of_token(token.as_bytes())).is_some());
    assert!(!made.stderr.contains(token));
    let svg = String::from_utf8(folder.read("visitors.svg")).expect("text");
    assert!(svg.contains("<svg") && svg.len() > 1000, "{svg}");
    for (address, part) in [
        ("http://places.example", "https"),
        ("https://", "https"),
        ("http://localhost.example", "https"),
        ("https://places.example/#a", "https"),
        ("https://places.example/?a=b", "https"),
        ("https://me@places.example", "https"),
    ] {
        let run = folder.run(&format!("token new other --tokens tokens --link {address}"));
        assert_eq!(run.code, Some(2), "{run}");
        assert!(run.stderr.contains(part), "{run}");
    }
    let here =
        folder.run("token new here --tokens tokens --link http://localhost:8080 --out here.link").succeeded();
    assert_eq!(here.stdout, "");
    assert!(
        String::from_utf8(folder.read("here.link"))
            .expect("text")
            .starts_with("http://localhost:8080/#token=")
    );
    assert_eq!(folder.run("token new code --tokens tokens --qr a.svg").code, Some(2), "a code needs a link");
}

#[test]
fn invalid_changes_are_refused_and_file_stays() {
    let folder = folder();
    folder.run("token new phone --tokens tokens").succeeded();
    folder.write("broken", "phone hunter2\n");
    let before = folder.read("tokens");
    for (command, code, part) in [
        ("token new phone --tokens tokens", 1, "revoke it first"),
        ("token new nobody --tokens tokens", 1, "not `nobody`"),
        ("token new a/b --tokens tokens", 1, "letters, digits"),
        ("token new b --tokens tokens --expires 2020-01-01", 1, "in the past"),
        ("token new b --tokens tokens --expires tomorrow", 2, "2027-01-31"),
        ("token new b --tokens tokens --days 0", 2, "--days"),
        ("token new b --tokens tokens --days 4000000000", 1, "9999"),
        ("token new b --tokens tokens --days 3 --expires 2199-01-01", 2, "cannot be used with"),
        ("token new b --tokens tokens --operator --maps a", 2, "cannot be used with"),
        ("token new b --tokens tokens --maps a/b", 2, "names of maps"),
        ("token new b --tokens none/tokens", 1, "none/tokens"),
        ("token new b --tokens broken", 1, "line 1"),
        ("token list --tokens broken", 1, "64 hexadecimal digits"),
        ("token list --tokens none", 1, "none"),
        ("token revoke other --tokens tokens", 1, "no token has this name"),
        ("token revoke other --tokens none", 1, "none"),
    ] {
        let run = folder.run(command);
        assert_eq!(run.code, Some(code), "{run}");
        assert!(run.stderr.contains(part), "{run}");
        assert!(!run.stderr.contains("hunter2") && run.stdout.is_empty(), "{run}");
    }
    assert_eq!(folder.read("tokens"), before);
    assert!(!folder.folder.join("none").exists());
}
