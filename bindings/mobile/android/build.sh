#!/usr/bin/env bash
# Builds the AAR: native libraries by the NDK, Kotlin sources by UniFFI, then Gradle.
#
#     ANDROID_NDK_HOME=… ANDROID_HOME=… bindings/mobile/android/build.sh
#     bindings/mobile/android/build.sh --libraries          only the libraries and sources, for the app of examples/android
#     bindings/mobile/android/build.sh --check LIBRARY…     only checks that shared libraries have pages of 16 kB
#
# Needs the NDK (26 or newer), an Android SDK with platform 35, JDK 17 and Gradle 8.9 or newer.
set -euo pipefail

# Every loadable segment is aligned to 16 kB, as Android 15 demands of 64-bit libraries.
pages_are_16_kb() {
    local library alignment alignments
    for library in "$@"; do
        mapfile -t alignments < <(readelf --program-headers --wide "$library" | awk '$1 == "LOAD" { print $NF }')
        [ ${#alignments[@]} -gt 0 ] || { echo "$library: no loadable segment" >&2; return 1; }
        for alignment in "${alignments[@]}"; do
            ((alignment >= 16384)) || { echo "$library: a segment is aligned to $alignment, not to 16 kB" >&2; return 1; }
        done
    done
}

if [ "${1-}" = --check ]; then
    shift
    pages_are_16_kb "$@"
    exit
fi
cd "$(dirname "$0")/../../.."
: "${ANDROID_NDK_HOME:?the folder of the NDK}" "${ANDROID_HOME:?the folder of the Android SDK}"
case "$(uname -s)" in Darwin) host=darwin-x86_64 ;; *) host=linux-x86_64 ;; esac
tools="$ANDROID_NDK_HOME/toolchains/llvm/prebuilt/$host/bin" target="${CARGO_TARGET_DIR:-$PWD/target}"
here="$PWD/bindings/mobile/android" api=26
generated="$here/build/generated"
rm -rf "$generated" && mkdir -p "$generated/jniLibs" "$generated/kotlin"
for pair in aarch64-linux-android=arm64-v8a x86_64-linux-android=x86_64; do
    triple="${pair%=*}" abi="${pair#*=}"
    rustup target add "$triple"
    variable="${triple^^}" variable="${variable//-/_}"
    env "CARGO_TARGET_${variable}_LINKER=$tools/${triple}$api-clang" \
        "CARGO_TARGET_${variable}_RUSTFLAGS=-Clink-arg=-Wl,-z,max-page-size=16384" \
        cargo rustc --locked --profile phone --package veiloc-mobile --lib --crate-type cdylib --target "$triple"
    library="$target/$triple/phone/libveiloc_mobile.so"
    pages_are_16_kb "$library"
    mkdir -p "$generated/jniLibs/$abi"
    cp "$library" "$generated/jniLibs/$abi"
done
# The generator reads symbols, which the profile `phone` strips.
cargo build --locked --package veiloc-mobile --lib
library=$(ls "$target/debug/libveiloc_mobile."{so,dylib} 2> /dev/null | head -1)
bindings/mobile/generate.sh "$library" "$generated/sources"
cp -r "$generated/sources/org" "$generated/kotlin"
[ "${1-}" != --libraries ] || exit 0
cd "$here"
gradle --quiet assembleRelease
ls -l "$here/build/outputs/aar"
