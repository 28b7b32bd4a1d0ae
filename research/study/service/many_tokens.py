#!/usr/bin/env python3
"""Cost of the token lookup: time of a request with 1 token in the file, and with 30 000.

    VEILOC_DATA=../shared/data research/study/service/many_tokens.py [--requests 5000]

One loopback connection, requests one after the other. The token is the last one of the file. The two services take turns, so
that other load on the machine affects both. Prints the rows of docs/results/service.md.
"""

import hashlib
import http.client
import secrets
import statistics
import time

import common

COUNTS = [1, 30_000]


def ask(connection, token):
    begun = time.perf_counter()
    connection.request("GET", "/v1/maps", headers={"authorization": f"Bearer {token}"})
    response = connection.getresponse()
    response.read()
    assert response.status == 200, response.status
    return 1e3 * (time.perf_counter() - begun)


def main():
    parser = common.arguments(__doc__)
    parser.add_argument("--requests", type=int, default=5000, help="requests to each service")
    arguments = parser.parse_args()
    scene = common.RedKitchen(arguments.veiloc)
    services = []
    for count in COUNTS:
        tokens = [secrets.token_hex(32) for _ in range(count)]
        file = scene.work / f"tokens-{count}"
        file.write_text("".join(f"t{i} {hashlib.sha256(t.encode()).hexdigest()}\n" for i, t in enumerate(tokens)))
        server = common.Server(scene, "--tokens", file)
        connection = http.client.HTTPConnection("127.0.0.1", server.port)
        services.append((count, server, connection, tokens[-1], []))
    for i in range(arguments.requests):
        for _, _, connection, token, times in services:
            took = ask(connection, token)
            if i >= arguments.requests // 10:
                times.append(took)
    for count, server, _, _, times in services:
        common.row(count, f"{statistics.median(times):.2f}", f"{statistics.quantiles(times, n=100)[98]:.2f}")
        server.stop()


if __name__ == "__main__":
    main()
