#!/usr/bin/env bash
# Builds what browsers are given: js/veiloc.wasm for the npm package, and page/ for `veiloc serve --page`.
#
#     bindings/web/build.sh                    for `npm pack`, and `veiloc serve --page-folder bindings/web/page`
#     bindings/web/build.sh target/release     the same, with the page in target/release/veiloc-page, where the program finds it
#
# Needs Rust with the target wasm32-unknown-unknown (`rustup target add wasm32-unknown-unknown`), and nothing else.
set -euo pipefail
[ -d "$(rustc --print target-libdir --target wasm32-unknown-unknown)" ] || {
    echo "this Rust cannot build for browsers yet: rustup target add wasm32-unknown-unknown" >&2
    exit 1
}
beside="${1:+$(cd "$1" && pwd)}"
[ -z "${CARGO_TARGET_DIR-}" ] || export CARGO_TARGET_DIR="$(realpath -m "$CARGO_TARGET_DIR")"
cd "$(dirname "$0")"

# Vector instructions every browser has had since 2023; no generator of its own, the page hands random bytes over.
features="+simd128,+bulk-memory,+nontrapping-fptoint,+sign-ext,+mutable-globals"
RUSTFLAGS="-C target-feature=$features --cfg getrandom_backend=\"custom\"" \
    cargo build --lib -p veiloc-web --profile web --target wasm32-unknown-unknown --locked
target="${CARGO_TARGET_DIR:-$(cd ../.. && pwd)/target}"
cp "$target/wasm32-unknown-unknown/web/veiloc_web.wasm" js/veiloc.wasm

rm -rf page
mkdir page
cp page-src/* js/*.js js/veiloc.wasm page/
if [ -n "$beside" ]; then
    rm -rf "$beside/veiloc-page"
    cp -r page "$beside/veiloc-page"
fi
bytes=$(gzip -9 -c js/veiloc.wasm | wc -c)
echo "veiloc.wasm: $(wc -c < js/veiloc.wasm) bytes, $bytes gzipped"
