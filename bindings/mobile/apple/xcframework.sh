#!/usr/bin/env bash
# Builds Veiloc.xcframework for iOS devices and simulators, and the Swift sources, beside Package.swift. On a Mac with Xcode:
#
#     bindings/mobile/apple/xcframework.sh
set -euo pipefail
cd "$(dirname "$0")/../../.."
[ "$(uname -s)" = Darwin ] || { echo "xcodebuild is needed, which only macOS has" >&2; exit 1; }
target="${CARGO_TARGET_DIR:-$PWD/target}" here="$PWD/bindings/mobile/apple"
headers="$here/build/headers"
rm -rf "$here/build" "$here/VeilocFFI.xcframework" && mkdir -p "$headers"
for triple in aarch64-apple-ios aarch64-apple-ios-sim x86_64-apple-ios; do
    rustup target add "$triple"
    cargo rustc --locked --profile phone --package veiloc-mobile --lib --crate-type staticlib --target "$triple"
done
# One library for the simulators of both kinds of Mac.
mkdir -p "$here/build/simulator"
lipo -create "$target/aarch64-apple-ios-sim/phone/libveiloc_mobile.a" "$target/x86_64-apple-ios/phone/libveiloc_mobile.a" \
    -output "$here/build/simulator/libveiloc_mobile.a"
cargo build --locked --package veiloc-mobile --lib
bindings/mobile/generate.sh "$target/debug/libveiloc_mobile.dylib" "$here/build/sources"
cp "$here/build/sources/VeilocFFI.h" "$headers"
cp "$here/build/sources/VeilocFFI.modulemap" "$headers/module.modulemap"
mkdir -p "$here/Sources/Veiloc"
cp "$here/build/sources/Veiloc.swift" "$here/Sources/Veiloc"
xcodebuild -create-xcframework \
    -library "$target/aarch64-apple-ios/phone/libveiloc_mobile.a" -headers "$headers" \
    -library "$here/build/simulator/libveiloc_mobile.a" -headers "$headers" \
    -output "$here/VeilocFFI.xcframework"
