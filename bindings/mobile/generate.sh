#!/usr/bin/env bash
# Writes the Kotlin and Swift sources of bindings/mobile:
#
#     bindings/mobile/generate.sh LIBRARY OUT
#
# LIBRARY: libveiloc_mobile.so (or .dylib), also one of another target, as `cargo build -p veiloc-mobile` makes it. OUT: the folder
# for org/veiloc/veiloc_mobile.kt, Veiloc.swift, VeilocFFI.h and VeilocFFI.modulemap.
set -euo pipefail
library="$(realpath "$1")" out="$(realpath -m "$2")"
cd "$(dirname "$0")"
# From its own lock file, in a folder of its own: no build of the workspace waits for it.
target="${CARGO_TARGET_DIR:-$PWD/../../target}/generate"
cargo build --quiet --locked --manifest-path generate/Cargo.toml --target-dir "$target"
"$target/debug/veiloc-mobile-generate" generate "$library" --language kotlin --language swift --out-dir "$out" --no-format \
    --metadata-no-deps
