#!/usr/bin/env python3
"""One token sends queries of 4096 rows at its rate limit of 20 per second while another token behaves like a phone; prints which
queries are answered.

    VEILOC_DATA=../shared/data scripts/service/greedy_token.py [--veiloc PROGRAM]
"""

import socket
import threading
import time

from common import LOCALIZE, PROTOBUF, RedKitchen, Server, arguments, ask, header, row, token, wait_for

VICTIM = 20


def main():
    scene = RedKitchen(arguments(__doc__).parse_args().veiloc)
    path = scene.tokens(["greedy", "phone", "ops!"])
    server = Server(scene, "--tokens", path)
    victim(scene, server, "quiet")
    stop, counts, lock = threading.Event(), {}, threading.Lock()

    def flood(i):
        while not stop.is_set():
            started = time.monotonic()
            status, _, _ = ask(server.port, LOCALIZE, scene.large, "greedy", timeout=60)
            with lock:
                counts[status] = counts.get(status, 0) + 1
            # 40 clients send 20 queries per second in total.
            time.sleep(max(0.0, 2.0 - (time.monotonic() - started)))

    threads = [threading.Thread(target=flood, args=(i,), daemon=True) for i in range(40)]
    for thread in threads:
        thread.start()
        time.sleep(0.05)
    time.sleep(5)
    victim(scene, server, "one token floods the service")
    stop.set()
    for thread in threads:
        thread.join(60)
    print()
    header("answers to the flooding token", *sorted(map(str, counts)))
    row("", *(counts[key] for key in sorted(counts, key=str)))
    print()
    disconnected(scene, server)
    server.stop(timeout=60)


def victim(scene, server, when):
    """Queries of a phone, one each 0.25 s, without retries."""
    if when == "quiet":
        header("", f"answered of {VICTIM}", "p50 ms", "slowest ms", "refused")
    times, refused = [], 0
    for _ in range(VICTIM):
        started = time.monotonic()
        status, _, _ = ask(server.port, LOCALIZE, scene.query, "phone", timeout=60)
        if status == 200:
            times.append((time.monotonic() - started) * 1e3)
        else:
            refused += 1
        time.sleep(0.25)
    times.sort()
    row(when, len(times), f"{times[len(times) // 2]:.0f}" if times else "-", f"{times[-1]:.0f}" if times else "-", refused)


def disconnected(scene, server):
    """Clients that disconnect at once, after a query and the start of a next request: is the query still computed?"""
    def done():
        text = ask(server.port, "/metrics", user="ops")[1].decode()
        return sum(float(line.split()[-1]) for line in text.splitlines() if line.startswith("veiloc_localizations_total"))

    wait_for(lambda: "veiloc_workers_busy 0" in ask(server.port, "/metrics", user="ops")[1].decode(), "idle workers")
    before = done()
    head = f"POST {LOCALIZE} HTTP/1.1\r\nhost: x\r\nauthorization: Bearer {token('phone')}\r\n" \
           f"content-type: {PROTOBUF}\r\ncontent-length: {len(scene.large)}\r\n\r\n"
    for _ in range(12):
        stream = socket.create_connection(("127.0.0.1", server.port))
        stream.sendall(head.encode() + scene.large + b"GET /healthz HTTP/1.1\r\nhost: x\r\n\r\n")
        stream.close()
    time.sleep(1)
    wait_for(lambda: "veiloc_workers_busy 0" in ask(server.port, "/metrics", user="ops")[1].decode(), "idle workers")
    header("queries of clients that disconnected", "computed")
    row(12, int(done() - before))


if __name__ == "__main__":
    main()
