#!/usr/bin/env bash
# Prints the tables of docs/results/scale.md: recall, medians and trust against bytes an image, on both real places, and what
# images of elsewhere get in the small maps. Needs VEILOC_DATA.
#
#     VEILOC_DATA=../shared/data scripts/compress.sh [TIMES…] > compress.txt
#
# HALF=final asks the images of elsewhere that nothing was chosen with; NEGATIVES="10 20" asks them in maps of these times
# alone, which is most of the hours that all take; VEILOC=PROGRAM takes a program that is built.
set -euo pipefail
cd "$(dirname "$0")/.."
: "${VEILOC_DATA:?set VEILOC_DATA to the folder of the real images}"
[ $# -gt 0 ] || set -- 1 3 5 10 15 20

veiloc="${VEILOC:-target/release/veiloc}"
[ -n "${VEILOC:-}" ] || cargo build --release --quiet
out="$(mktemp -d)"
trap 'rm -rf "$out"' EXIT

place() {
    local name="$1" thresholds="$2"
    shift 2
    local place="$VEILOC_DATA/$name"
    for times in "$@"; do
        local small=()
        [ "$times" = 1 ] || small=(--compress "$times")
        echo "\$ veiloc eval scene … ${small[*]} # $name"
        "$veiloc" eval scene --posed "$place/posed" --images "$place/images" --map-list "$place/map.txt" \
            --query-list "$place/query.txt" --schemes points,random-lines,coordinate-permutation,dcl \
            --thresholds "$thresholds" --work "$out/work-$name" --keep-map "$out/$name-$times.vmap" "${small[@]}" --json "$out/$name-$times.json" > /dev/null 2>&1
        [[ " ${NEGATIVES:-$*} " = *" $times "* ]] || continue
        echo "\$ veiloc eval negatives --map $name-$times.vmap --half design …"
        "$veiloc" eval negatives --map "$out/$name-$times.vmap" --images "$VEILOC_DATA/training-photos" --half "${HALF:-design}" \
            --schemes points,random-lines,coordinate-permutation,dcl --json "$out/$name-$times-negatives.json" > /dev/null 2>&1
    done
}

place redkitchen 0.02/2,0.05/5 "$@"
place herzjesu 0.1/2,0.25/5 "$@"

python3 - "$out" "$@" <<'PYTHON'
import json, sys
from pathlib import Path

def evidence(row):
    most = row["log_evidence"]["100"]
    return "no pose" if most is None else f"{most:.1f}"


out, times = Path(sys.argv[1]), sys.argv[2:]
print("| place | times | kB an image | points | scheme | trusted | wrong | median error | recall | negatives trusted | strongest evidence of one |")
print("|---|--:|--:|--:|---|--:|--:|---|---|--:|--:|")
for place in ("redkitchen", "herzjesu"):
    for t in times:
        scene = json.loads((out / f"{place}-{t}.json").read_text())
        asked = out / f"{place}-{t}-negatives.json"
        of_scheme = {row["scheme"]: row for row in json.loads(asked.read_text())["rows"]} if asked.exists() else {}
        size = scene["map"]["bytes"] / scene["map"]["images"] / 1e3
        for row in scene["schemes"]:
            recall = ", ".join(f"{100 * share:.1f} % within {name}" for name, share in row["recall"].items())
            strange = of_scheme.get(row["scheme"])
            elsewhere = f'{strange["trusted"]} of {strange["negatives"]} | {evidence(strange)}' if strange else "not asked |"
            print(f'| {place} | {t} | {size:.1f} | {scene["map"]["points"]} | {row["scheme"]} | {row["trusted"]} of {row["queries"]} '
                  f'| {row["trusted_wrong"]} | {100 * row["median_translation"]:.2f} cm / {row["median_rotation_deg"]:.3f}° | {recall} '
                  f'| {elsewhere} |')
PYTHON
