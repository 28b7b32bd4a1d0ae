#!/usr/bin/env bash
# Writes correspondence sets of map images, each held out once, on which priors and defaults are chosen. Query lists stay unused, for
# the final results. For each set also writes all keypoints of the same images with descriptors, for `attack` and for training.
# Needs VEILOC_DATA and a release build.
#
#     VEILOC_DATA=../shared/data scripts/training_problems.sh FOLDER [FEATURES [ARGUMENT…]]
#
# FEATURES as for `veiloc map build --features` (default: sift). Further arguments, such as `--engine onnxruntime`, go to
# `veiloc eval problems`.
set -euo pipefail
cd "$(dirname "$0")/.."
: "${VEILOC_DATA:?set VEILOC_DATA to the folder of the real photographs}"
out="${1:?give the output folder}"
features="${2:-sift}"
more=("${@:3}")
veiloc="${VEILOC:-target/release/veiloc}"
mkdir -p "$out"
lists="$(mktemp -d)"
trap 'rm -rf "$lists"' EXIT

# Holds out every third block of `block` consecutive images, fold after fold.
folds() {
    local name="$1" posed="$2" images="$3" names="$4" block="$5"
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
    gzip -9n < "$lists/all" > "$out/$name.jsonl.gz"
    gzip -9n < "$lists/keypoints" > "$out/${name}_keypoints.jsonl.gz"
    echo "$out/$name.jsonl.gz: $(wc -l < "$lists/all") problems"
}

find "$VEILOC_DATA/lund-door/images" -type f -printf '%f\n' | sort > "$lists/lund"
folds lund-door "$VEILOC_DATA/lund-door/sparse" "$VEILOC_DATA/lund-door/images" "$lists/lund" 1
for scene in redkitchen herzjesu; do
    block=1
    [ "$scene" = redkitchen ] && block=4
    folds "$scene" "$VEILOC_DATA/$scene/posed" "$VEILOC_DATA/$scene/images" "$VEILOC_DATA/$scene/map.txt" "$block"
done
