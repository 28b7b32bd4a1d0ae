//! Properties of any token file. `crates/server/service/tests/it/auth/any_bytes.rs` includes this file.

use veiloc_service::auth::{TokenEntry, TokenKey, TokenList, added, revoked};

/// A token file: every entry round-trips, and adding or revoking a token does not change the others.
pub fn tokens(bytes: &[u8]) {
    let Ok(list) = TokenList::parse(bytes) else { return };
    let text = std::str::from_utf8(bytes).expect("a parsed file is UTF-8");
    for entry in list.entries() {
        let again: TokenEntry = entry.to_string().parse().expect("a written entry can be read");
        assert!(again == *entry, "an entry has two forms");
        assert!(list.find(&entry.key()) == Some(entry));
        let beginning = entry.key().beginning();
        // A name may itself contain the digits of the hash.
        let by_name = entry.name().contains(&beginning);
        assert!(by_name || !format!("{entry:?}").contains(&beginning), "Debug prints a hash");
        let left = revoked(text, entry.name()).expect("the token exists").text;
        let left = TokenList::parse(left.as_bytes()).expect("the rest is a valid token file");
        let others = list.entries().iter().filter(|other| other.name() != entry.name());
        assert!(others.eq(left.entries()), "another token was changed");
    }
    let new = TokenEntry::new("new", TokenKey::of_digest([7; 32])).expect("a name");
    if let Ok(more) = added(text, &new) {
        let more = TokenList::parse(more.as_bytes()).expect("the result is a valid token file");
        assert!(list.entries().iter().chain([&new]).eq(more.entries()));
    }
}
