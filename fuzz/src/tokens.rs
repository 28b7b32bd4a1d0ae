//! What must hold for any file of tokens. Also a part of `crates/server/service/tests/it/auth/any_bytes.rs`.

use veiloc_service::auth::{Entry, TokenKey, TokenList, added, revoked};

/// A file of tokens: every line reads as it is written, and adding and revoking a token touches no other.
pub fn tokens(bytes: &[u8]) {
    let Ok(list) = TokenList::parse(bytes) else { return };
    let text = std::str::from_utf8(bytes).expect("what is read is text");
    for entry in list.entries() {
        let again: Entry = entry.to_string().parse().expect("what is written can be read");
        assert!(again == *entry, "a second form of a token");
        assert!(list.find(&entry.key()) == Some(entry));
        let beginning = entry.key().beginning();
        // A name may hold anything, be it the digits of a hash.
        let by_name = entry.name().contains(&beginning);
        assert!(by_name || !format!("{entry:?}").contains(&beginning), "a hash in a log");
        let left = revoked(text, entry.name()).expect("it is there").text;
        let left = TokenList::parse(left.as_bytes()).expect("what is left is a file of tokens");
        let others = list.entries().iter().filter(|other| other.name() != entry.name());
        assert!(others.eq(left.entries()), "another token was touched");
    }
    let new = Entry::new("new", TokenKey::of_digest([7; 32])).expect("a name");
    if let Ok(more) = added(text, &new) {
        let more = TokenList::parse(more.as_bytes()).expect("still a file of tokens");
        assert!(list.entries().iter().chain([&new]).eq(more.entries()));
    }
}
