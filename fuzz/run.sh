#!/usr/bin/env bash
# Runs every fuzz target for a number of seconds and prints executions, coverage and findings.
# Save findings in fuzz/regressions/TARGET/; fuzz/tests/seeds.rs runs them as regression tests.
#
#     cargo install cargo-fuzz
#     rustup toolchain install nightly
#     CSV=docs/results/service/fuzz.csv fuzz/run.sh 120 [TARGET…]
#
# CSV: also write the table to this file.
set -euo pipefail
csv="$(realpath "${CSV:-/dev/null}")"
cd "$(dirname "$0")"
seconds="${1:-60}"
corpus="$(mktemp -d)"
trap 'rm -rf "$corpus"' EXIT

# Seeds: the committed known-answer files.
mkdir "$corpus"/{sealed_query,profile,answer,map_file,colmap,tokens,manifest,index}
cp ../crates/core/protocol/tests/data/*.vquery "$corpus/sealed_query/"
cp ../crates/core/protocol/tests/data/*.profile "$corpus/profile/"
cp ../crates/core/protocol/tests/data/*.answer "$corpus/answer/"
cp ../crates/server/map/tests/data/map*.bin "$corpus/map_file/"
cp ../crates/server/service/tests/data/auth/*.tokens "$corpus/tokens/"
cp ../crates/server/map/tests/data/regions/manifest/*.json "$corpus/manifest/"
cp ../crates/server/map/tests/data/regions/index/*.index "$corpus/index/"
for kind in txt:T bin:O; do # the last bit of the first byte selects text or binary
    for folder in $(find ../crates/server/map/tests/data/colmap -name "cameras.${kind%:*}" -exec dirname {} \;); do
        {
            printf '%s' "${kind#*:}" | tr TO '01'
            cat "$folder/cameras.${kind%:*}"; printf '\n====\n'
            cat "$folder/images.${kind%:*}"; printf '\n====\n'
            cat "$folder/points3D.${kind%:*}"
        } > "$corpus/colmap/$(basename "$folder").${kind%:*}"
    done
done

echo "target,time (s),executions,edges,peak memory (MB),findings" | tee "$csv"
shift || true
[ $# -gt 0 ] || set -- sealed_query profile answer map_file colmap tokens manifest index
for target in "$@"; do
    log="$corpus/$target.log"
    findings=0
    cargo +nightly fuzz run --features fuzzer "$target" "$corpus/$target" -- -max_total_time="$seconds" -rss_limit_mb=1024 \
        -malloc_limit_mb=256 -timeout=10 -print_final_stats=1 > "$log" 2>&1 || findings=1
    if [ "$findings" = 1 ]; then tail -40 "$log" | cut -c1-300 >&2; fi
    executions="$(sed -n 's/^stat::number_of_executed_units: *//p' "$log")"
    memory="$(sed -n 's/^stat::peak_rss_mb: *//p' "$log")"
    edges="$(grep -o 'cov: [0-9]*' "$log" | tail -1 | cut -d' ' -f2)"
    echo "$target,$seconds,$executions,$edges,$memory,$findings" | tee -a "$csv"
done
