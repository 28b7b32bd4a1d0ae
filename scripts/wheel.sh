#!/usr/bin/env bash
# Builds the wheel for users with the release profile, and tests it in a new environment without Rust on the PATH.
#
#     scripts/wheel.sh [DIR]        DIR: folder for the wheel (default: `wheels` in the target folder)
#
# Tests the import, the program's version, and examples/python/map_and_localize.py, which maps a rendered room and localizes images in
# it. CI tests a wheel of the dev profile (`.ci/run python`), because this build takes as long as all crates.
set -euo pipefail
here="$(cd "$(dirname "$0")/.." && pwd)"
wheels="$(realpath -m "${1:-${CARGO_TARGET_DIR:-$here/target}/wheels}")"
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
cd "$work"

python3 -m venv build
began=$SECONDS
build/bin/pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir "$work/made" \
    --config-settings build-args="--profile=release --locked --features=full" "$here/bindings/python"
mkdir -p "$wheels"
wheel="$wheels/$(basename "$work"/made/veiloc-*.whl)"
mv "$work"/made/veiloc-*.whl "$wheel"
echo "$wheel: $(wc -c < "$wheel") bytes, built in $((SECONDS - began)) s"

python3 -m venv tried
tried/bin/pip install --quiet --disable-pip-version-check "$wheel"
export PATH="$work/tried/bin:/usr/bin:/bin"
for tool in cargo rustc; do
    ! command -v "$tool" || { echo "$tool is on the PATH, so this test would prove nothing" >&2; exit 1; }
done
veiloc --version
python -c 'import time; t = time.perf_counter(); import veiloc; print(f"imported in {1e3 * (time.perf_counter() - t):.0f} ms, with numpy")'
python "$here/examples/python/map_and_localize.py" | tee localized
[ "$(grep -c '^query.* trusted' localized)" -ge 2 ] || { echo "fewer than two images were localized" >&2; exit 1; }
