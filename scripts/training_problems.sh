#!/usr/bin/env bash
# Correspondence sets of map images alone, each held out once: what priors and defaults are chosen on. Query lists stay
# untouched, so that they are fit for the final figures. Beside each, all keypoints of the same images with descriptors,
# as `attack` and the training of predictors read them. Needs VEILOC_DATA and a release build.
#
#     VEILOC_DATA=../shared/data scripts/training_problems.sh FOLDER [FEATURES [ARGUMENT…]]
#
# FEATURES as `veiloc map build --features` takes them; default sift. Further arguments go to `veiloc eval problems`, as
# `--engine onnxruntime`.
set -euo pipefail
cd "$(dirname "$0")/.."
: "${VEILOC_DATA:?set VEILOC_DATA to the folder of the real photographs}"
out="${1:?name the folder the problems go to}"
features="${2:-sift}"
more=("${@:3}")
veiloc="${VEILOC:-target/release/veiloc}"
mkdir -p "$out"
lists="$(mktemp -d)"
trap 'rm -rf "$lists"' EXIT

# Holds out every third block of so many neighbours, fold after fold.
folds() {
    local place="$1" posed="$2" images="$3" names="$4" block="$5"
    : > "$lists/all"
    : > "$lists/keypoints"
    for fold in 0 1 2; do
        awk -v b="$block" -v f="$fold" 'int((NR - 1) / b) % 3 == f' "$names" > "$lists/query"
        awk -v b="$block" -v f="$fold" 'int((NR - 1) / b) % 3 != f' "$names" > "$lists/map"
        "$veiloc" -q eval problems --features "$features" --posed "$posed" --images "$images" \
            --map-list "$lists/map" --query-list "$lists/query" -o "$lists/fold.jsonl" \
            --keypoints "$lists/fold_keypoints.jsonl" "${more[@]}"
        cat "$lists/fold.jsonl" >> "$lists/all"
        cat "$lists/fold_keypoints.jsonl" >> "$lists/keypoints"
    done
    gzip -9n < "$lists/all" > "$out/$place.jsonl.gz"
    gzip -9n < "$lists/keypoints" > "$out/${place}_keypoints.jsonl.gz"
    echo "$out/$place.jsonl.gz: $(wc -l < "$lists/all") problems"
}

find "$VEILOC_DATA/lund-door/images" -type f -printf '%f\n' | sort > "$lists/lund"
folds lund-door "$VEILOC_DATA/lund-door/sparse" "$VEILOC_DATA/lund-door/images" "$lists/lund" 1
for place in redkitchen herzjesu; do
    block=1
    [ "$place" = redkitchen ] && block=4
    folds "$place" "$VEILOC_DATA/$place/posed" "$VEILOC_DATA/$place/images" "$VEILOC_DATA/$place/map.txt" "$block"
done
