//! A file of tokens, damaged in every way: refused, or read as what it says. The properties are the fuzzer's.
#![allow(missing_docs, unreachable_pub, dead_code, reason = "shared with fuzz/")]

#[path = "../../../../../../fuzz/src/damage.rs"]
mod damage;
#[path = "../../../../../../fuzz/src/tokens.rs"]
mod properties;

use std::path::Path;

#[test]
fn damaged_files_are_refused_or_say_what_they_say() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/auth");
    damage::hold_on_files(&folder, "tokens", 3000, properties::tokens);
}
