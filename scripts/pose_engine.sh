#!/usr/bin/env bash
# Prints every table of research/notes/pose-engine.md, with the command above each. Needs VEILOC_DATA. Arguments select parts.
#
#     VEILOC_DATA=../shared/data scripts/pose_engine.sh [recipes] [speed] [gravity] [law] > pose_engine.txt
#
# `law` also writes docs/images/bound.svg. SEEDS and PROBLEMS set the amount of work.
set -euo pipefail
cd "$(dirname "$0")/.."
: "${VEILOC_DATA:?set VEILOC_DATA to the folder of the real photographs}"
seeds="${SEEDS:-5}"
problems="${PROBLEMS:-500}"
parts="${*:-recipes speed gravity law}"

cargo build --release --quiet
veiloc() {
    echo
    echo "\$ veiloc $*" | sed "s|$VEILOC_DATA|\$VEILOC_DATA|g"
    # Exit code 1 (nothing localized) is also a result.
    target/release/veiloc "$@" 2>&1 || [ $? -eq 1 ]
}
each_file() {
    for file in redkitchen_nn redkitchen_r08 herzjesu_nn herzjesu_r08; do
        case $file in redkitchen*) threshold=0.05/5 ;; *) threshold=0.1/1 ;; esac
        veiloc eval pose "$VEILOC_DATA/problems/$file.jsonl.gz" --seeds "$seeds" --thresholds $threshold "$@"
    done
}
for part in $parts; do
    case $part in
    recipes)
        echo "# Recipes with 100, 1000, 5000 hypotheses and with the stopping rule; the optimum and the lower bound"
        each_file --recipes paper,likelihood,likelihood+prior,vote,optimum --oracle --hypotheses 100,1000,5000,adaptive
        ;;
    speed)
        echo "# Default settings, one query at a time on one thread"
        each_file --recipes default
        ;;
    gravity)
        echo "# Gravity: without, exact, and with errors of 1 and 3 degrees"
        each_file --gravity none,0,1,3
        ;;
    law)
        echo "# Errors over the Cramér–Rao bound, and coverage of the covariance"
        mkdir -p docs/images
        veiloc eval crb --problems "$problems" --plot docs/images/bound.svg
        ;;
    *)
        echo "unknown part: $part" >&2
        exit 2
        ;;
    esac
done
