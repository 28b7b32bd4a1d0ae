//! A file of settings, damaged in every way: refused, or read as what it says. The properties are the fuzzer's.
#![allow(missing_docs, unreachable_pub, dead_code, reason = "shared with fuzz/")]

#[path = "../../../../../../fuzz/src/damage.rs"]
mod damage;
#[path = "../../../../../../fuzz/src/settings.rs"]
mod properties;

use std::path::Path;

#[test]
fn damaged_files_are_refused_or_say_what_they_say() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/args");
    damage::hold_on_files(&folder, "toml", 1000, properties::settings);
}
