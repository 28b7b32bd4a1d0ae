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
# In the workspace's target folder, and from its own lock file.
target="${CARGO_TARGET_DIR:-$PWD/../../target}"
CARGO_TARGET_DIR="$target" cargo build --quiet --locked --manifest-path generate/Cargo.toml
"$target/debug/veiloc-mobile-generate" generate "$library" --language kotlin --language swift --out-dir "$out" --no-format \
    --metadata-no-deps
