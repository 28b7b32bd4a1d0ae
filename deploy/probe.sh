#!/bin/bash
# Health check: succeeds if `/readyz` of the admin listener returns 200.
# Plain bash, because the image has no HTTP client. PROBE_PORT sets another port.
set -euo pipefail
exec 3<> "/dev/tcp/127.0.0.1/${PROBE_PORT:-9100}"
printf 'GET /readyz HTTP/1.1\r\nhost: probe\r\nconnection: close\r\n\r\n' >&3
read -r -t 2 _ status _ <&3
[ "$status" = 200 ]
