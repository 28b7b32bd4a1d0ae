#!/usr/bin/env python3
"""A log that nobody reads, whose reader has gone, or whose disk is full; and a client without token that fills a disk.

    VEILOC_DATA=../shared/data scripts/service/stuck_log.py [--veiloc PROGRAM]
"""

import os
import subprocess

from common import Place, Server, arguments, ask, header, row

REQUESTS = 3000


def outcome(server, patience=3.0):
    """Of so many requests, how many were answered before the first that was not; and how the service ended."""
    answered = 0
    while answered < REQUESTS and ask(server.port, "/v1/maps", timeout=patience)[0] == 200:
        answered += 1
    probe = ask(server.admin or server.port, "/healthz", timeout=patience)[0]
    code = server.stop(patience=10)
    return answered, probe or "none", "killed after 10 s" if code is None else f"exit {code}"


def main():
    place = Place(arguments(__doc__).parse_args().veiloc)
    header("stderr is", f"requests answered of {REQUESTS}", "`/healthz` then", "after SIGTERM")
    read, write = os.pipe()
    server = Server(place, "--log", "trace", stderr=write)
    row("a pipe that nobody reads", *outcome(server))
    os.close(read)
    os.close(write)
    read, write = os.pipe()
    server = Server(place, stderr=write)
    os.close(write)
    os.close(read)
    row("a pipe whose reader has gone", *outcome(server))
    with open("/dev/full", "w") as full:
        row("a full disk (/dev/full)", *outcome(Server(place, stderr=full)))
    print()
    server = Server(place, "--tokens", place.tokens(["phone"]))
    for _ in range(REQUESTS):
        ask(server.port, "/v1/maps", who="nobody")
    server.stop()
    header("requests with a wrong token", "bytes of log")
    row(REQUESTS, len(server.log()))


if __name__ == "__main__":
    main()
