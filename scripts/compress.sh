#!/usr/bin/env bash
# Prints the tables of docs/results/scale.md: recall, median errors and trust against bytes per image, on both real scenes, and the
# results of out-of-map images in the compressed maps. Needs VEILOC_DATA.
#
#     VEILOC_DATA=../shared/data scripts/compress.sh [TIMES…] > compress.txt
#
# HALF=final uses the out-of-map images that no default was chosen with. NEGATIVES="10 20" runs out-of-map queries only for these
# ratios; they take most of the time. VEILOC=PROGRAM uses a program that is already built.
set -euo pipefail
cd "$(dirname "$0")/.."
: "${VEILOC_DATA:?set VEILOC_DATA to the folder of the real images}"
[ $# -gt 0 ] || set -- 1 3 5 10 15 20

veiloc="${VEILOC:-target/release/veiloc}"
[ -n "${VEILOC:-}" ] || cargo build --release --quiet
out="$(mktemp -d)"
trap 'rm -rf "$out"' EXIT

scene() {
    local name="$1" thresholds="$2"
    shift 2
    local folder="$VEILOC_DATA/$name"
    for times in "$@"; do
        local small=()
        [ "$times" = 1 ] || small=(--compress "$times")
        echo "\$ veiloc eval scene … ${small[*]} # $name"
        "$veiloc" eval scene --posed "$folder/posed" --images "$folder/images" --map-list "$folder/map.txt" \
            --query-list "$folder/query.txt" --schemes points,random-lines,coordinate-permutation,dcl \
            --thresholds "$thresholds" --work "$out/work-$name" --keep-map "$out/$name-$times.vmap" "${small[@]}" --json "$out/$name-$times.json" > /dev/null 2>&1
        [[ " ${NEGATIVES:-$*} " = *" $times "* ]] || continue
        echo "\$ veiloc eval negatives --map $name-$times.vmap --split design …"
        "$veiloc" eval negatives --map "$out/$name-$times.vmap" --images "$VEILOC_DATA/training-photos" --split "${HALF:-design}" \
            --schemes points,random-lines,coordinate-permutation,dcl --json "$out/$name-$times-negatives.json" > /dev/null 2>&1
    done
}

scene redkitchen 0.02/2,0.05/5 "$@"
scene herzjesu 0.1/2,0.25/5 "$@"

python3 - "$out" "$@" <<'PYTHON'
import json, sys
from pathlib import Path

def evidence(row):
    largest = row["log_evidence"]["100"]
    return "no pose" if largest is None else f"{largest:.1f}"


out, times = Path(sys.argv[1]), sys.argv[2:]
print("| scene | ratio | kB per image | points | scheme | trusted | wrong | median error | recall | negatives trusted | largest evidence of a negative |")
print("|---|--:|--:|--:|---|--:|--:|---|---|--:|--:|")
for scene in ("redkitchen", "herzjesu"):
    for t in times:
        result = json.loads((out / f"{scene}-{t}.json").read_text())
        negatives = out / f"{scene}-{t}-negatives.json"
        of_scheme = {row["scheme"]: row for row in json.loads(negatives.read_text())["rows"]} if negatives.exists() else {}
        size = result["map"]["bytes"] / result["map"]["images"] / 1e3
        for row in result["schemes"]:
            recall = ", ".join(f"{100 * share:.1f} % within {name}" for name, share in row["recall"].items())
            negative = of_scheme.get(row["scheme"])
            out_of_map = f'{negative["trusted"]} of {negative["negatives"]} | {evidence(negative)}' if negative else "not measured |"
            print(f'| {scene} | {t} | {size:.1f} | {result["map"]["points"]} | {row["scheme"]} | {row["trusted"]} of {row["queries"]} '
                  f'| {row["trusted_wrong"]} | {100 * row["median_translation"]:.2f} cm / {row["median_rotation_deg"]:.3f}° | {recall} '
                  f'| {out_of_map} |')
PYTHON
