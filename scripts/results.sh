#!/usr/bin/env bash
# Prints tables of docs/results/poses.md and the coverage of docs/results/trust.md, with the command above each. Needs VEILOC_DATA.
#
#     VEILOC_DATA=../shared/data scripts/results.sh > results.txt
set -euo pipefail
cd "$(dirname "$0")/.."
: "${VEILOC_DATA:?set VEILOC_DATA to the folder of the real images}"

cargo build --release --quiet
veiloc() {
    echo
    echo "\$ veiloc $*" | sed "s|$VEILOC_DATA|\$VEILOC_DATA|g"
    # Leave out progress lines.
    target/release/veiloc "$@" 2>&1 | grep -vE '^[A-Z][A-Za-z ]+ [0-9]+/[0-9]+$'
}
scene() {
    local folder="$VEILOC_DATA/$1"
    shift
    veiloc eval scene --posed "$folder/posed" --images "$folder/images" \
        --map-list "$folder/map.txt" --query-list "$folder/query.txt" "$@"
}
all=points,random-lines,coordinate-permutation,dcl

echo "# Scenes"
scene redkitchen --schemes $all --thresholds 0.02/2,0.05/5
scene herzjesu --schemes $all --thresholds 0.1/2,0.25/5
scene herzjesu --schemes $all --thresholds 0.1/2,0.25/5 --query-keypoints 4096

echo
echo "# Both scores for dcl with the same number of hypotheses, without the match prior"
scene redkitchen --schemes dcl --scores msac,likelihood --hypotheses 1000 --no-prior --thresholds 0.05/5
scene herzjesu --schemes dcl --scores msac,likelihood --hypotheses 1000 --no-prior --thresholds 0.1/2,0.25/5

out="$(mktemp -d)"
trap 'rm -rf "$out"' EXIT

echo
echo "# The paper's ablations"
for name in redkitchen herzjesu; do
    scene $name --schemes points,random-lines,dcl,dcl:s=2,dcl:s=3,dcl:horizontal --json "$out/$name.json" > /dev/null
    veiloc eval tables "$out/$name.json" | sed "s|$out/||g"
    for other in dcl:s=2 dcl:s=3 dcl:horizontal; do
        veiloc eval compare "$out/$name.json" "$out/$name.json" --row dcl --against $other | sed "s|$out/||g"
    done
done

echo
echo "# A rendered scene in the layout of each dataset"
for layout in 7scenes cambridge aachen aachen-v1.1; do
    veiloc synth export --layout $layout --out "$out/$layout" | sed "s|$out/||g"
    truth=()
    case $layout in aachen*) truth=(--truth "$out/$layout/queries/poses.txt") ;; esac
    veiloc eval ${layout%-v1.1} --root "$out/$layout" --jobs 1 "${truth[@]}" | sed "s|$out/||g"
done

echo
echo "# An imported COLMAP model"
veiloc map import --model "$VEILOC_DATA/lund-door/sparse" --images "$VEILOC_DATA/lund-door/images" -o "$out/lund.vmap" \
    | sed "s|$out/||g"

echo
echo "# One thread"
RAYON_NUM_THREADS=1 scene redkitchen --schemes points,dcl --thresholds 0.05/5
