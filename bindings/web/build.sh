#!/usr/bin/env bash
# Builds page/: the page of `veiloc serve --page`, and in it all files of the npm package. The module is also copied to
# js/veiloc.wasm, for programs that import js/ from the repository.
#
#     bindings/web/build.sh                    for `npm pack`, and `veiloc serve --page-folder bindings/web/page`
#     bindings/web/build.sh target/release     also copies the page to target/release/veiloc-page, where the program finds it
#
# Needs Rust with the target wasm32-unknown-unknown (`rustup target add wasm32-unknown-unknown`).
set -euo pipefail
[ -d "$(rustc --print target-libdir --target wasm32-unknown-unknown)" ] || {
    echo "the Rust target for browsers is missing: rustup target add wasm32-unknown-unknown" >&2
    exit 1
}
beside="${1:+$(cd "$1" && pwd)}"
[ -z "${CARGO_TARGET_DIR-}" ] || export CARGO_TARGET_DIR="$(realpath -m "$CARGO_TARGET_DIR")"
cd "$(dirname "$0")"

# Vector instructions that all browsers have had since 2023. No random generator of its own: the page supplies random bytes.
features="+simd128,+bulk-memory,+nontrapping-fptoint,+sign-ext,+mutable-globals"
RUSTFLAGS="-C target-feature=$features --cfg getrandom_backend=\"custom\"" \
    cargo build --lib -p veiloc-web --profile web --target wasm32-unknown-unknown --locked
target="${CARGO_TARGET_DIR:-$(cd ../.. && pwd)/target}"
cp "$target/wasm32-unknown-unknown/web/veiloc_web.wasm" js/veiloc.wasm

rm -rf page
mkdir page
cp page-src/* js/*.js js/index.d.ts js/veiloc.wasm page/
if [ -n "$beside" ]; then
    rm -rf "$beside/veiloc-page"
    cp -r page "$beside/veiloc-page"
fi
bytes=$(gzip -9 -c js/veiloc.wasm | wc -c)
echo "veiloc.wasm: $(wc -c < js/veiloc.wasm) bytes, $bytes gzipped"
