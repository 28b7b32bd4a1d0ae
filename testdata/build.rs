//! Path of the real images, read once for all crates: `VEILOC_DATA`, relative to the workspace's folder.

use std::path::Path;

fn main() {
    println!("cargo::rerun-if-env-changed=VEILOC_DATA");
    println!("cargo::rerun-if-changed=build.rs");
    let Some(folder) = std::env::var_os("VEILOC_DATA").filter(|folder| !folder.is_empty()) else { return };
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let folder = workspace.join(&folder);
    // A mistyped folder must not look like a missing variable, since the tests would then be ignored.
    assert!(folder.is_dir(), "VEILOC_DATA is not a folder: {}", folder.display());
    let folder = folder.canonicalize().expect("it was just found");
    println!("cargo::rustc-env=VEILOC_DATA_FOLDER={}", folder.to_str().expect("a folder name in UTF-8"));
}
