//! Writes `include/veiloc.h`, or compares it with `--check`: `cargo xtask c-header [--check]`.

use std::path::Path;
use std::process::ExitCode;

fn main() -> ExitCode {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(folder.join("cbindgen.toml")).expect("cbindgen.toml is valid");
    let bindings = cbindgen::Builder::new().with_crate(folder).with_config(config).generate();
    let bindings = bindings.expect("the sources can be read");
    let mut header = Vec::new();
    bindings.write(&mut header);
    let path = folder.join("include/veiloc.h");
    if std::env::args().any(|argument| argument == "--check") {
        let is_current = std::fs::read(&path).is_ok_and(|committed| committed == header);
        return if is_current { ExitCode::SUCCESS } else { ExitCode::FAILURE };
    }
    std::fs::write(path, header).expect("the folder is writable");
    ExitCode::SUCCESS
}
