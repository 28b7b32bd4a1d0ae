#!/usr/bin/env bash
# Prints every table of docs/results.md, with the command above each. Needs VEILOC_DATA.
#
#     VEILOC_DATA=../shared/data scripts/results.sh > results.txt
set -euo pipefail
cd "$(dirname "$0")/.."
: "${VEILOC_DATA:?set VEILOC_DATA to the folder of the real photographs}"

cargo build --release --quiet
veiloc() {
    echo
    echo "\$ veiloc $*" | sed "s|$VEILOC_DATA|\$VEILOC_DATA|g"
    # Lines of progress are for whoever waits.
    target/release/veiloc "$@" 2>&1 | grep -vE '^[A-Z][A-Za-z ]+ [0-9]+/[0-9]+$'
}
scene() {
    local place="$VEILOC_DATA/$1"
    shift
    veiloc eval scene --posed "$place/posed" --images "$place/images" \
        --map-list "$place/map.txt" --query-list "$place/query.txt" "$@"
}
all=points,random-lines,coordinate-permutation,dcl

echo "# Scenes"
scene redkitchen --schemes $all --thresholds 0.02/2,0.05/5
scene herzjesu --schemes $all --thresholds 0.1/2,0.25/5
scene herzjesu --schemes $all --thresholds 0.1/2,0.25/5 --query-keypoints 4096

echo
echo "# The collapse: both scores for dcl at equal hypotheses, without the prior of the matches"
scene redkitchen --schemes dcl --scores msac,likelihood --hypotheses 1000 --no-prior --thresholds 0.05/5
scene herzjesu --schemes dcl --scores msac,likelihood --hypotheses 1000 --no-prior --thresholds 0.1/2,0.25/5

echo
echo "# An imported COLMAP model"
out="$(mktemp -d)"
trap 'rm -rf "$out"' EXIT
veiloc map import --model "$VEILOC_DATA/lund-door/sparse" --images "$VEILOC_DATA/lund-door/images" -o "$out/lund.vmap" \
    | sed "s|$out/||g"

echo
echo "# One thread"
RAYON_NUM_THREADS=1 scene redkitchen --schemes points,dcl --thresholds 0.05/5
