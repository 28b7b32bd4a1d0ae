#!/usr/bin/env python3
"""Graceful shutdown by SIGTERM, as from an orchestrator: status of `/readyz`, answered queries, duration and exit code.

    VEILOC_DATA=../shared/data scripts/service/drain.py [--veiloc PROGRAM]
"""

import shutil
import signal
import socket
import threading
import time

from common import LOCALIZE, Ended, RedKitchen, Server, arguments, ask, header, row


def ended(server, started, timeout=60):
    code = server.stop(how=0, timeout=timeout)
    return ("killed" if code is None else f"exit {code}"), f"{time.monotonic() - started:.1f}"


def main():
    scene = RedKitchen(arguments(__doc__).parse_args().veiloc)
    header("", "`/readyz` after SIGTERM", "queries sent after it", "answered", "end", "after s")

    server = Server(scene)
    seen, sent, got = set(), 0, 0
    started = time.monotonic()
    server.process.send_signal(signal.SIGTERM)
    while time.monotonic() - started < 1.5:
        status = ask(server.port, "/readyz", timeout=2)[0]
        seen.add(str(status or "no answer"))
        status = ask(server.port, LOCALIZE, scene.query, timeout=10)[0]
        sent, got = sent + 1, got + (status == 200)
        time.sleep(0.1)
    row("plain", " ".join(sorted(seen)), sent, got, *ended(server, started))

    grace = ["--grace", "0.2"] + (["--drain-delay", "0"] if "--drain-delay" in scene.options() else [])
    server = Server(scene, *grace)
    idle = socket.create_connection(("127.0.0.1", server.port))
    time.sleep(0.5)
    started = time.monotonic()
    server.process.send_signal(signal.SIGTERM)
    row("`--grace 0.2`, one idle connection", "-", "-", "-", *ended(server, started))
    idle.close()

    server = Server(scene, "--workers", "1", "--grace", "60")
    jobs = [threading.Thread(target=ask, args=(server.port, LOCALIZE, scene.large), kwargs={"timeout": 90}, daemon=True)
            for _ in range(30)]
    for job in jobs:
        job.start()
    time.sleep(0.5)
    started = time.monotonic()
    server.process.send_signal(signal.SIGTERM)
    time.sleep(0.3)
    server.process.send_signal(signal.SIGTERM)
    row("30 large queries accepted, a second SIGTERM after 0.3 s", "-", "-", "-", *ended(server, started))

    print()
    header("one broken map and one good map", "queries to the good map", "to the broken map")
    broken = scene.work / "broken.vmap"
    broken.write_bytes(scene.map.read_bytes()[:1000])
    try:
        server = Server(scene, maps=["--map", f"place={scene.map}", "--map", f"broken={broken}"])
        good = ask(server.port, LOCALIZE, scene.query)[0]
        bad = ask(server.port, LOCALIZE.replace("place", "broken"), scene.query)[0]
        shutil.copyfile(scene.map, broken)
        time.sleep(4)
        row("starts", good, f"{bad}, {ask(server.port, LOCALIZE.replace('place', 'broken'), scene.query)[0]} after repair")
        server.stop()
    except Ended as end:
        row(f"exit {end.args[0]}", "-", "-")


if __name__ == "__main__":
    main()
