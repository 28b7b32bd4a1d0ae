#!/usr/bin/env bash
# Static libraries of the bindings for phones, without the NDK and without Xcode:
#
#     scripts/phones/libraries.sh [--release]
#
# Prints each library with its size. Shared libraries for Android and frameworks for iOS are linked by the NDK and Xcode of the user
# (docs/guide/phone.md).
set -euo pipefail
cd "$(dirname "$0")/../.."
target="${CARGO_TARGET_DIR:-$PWD/target}" profile=debug
[ "${1-}" = --release ] && profile=release
for triple in aarch64-linux-android armv7-linux-androideabi aarch64-apple-ios; do
    rustup target add --toolchain "$(rustup show active-toolchain | cut -d' ' -f1)" "$triple" 2> /dev/null
    for crate in veiloc-c veiloc-mobile; do
        cargo rustc --quiet --locked --package "$crate" --lib --crate-type staticlib --target "$triple" "$@"
        ls -l "$target/$triple/$profile/lib${crate//-/_}.a" | awk '{ print $NF, $5 }'
    done
done
