#!/usr/bin/env bash
# Prints the load table of docs/results/service.md: dcl with 1024 keypoints on RedKitchen's map, one worker per core, queue of 32.
#
#     VEILOC_DATA=../shared/data scripts/service_load.sh
set -euo pipefail
cd "$(dirname "$0")/.."
: "${VEILOC_DATA:?set VEILOC_DATA to the folder of the real photographs}"

cargo build --release --quiet -p veiloc-cli
cargo build --release --quiet -p veiloc-service --example load
bin="$(cargo metadata --format-version 1 --no-deps | sed 's/.*"target_directory":"\([^"]*\)".*/\1/')/release"
scene="$VEILOC_DATA/redkitchen"
work="$(mktemp -d)"
server=
trap '[ -z "$server" ] || kill "$server" 2>/dev/null || true; rm -rf "$work"' EXIT

"$bin/veiloc" --quiet map build --posed "$scene/posed" --images "$scene/images" --list "$scene/map.txt" \
    --query-keypoints 1024 -o "$work/place.vmap"
"$bin/veiloc" --quiet map profile "$work/place.vmap" -o "$work/profile"
camera="$(grep -v '^#' "$scene/posed/cameras.txt" | head -1 | cut -d' ' -f2- | tr ' ' ,)"
photo="$scene/images/$(grep -v '^#' "$scene/query.txt" | head -1 | cut -d' ' -f1)"
"$bin/veiloc" seal "$photo" --camera "$camera" --profile "$work/profile" --scheme dcl -o "$work/query"

: > "$work/log"
"$bin/veiloc" serve --map place="$work/place.vmap" --listen 127.0.0.1:0 --queue 32 --rate 1000000 --answer-quantum 0 --log error 2> "$work/log" &
server=$!
until grep -q '^serving' "$work/log"; do
    kill -0 "$server" 2>/dev/null || { cat "$work/log"; exit 1; }
    sleep 0.1
done
address="$(sed -n 's/^serving.*\/\///p' "$work/log")"
"$bin/examples/load" "$address" place "$work/query" 1 4 16 64
curl -s "http://$address/metrics" | grep -E '^veiloc_(requests_total|localizations|queue_length|workers_busy)' | grep -v ' 0$'
kill -TERM "$server"
wait "$server"
server=
