#!/usr/bin/env python3
"""One token at two gateways: how many answers a second it gets from both together.

    VEILOC_DATA=../shared/data research/study/cluster/shared_rates.py [--veiloc PROGRAM[,PROGRAM]] [--names NAME,NAME] [--csv FILE]
    research/study/cluster/shared_rates.py --rendered --seconds 5     # without data: a rendered room

Two gateways with `--rate 5` and `--rate-fail closed` where the program has it, one worker. A client sends to both as fast as they
answer, or to one of them, for --seconds each; the first seconds, in which bursts are used and paid back, are not counted. Then one
gateway is killed and the client sends to the other. Requests are answered with the list of maps, which costs the same rate as a query
and no localization. Runs against any build, to compare versions; a build without shared rates gives twice as much. With --check it
fails when two gateways give more or less than 5 ± 10 % together.
"""

import csv
import pathlib
import sys
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

from machines import Cluster, arguments, header, load_scene, row  # noqa: E402
from common import token  # noqa: E402

RATE = 5
# Two bursts of five are paid back in a second.
SETTLE = 3.0
COLUMNS = ["program", "requests go to", "answers a second", "refused with 429 a second"]


def flood(ports, seconds):
    """Requests to all ports at the same time, each as fast as it answers; returns answers and refusals a second."""
    import http.client

    counts, stop = {}, time.monotonic() + SETTLE + seconds
    counted_from, lock = time.monotonic() + SETTLE, threading.Lock()

    def client(port):
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
        while time.monotonic() < stop:
            connection.request("GET", "/v1/maps", headers={"authorization": f"Bearer {token('phone')}"})
            response = connection.getresponse()
            response.read()
            if time.monotonic() >= counted_from:
                with lock:
                    counts[response.status] = counts.get(response.status, 0) + 1
            # Enough to use every place that becomes free.
            time.sleep(0.01)
        connection.close()

    threads = [threading.Thread(target=client, args=(port,)) for port in ports]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    unexpected = set(counts) - {200, 429}
    if unexpected:
        sys.exit(f"unexpected answers: {unexpected}")
    return counts.get(200, 0) / seconds, counts.get(429, 0) / seconds


def main():
    parser = arguments(__doc__)
    parser.add_argument("--rendered", action="store_true", help="a rendered room, which needs no data")
    parser.add_argument("--names", help="names of the programs, separated by commas")
    parser.add_argument("--seconds", type=float, default=30.0, help="seconds of each measurement")
    parser.add_argument("--csv", type=pathlib.Path, help="also write the table there")
    parser.add_argument("--check", action="store_true", help="fail when the rate does not hold over both gateways")
    args = parser.parse_args()
    programs = str(args.veiloc).split(",") if args.veiloc else [None]
    names = args.names.split(",") if args.names else ["now"] * len(programs)
    rows, holds = [], True
    header(*COLUMNS)
    for program, name in zip(programs, names, strict=True):
        args.veiloc = program
        scene = load_scene(args)
        more = ["--tokens", scene.tokens(["phone"]), "--burst", RATE]
        if "--rate-fail" in scene.options():
            more += ["--rate-fail", "closed"]
        cluster = Cluster(scene, scene.map, workers=1, images=scene.images, nats=2, gateway=False)
        try:
            first, second = (cluster.serve(more, name=f"gateway-{i}", rate=RATE) for i in range(2))

            def measure(what, ports):
                answered, refused = flood(ports, args.seconds)
                rows.append([name, what, f"{answered:.2f}", f"{refused:.0f}"])
                row(*rows[-1])
                return answered

            both = measure("both gateways", [first.port, second.port])
            one = measure("one of two", [first.port])
            second.kill()
            # Until it is silent.
            time.sleep(5)
            measure("one, the other was killed", [first.port])
            holds = holds and all(0.9 * RATE <= rate <= 1.1 * RATE for rate in (both, one))
        finally:
            cluster.stop()
    if args.csv:
        with args.csv.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])
    sys.exit(args.check and not holds)


if __name__ == "__main__":
    main()
