#!/bin/bash
# Whether the service of this container takes queries: `/readyz` of the operator's listener answers 200.
# Bash alone, because the image has no other client of HTTP. Another port: PROBE_PORT.
set -euo pipefail
exec 3<> "/dev/tcp/127.0.0.1/${PROBE_PORT:-9100}"
printf 'GET /readyz HTTP/1.1\r\nhost: probe\r\nconnection: close\r\n\r\n' >&3
read -r -t 2 _ status _ <&3
[ "$status" = 200 ]
