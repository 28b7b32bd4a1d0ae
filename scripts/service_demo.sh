#!/usr/bin/env bash
# Prints a transcript of setting up a service: map, certificate, token, `veiloc serve`, one query, and curl on the other resources.
#
#     VEILOC_DATA=../shared/data scripts/service_demo.sh
#
# VEILOC=PROGRAM uses a program that is already built.
set -euo pipefail
cd "$(dirname "$0")/.."
: "${VEILOC_DATA:?set VEILOC_DATA to the folder of the real photographs}"

if [ -n "${VEILOC:-}" ]; then
    bin="$(cd "$(dirname "$VEILOC")" && pwd)"
else
    cargo build --release --quiet
    bin="$(cargo metadata --format-version 1 --no-deps | sed 's/.*"target_directory":"\([^"]*\)".*/\1/')/release"
fi
PATH="$bin:$PATH"
scene="$(cd "$VEILOC_DATA/redkitchen" && pwd)"
work="$(mktemp -d)"
server=
trap '[ -z "$server" ] || kill "$server" 2>/dev/null || true; rm -rf "$work"' EXIT
cd "$work"
ln -s "$scene" redkitchen

show() {
    echo
    echo "\$ $*"
    eval "$*"
}

show veiloc --quiet map build --posed redkitchen/posed --images redkitchen/images --list redkitchen/map.txt -o redkitchen.vmap
show "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -keyout key.pem -out cert.pem -days 30 \
-subj /CN=localhost -addext subjectAltName=DNS:localhost,IP:127.0.0.1 -addext basicConstraints=critical,CA:FALSE 2>openssl.log"
show "veiloc token new phone --tokens tokens --days 30 --out phone.token"
show "veiloc --quiet token new operator --operator --tokens tokens > operator.token"
show "veiloc token list --tokens tokens"
show "cut -c1-24 tokens"

echo
echo "\$ veiloc serve --map kitchen=redkitchen.vmap --cert cert.pem --key key.pem --tokens tokens &"
: > server.log
veiloc serve --map kitchen=redkitchen.vmap --listen 127.0.0.1:0 --cert cert.pem --key key.pem --tokens tokens 2> server.log &
server=$!
until grep -q '^serving' server.log; do
    kill -0 "$server" 2>/dev/null || { cat server.log; exit 1; }
    sleep 0.1
done
cat server.log
port="$(sed -n 's/^serving.*:\([0-9]*\)$/\1/p' server.log)"
url="https://localhost:$port"
camera="$(grep -v '^#' redkitchen/posed/cameras.txt | head -1 | cut -d' ' -f2- | tr ' ' ,)"
photo="redkitchen/images/$(grep -v '^#' redkitchen/query.txt | head -1 | cut -d' ' -f1)"

show veiloc query send "$photo" --camera "$camera" --server "$url" --map kitchen --ca cert.pem --token-file phone.token --cache cache
show "veiloc --quiet query send $photo --camera $camera --server $url --map kitchen --ca cert.pem \
    --token-file phone.token --cache cache --json | tr -d ' \n' | cut -c1-300"
show "curl -s --cacert cert.pem $url/healthz"
show "curl -s --cacert cert.pem $url/readyz"
show "curl -s --cacert cert.pem -H \"authorization: Bearer \$(cat phone.token)\" $url/v1/maps"
echo
show "curl -s --cacert cert.pem $url/v1/maps | tr -s ' '"
echo
show "curl -s --cacert cert.pem $url/v1/openapi.json | grep -E '^    \"/'"
show "curl -s --cacert cert.pem -H \"authorization: Bearer \$(cat operator.token)\" $url/metrics | grep -E '^veiloc_(requests_total|localizations|request_seconds_count|queue)' | grep -v ' 0\$'"
echo
echo "\$ kill -TERM $server"
kill -TERM "$server"
wait "$server"
server=
show tail -3 server.log
