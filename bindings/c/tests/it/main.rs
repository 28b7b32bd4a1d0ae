//! Tests of the C border from Rust; `scripts/phones/run.py` runs those in C, C++, C# and Kotlin.

use std::path::Path;
use std::process::Command;

/// The committed header is what cbindgen makes of the sources.
#[test]
fn header_is_current() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(folder.join("cbindgen.toml")).expect("cbindgen.toml is valid");
    let bindings = cbindgen::Builder::new().with_crate(folder).with_config(config).generate();
    let mut header = Vec::new();
    bindings.expect("the sources can be read").write(&mut header);
    let committed = std::fs::read(folder.join("include/veiloc.h")).expect("it is committed");
    assert!(committed == header, "include/veiloc.h is out of date: cargo xtask c-header");
}

/// It compiles as C99 and as C++11, with all warnings, where there is a compiler.
#[test]
fn header_compiles_as_c_and_cplusplus() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let work = tempfile::tempdir().expect("a folder");
    for (compiler, standard, file, header) in
        [("cc", "-std=c99", "header.c", "veiloc.h"), ("c++", "-std=c++11", "header.cpp", "veiloc.hpp")]
    {
        let source = work.path().join(file);
        std::fs::write(&source, format!("#include \"{header}\"\nint main(void) {{ return 0; }}\n"))
            .expect("the folder is writable");
        let run = Command::new(compiler)
            .args([standard, "-Wall", "-Wextra", "-Werror", "-pedantic", "-fsyntax-only", "-I"])
            .arg(folder.join("include"))
            .arg(&source)
            .output()
            .expect("a C and C++ compiler");
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    }
}
