//! Damaged token files: refused, or parsed consistently. The properties are shared with the fuzzer.
#![allow(missing_docs, unreachable_pub, dead_code, reason = "shared with fuzz/")]

#[path = "../../../../../../fuzz/src/damage.rs"]
mod damage;
#[path = "../../../../../../fuzz/src/tokens.rs"]
mod properties;

use std::path::Path;

#[test]
fn damaged_token_files_are_refused_or_parsed_consistently() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/auth");
    damage::check_files(&folder, "tokens", 3000, properties::tokens);
}
