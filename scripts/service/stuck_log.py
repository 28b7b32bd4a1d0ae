#!/usr/bin/env python3
"""Logs to a pipe without a reader, a closed pipe or a full disk; and an unauthenticated client that tries to fill the log.

    VEILOC_DATA=../shared/data scripts/service/stuck_log.py [--veiloc PROGRAM]
"""

import os

from common import RedKitchen, Server, arguments, ask, header, row

REQUESTS = 3000


def outcome(server, timeout=3.0):
    """The number of requests answered before the first failure, the health probe after it, and how the service ended."""
    answered = 0
    while answered < REQUESTS and ask(server.port, "/v1/maps", timeout=timeout)[0] == 200:
        answered += 1
    probe = ask(server.admin or server.port, "/healthz", timeout=timeout)[0]
    code = server.stop(timeout=10)
    return answered, probe or "none", "killed after 10 s" if code is None else f"exit {code}"


def main():
    scene = RedKitchen(arguments(__doc__).parse_args().veiloc)
    header("stderr is", f"requests answered of {REQUESTS}", "`/healthz` then", "after SIGTERM")
    read, write = os.pipe()
    server = Server(scene, "--log", "trace", stderr=write)
    row("a pipe without a reader", *outcome(server))
    os.close(read)
    os.close(write)
    read, write = os.pipe()
    server = Server(scene, stderr=write)
    os.close(write)
    os.close(read)
    row("a closed pipe", *outcome(server))
    with open("/dev/full", "w") as full:
        row("a full disk (/dev/full)", *outcome(Server(scene, stderr=full)))
    print()
    server = Server(scene, "--tokens", scene.tokens(["phone"]))
    for _ in range(REQUESTS):
        ask(server.port, "/v1/maps", user="unknown")
    server.stop()
    header("requests with a wrong token", "bytes of log")
    row(REQUESTS, len(server.log()))


if __name__ == "__main__":
    main()
