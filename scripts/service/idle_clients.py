#!/usr/bin/env python3
"""1024 unauthenticated connections request `/healthz` every three seconds: are clients with a token still answered?

    VEILOC_DATA=../shared/data scripts/service/idle_clients.py [--veiloc PROGRAM]
"""

import resource
import selectors
import socket
import threading
import time

from common import LOCALIZE, Ended, RedKitchen, Server, arguments, ask, header, row

UNKNOWN_CLIENTS = 1024
REQUEST = b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n"


def idle(port, stop, counts):
    """Holds connections open by a request before the idle timeout; reopens closed ones."""
    selector = selectors.DefaultSelector()

    def new():
        try:
            stream = socket.create_connection(("127.0.0.1", port), timeout=1)
            stream.sendall(REQUEST)
            stream.setblocking(False)
            selector.register(stream, selectors.EVENT_READ, time.monotonic())
        except OSError:
            return

    while not stop.is_set():
        for _ in range(min(50, UNKNOWN_CLIENTS - len(selector.get_map()))):
            new()
        for key, _ in selector.select(timeout=0.05):
            try:
                gone = not key.fileobj.recv(65536)
            except OSError:
                gone = True
            if gone:
                selector.unregister(key.fileobj)
                key.fileobj.close()
                counts["closed"] += 1
        now = time.monotonic()
        for key in list(selector.get_map().values()):
            if now - key.data > 3.0:
                try:
                    key.fileobj.send(REQUEST)
                except OSError:
                    pass
                selector.modify(key.fileobj, selectors.EVENT_READ, now)
        counts["open"] = len(selector.get_map())


def main():
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(8192, hard), hard))
    scene = RedKitchen(arguments(__doc__).parse_args().veiloc)
    server = Server(scene, "--tokens", scene.tokens(["phone", "ops!"]))
    stop, counts = threading.Event(), {"open": 0, "closed": 0}
    threading.Thread(target=idle, args=(server.port, stop, counts), daemon=True).start()
    time.sleep(8)
    answered, times = 0, []
    for _ in range(20):
        started = time.monotonic()
        status, _, _ = ask(server.port, LOCALIZE, scene.query, "phone", timeout=5)
        if status == 200:
            answered += 1
            times.append(time.monotonic() - started)
        time.sleep(0.1)
    probe = ask(server.admin or server.port, "/healthz", timeout=5)[0] or "none"
    header("open connections of idle clients", "evicted", "answered queries with a token, of 20", "slowest s", "probe")
    row(counts["open"], counts["closed"], answered, f"{max(times):.2f}" if times else "-", probe)
    stop.set()
    server.stop(timeout=40)
    print()
    # The limit of open files is below the number of connections.
    try:
        server = Server(scene, "--connections", "1024", nofile=600)
        outcome = "it starts, but cannot open this many connections"
        server.stop()
    except Ended as ended:
        outcome = f"exit {ended.args[0]}: " + " ".join(ended.args[1].split())[:150]
    header("`--connections 1024` with `ulimit -n 600`")
    row(outcome)


if __name__ == "__main__":
    main()
