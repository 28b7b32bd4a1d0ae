#!/usr/bin/env bash
# A cluster on loopback: three nats-server, a folder as object store, workers, and a gateway that answers on 127.0.0.1:8080.
#
#     scripts/cluster.sh MAP.vmap [WORKERS]
#
# Splits the map into regions and publishes them; WORKERS (default 2) serve all regions with one thread each. Ctrl-C stops
# everything. Logs and store are in the folder that is printed at the end. Needs nats-server (Debian: nats-server) and a release
# build with the feature `cluster`. Variables: VEILOC: the program; IMAGES: most images per region; PORT: port of the gateway, the
# other ports follow it.
set -euo pipefail
here="$(cd "$(dirname "$0")/.." && pwd)"
[ $# -ge 1 ] || { sed -n '2,10s/^# \{0,1\}//p' "$0"; exit 2; }
map="$1" workers="${2:-2}" port="${PORT:-8080}"
veiloc="${VEILOC:-$here/target/release/veiloc}"
command -v nats-server > /dev/null || { echo "nats-server is missing: apt-get install nats-server" >&2; exit 1; }
[ -x "$veiloc" ] || { echo "$veiloc is missing: cargo build --release -p veiloc-cli --features cluster" >&2; exit 1; }

folder="$(mktemp -d -t veiloc-cluster-XXXXXX)"
pids=()
stop() {
    # Gateway and workers first, so that they finish their requests.
    for ((i = ${#pids[@]} - 1; i >= 0; i--)); do kill "${pids[i]}" 2> /dev/null || true; done
    wait
    echo "stopped; logs and store: $folder"
}
trap stop EXIT
trap 'exit 0' INT TERM

routes=""
for i in 0 1 2; do routes+="nats-route://127.0.0.1:$((port + 20 + i)),"; done
servers=""
for i in 0 1 2; do
    echo "max_payload: 8388608" > "$folder/nats-$i.conf"
    nats-server --config "$folder/nats-$i.conf" --addr 127.0.0.1 --port $((port + 10 + i)) --name "nats-$i" \
        --cluster_name veiloc --cluster "nats://127.0.0.1:$((port + 20 + i))" --routes "${routes%,}" \
        > "$folder/nats-$i.log" 2>&1 &
    pids+=($!)
    servers+="nats://127.0.0.1:$((port + 10 + i)),"
done
servers="${servers%,}"

"$veiloc" map split "$map" --name place --out "$folder/regions" ${IMAGES:+--images "$IMAGES"}
"$veiloc" map publish "$folder/regions" "$folder/store"

for ((i = 0; i < workers; i++)); do
    "$veiloc" worker --nats "$servers" --store "$folder/store" --cache "$folder/cache-$i" --map place --workers 1 \
        --admin-listen "127.0.0.1:$((port + 30 + i))" > "$folder/worker-$i.log" 2>&1 &
    pids+=($!)
done
"$veiloc" serve --cluster "$servers" --cluster-map place --store "$folder/store" --cache "$folder/cache-gateway" \
    --listen "127.0.0.1:$port" > "$folder/gateway.log" 2>&1 &
gateway=$!
pids+=("$gateway")
until curl -sf -o /dev/null "http://127.0.0.1:$port/readyz"; do
    kill -0 "$gateway" 2> /dev/null || { cat "$folder"/*.log >&2; exit 1; }
    sleep 0.2
done
echo "the map is served as place on http://127.0.0.1:$port (metrics on $((port + 1)), workers' from $((port + 30))); Ctrl-C stops it"
wait "$gateway"
