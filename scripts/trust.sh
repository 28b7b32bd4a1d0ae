#!/usr/bin/env bash
# Prints the tables of docs/results/trust.md, with the command above each. Needs VEILOC_DATA. Part names choose parts.
#
#     VEILOC_DATA=../shared/data scripts/trust.sh [negatives] [stress] [focal] [coverage] [frames] [gravity] > trust.txt
#
# Maps and the rendered place go to OUT (default: a temporary folder).
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
    # Lines of progress are for whoever waits; a row that localizes nothing is a result too.
    { target/release/veiloc "$@" 2>&1 || [ $? -eq 1 ]; } | grep -vE '^[A-Z][A-Za-z ]+ [0-9]+/[0-9]+$' | sed "s|$out/||g"
}
# Names hold no spaces here, so that words may be split.
place() {
    echo "--posed $VEILOC_DATA/$1/posed --images $VEILOC_DATA/$1/images --map-list $VEILOC_DATA/$1/map.txt --query-list $VEILOC_DATA/$1/query.txt"
}
negatives() {
    echo "--negatives-posed $VEILOC_DATA/$1/posed --negatives-images $VEILOC_DATA/$1/images --negatives-list $VEILOC_DATA/$1/map.txt"
}
# The place of `veiloc demo`, with the same split: its hidden views are the queries.
rendered() {
    if [ ! -e "$out/demo/query.txt" ]; then
        target/release/veiloc demo --quiet --out "$out/demo" > /dev/null
        (cd "$out/demo/images" && printf '%s\n' map-*) > "$out/demo/map.txt"
        (cd "$out/demo/images" && printf '%s\n' query-*) > "$out/demo/query.txt"
    fi
    echo "--posed $out/demo/posed --images $out/demo/images --map-list $out/demo/map.txt --query-list $out/demo/query.txt"
}
# Lund door has no queries of its own: every third image is left out of the map.
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
        echo "# Images of elsewhere, in the half that nothing was chosen with"
        for name in redkitchen herzjesu; do
            veiloc map build --posed "$VEILOC_DATA/$name/posed" --images "$VEILOC_DATA/$name/images" \
                --list "$VEILOC_DATA/$name/map.txt" -o "$out/$name.vmap" --quiet > /dev/null
        done
        veiloc map import --model "$VEILOC_DATA/lund-door/sparse" --images "$VEILOC_DATA/lund-door/images" \
            -o "$out/lund-door.vmap" --quiet > /dev/null
        rendered > /dev/null
        cp "$out/demo/place.vmap" "$out/rendered.vmap"
        for name in redkitchen herzjesu lund-door rendered; do
            veiloc eval negatives --map "$out/$name.vmap" --images "$VEILOC_DATA/training-photos" --half final \
                --schemes points,random-lines,dcl
        done
        echo
        echo "# Queries of one place asked of the other one's map"
        veiloc eval scene $(place redkitchen) $(negatives herzjesu) --thresholds 0.05/5
        veiloc eval scene $(place herzjesu) $(negatives redkitchen) --thresholds 0.1/1
        ;;
    stress)
        echo "# Under stress"
        veiloc eval stress $(place redkitchen) --optimum
        veiloc eval stress $(place herzjesu) --optimum
        ;;
    focal)
        echo "# A wrong focal length that is called calibrated"
        veiloc eval stress $(place redkitchen) --stress focal-1,focal-3,focal-10,focal-30
        veiloc eval stress $(place herzjesu) --stress focal-1,focal-3,focal-10,focal-30
        ;;
    coverage)
        echo "# How often the truth lies where the covariances say"
        veiloc eval scene $(place redkitchen) --thresholds 0.05/5
        veiloc eval scene $(place herzjesu) --thresholds 0.1/1
        veiloc eval scene $(lund_door) --thresholds 0.1/1
        veiloc eval scene $(rendered) --thresholds 0.05/5
        ;;
    frames)
        echo "# Several images with simulated odometry"
        for stress in none half-hidden sparse-map; do
            veiloc eval rig $(place redkitchen) --stress $stress
        done
        ;;
    gravity)
        echo "# Gravity in the query"
        veiloc eval stress $(place redkitchen) --stress half-hidden,sparse-map
        veiloc eval stress $(place redkitchen) --stress half-hidden,sparse-map --gravity 0.5
        ;;
    *)
        echo "no part is called $part" >&2
        exit 2
        ;;
    esac
done
