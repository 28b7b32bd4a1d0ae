//! Writes the known-answer files of the wire format: `cargo run -p veiloc-protocol --example known_answers`.
//!
//! They pin the format: run it only after a deliberate change, and change the version with it.

#[path = "../tests/it/common/mod.rs"]
mod common;

use std::fs;
use std::path::Path;

fn main() -> std::io::Result<()> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    fs::create_dir_all(&folder)?;
    for (file, query) in common::known_answers() {
        fs::write(folder.join(format!("{file}.vquery")), query.encode())?;
    }
    fs::write(folder.join("place.vpack"), common::pack().encode())?;
    for (file, profile) in common::known_profiles() {
        fs::write(folder.join(format!("{file}.profile")), profile.encode())?;
    }
    for (file, answer) in common::known_replies() {
        fs::write(folder.join(format!("{file}.answer")), answer.encode())?;
        if file == "doubtful" {
            fs::write(folder.join("doubtful.json"), answer.to_json())?;
        }
    }
    Ok(())
}
