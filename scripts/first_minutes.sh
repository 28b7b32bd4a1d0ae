#!/usr/bin/env bash
# The first minutes of a new user: the commands of the README on a clean clone of the last commit, with the seconds that each takes.
#
#     VEILOC_DATA=../shared/data scripts/first_minutes.sh [DIR]      DIR: default a temporary folder, removed at the end
#
# 1. the demo (build, then run)          2. own photos without poses: a map, its profile, a query, its pose
# 3. the Python example                  4. the page
# The photos are those of the place `fountain`; without VEILOC_DATA, the rendered images of the demo. Needs Rust, a C compiler, Python.
set -euo pipefail
root="$(cd "$(dirname "$0")/.." && pwd)"
work="${1:-$(mktemp -d)}"
[ -n "${1-}" ] || trap 'rm -rf "$work"' EXIT
data="${VEILOC_DATA:+$(realpath "$VEILOC_DATA")}"
unset VEILOC_DATA CARGO_TARGET_DIR CARGO_INCREMENTAL RUSTFLAGS
mkdir -p "$work"
cd "$work"
timed() {
    local name="$1" began=$SECONDS
    shift
    "$@" > "$work/log" 2>&1 || { cat "$work/log" >&2; echo "$name failed" >&2; exit 1; }
    echo "$name: $((SECONDS - began)) s"
}

git clone --quiet "$root" veiloc
cd veiloc
timed "build for the demo" cargo build --release
timed "demo" cargo run --release -- demo
[ -s out/demo/report.html ] || { echo "no report" >&2; exit 1; }

export PATH="$PWD/target/release:$PATH"
python3 -m venv "$work/venv"
timed "pip install pycolmap" "$work/venv/bin/pip" install --quiet pycolmap
mkdir "$work/photos"
if [ -n "$data" ]; then
    while read -r name; do cp "$data/fountain/images/$name" "$work/photos"; done < "$data/fountain/map.txt"
    query="$data/fountain/images/$(head -1 "$data/fountain/query.txt")"
else
    cp out/demo/images/map-*.png "$work/photos"
    query=out/demo/images/query-01.png
fi
timed "map of $(find "$work/photos" -type f | wc -l) photos without poses" \
    veiloc map build --images "$work/photos" --python "$work/venv/bin/python" -o "$work/place.vmap"
timed "profile" veiloc map profile "$work/place.vmap" -o "$work/place.profile"
timed "seal" veiloc seal "$query" --camera unknown --profile "$work/place.profile" -o "$work/photo.vquery"
veiloc localize --map "$work/place.vmap" "$work/photo.vquery" || [ $? -eq 4 ]

timed "pip install ./bindings/python" "$work/venv/bin/pip" install --quiet ./bindings/python
timed "Python example" "$work/venv/bin/python" examples/python/map_and_localize.py

rustup target add wasm32-unknown-unknown
timed "build the page" bindings/web/build.sh target/release
veiloc demo --page --listen 127.0.0.1:0 --out "$work/page" > "$work/page.log" 2>&1 &
page=$!
for _ in $(seq 600); do
    kill -0 $page 2> /dev/null || break
    address="$(grep -o 'http://127.0.0.1:[0-9]*' "$work/page.log" | head -1 || true)"
    if [ -n "$address" ] && curl -sf "$address/" > /dev/null; then break; fi
    sleep 0.5
done
kill -0 $page || { cat "$work/page.log" >&2; exit 1; }
curl -sf "$address/" | grep -q "veiloc" && echo "page: answers"
kill $page
