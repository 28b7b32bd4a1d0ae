#!/usr/bin/env bash
# Prints every table of docs/results/trust.md, with the command above each. Needs VEILOC_DATA. Arguments select parts.
#
#     VEILOC_DATA=../shared/data scripts/trust.sh [negatives] [stress] [focal] [coverage] [frames] [gravity] > trust.txt
#
# OUT: folder for maps and the rendered scene (default: a temporary folder).
set -euo pipefail
cd "$(dirname "$0")/.."
: "${VEILOC_DATA:?set VEILOC_DATA to the folder of the real photographs}"
parts="${*:-negatives stress focal coverage frames gravity}"
out="${OUT:-$(mktemp -d)}"
[ -n "${OUT:-}" ] || trap 'rm -rf "$out"' EXIT

cargo build --release --quiet
veiloc() {
    echo
    echo "\$ veiloc $*" | sed "s|$VEILOC_DATA|\$VEILOC_DATA|g; s|$out/||g"
    # Leave out progress lines; exit code 1 (nothing localized) is also a result.
    { target/release/veiloc "$@" 2>&1 || [ $? -eq 1 ]; } | grep -vE '^[A-Z][A-Za-z ]+ [0-9]+/[0-9]+$' | sed "s|$out/||g"
}
# The names hold no spaces, so word splitting is safe.
scene() {
    echo "--posed $VEILOC_DATA/$1/posed --images $VEILOC_DATA/$1/images --map-list $VEILOC_DATA/$1/map.txt --query-list $VEILOC_DATA/$1/query.txt"
}
negatives() {
    echo "--negatives-posed $VEILOC_DATA/$1/posed --negatives-images $VEILOC_DATA/$1/images --negatives-list $VEILOC_DATA/$1/map.txt"
}
# The scene of `veiloc demo`, with the same split: its query images are the queries.
rendered() {
    if [ ! -e "$out/demo/query.txt" ]; then
        target/release/veiloc demo --quiet --out "$out/demo" > /dev/null
        (cd "$out/demo/images" && printf '%s\n' map-*) > "$out/demo/map.txt"
        (cd "$out/demo/images" && printf '%s\n' query-*) > "$out/demo/query.txt"
    fi
    echo "--posed $out/demo/posed --images $out/demo/images --map-list $out/demo/map.txt --query-list $out/demo/query.txt"
}
# Lund door has no query images: every third image is left out of the map and used as a query.
lund_door() {
    local images="$VEILOC_DATA/lund-door/images"
    (cd "$images" && printf '%s\n' *) | awk 'NR % 3 == 2' > "$out/lund-query.txt"
    (cd "$images" && printf '%s\n' *) | awk 'NR % 3 != 2' > "$out/lund-map.txt"
    echo "--posed $VEILOC_DATA/lund-door/sparse --images $images --map-list $out/lund-map.txt --query-list $out/lund-query.txt"
}

# shellcheck disable=SC2046
for part in $parts; do
    case $part in
    negatives)
        echo "# Out-of-map images, in the half that no default was chosen with"
        for name in redkitchen herzjesu; do
            veiloc map build --posed "$VEILOC_DATA/$name/posed" --images "$VEILOC_DATA/$name/images" \
                --list "$VEILOC_DATA/$name/map.txt" -o "$out/$name.vmap" --quiet > /dev/null
        done
        veiloc map import --model "$VEILOC_DATA/lund-door/sparse" --images "$VEILOC_DATA/lund-door/images" \
            -o "$out/lund-door.vmap" --quiet > /dev/null
        rendered > /dev/null
        cp "$out/demo/place.vmap" "$out/rendered.vmap"
        for name in redkitchen herzjesu lund-door rendered; do
            veiloc eval negatives --map "$out/$name.vmap" --images "$VEILOC_DATA/training-photos" --split final \
                --schemes points,random-lines,dcl
        done
        echo
        echo "# Queries of each scene in the map of the other scene"
        veiloc eval scene $(scene redkitchen) $(negatives herzjesu) --thresholds 0.05/5
        veiloc eval scene $(scene herzjesu) $(negatives redkitchen) --thresholds 0.1/1
        ;;
    stress)
        echo "# Under stress"
        veiloc eval stress $(scene redkitchen) --optimum
        veiloc eval stress $(scene herzjesu) --optimum
        ;;
    focal)
        echo "# A wrong focal length that is declared as calibrated"
        veiloc eval stress $(scene redkitchen) --stress focal-1,focal-3,focal-10,focal-30
        veiloc eval stress $(scene herzjesu) --stress focal-1,focal-3,focal-10,focal-30
        ;;
    coverage)
        echo "# Coverage of the covariances"
        veiloc eval scene $(scene redkitchen) --thresholds 0.05/5
        veiloc eval scene $(scene herzjesu) --thresholds 0.1/1
        veiloc eval scene $(lund_door) --thresholds 0.1/1
        veiloc eval scene $(rendered) --thresholds 0.05/5
        ;;
    frames)
        echo "# Several images with simulated odometry"
        for stress in none half-hidden sparse-map; do
            veiloc eval rig $(scene redkitchen) --stress $stress
        done
        ;;
    gravity)
        echo "# Gravity in the query"
        veiloc eval stress $(scene redkitchen) --stress half-hidden,sparse-map
        veiloc eval stress $(scene redkitchen) --stress half-hidden,sparse-map --gravity 0.5
        ;;
    *)
        echo "unknown part: $part" >&2
        exit 2
        ;;
    esac
done
