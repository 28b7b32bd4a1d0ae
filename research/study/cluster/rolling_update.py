#!/usr/bin/env python3
"""A cluster whose machines are replaced by another release, one by one, under load; and back.

    VEILOC_DATA=../shared/data research/study/cluster/rolling_update.py OLD NEW [--csv FILE]
    research/study/cluster/rolling_update.py OLD NEW --rendered --seconds 3      # without data: a rendered room

OLD and NEW are two builds of the program. Three workers that hold all regions and one gateway run OLD, and clients send queries all
the time. First workers, then the gateway are replaced by NEW: SIGTERM, and the new program when the old one has ended, with --seconds
between two of them. Then the gateway returns to OLD, and two workers after it, and the gateway is updated again. So every pair of
releases is used both ways. The gateway is a single one, so clients send queries again while it is away. Prints the queries of each step; fails when an accepted query is lost, or equal queries get different poses. Loopback only.
"""

import csv
import pathlib
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

from machines import Clients, Cluster, arguments, header, load_scene, row  # noqa: E402

COLUMNS = ["step", "workers", "gateway", "queries"]


def main():
    parser = arguments(__doc__)
    parser.add_argument("old", type=pathlib.Path)
    parser.add_argument("new", type=pathlib.Path)
    parser.add_argument("--rendered", action="store_true", help="a rendered room, which needs no data")
    parser.add_argument("--seconds", type=float, default=8.0, help="seconds of each step")
    parser.add_argument("--csv", type=pathlib.Path, help="also write the table there")
    args = parser.parse_args()
    programs = {"old": args.old.resolve(), "new": args.new.resolve()}
    args.veiloc = programs["old"]
    scene = load_scene(args)
    cluster = Cluster(scene, scene.map, workers=3, images=scene.images, nats=2)
    clients, rows = None, []
    runs = {part.name: "old" for part in [*cluster.workers, cluster.gateway]}

    def count():
        return ", ".join(f"{sum(runs[worker.name] == which for worker in cluster.workers)} {which}" for which in programs)

    def step(name, part=None, which=None):
        begin = time.monotonic()
        if part:
            code = part.stop()
            if code != 0:
                sys.exit(f"{part.name} ended with {code}: {part.log}")
            part.command[0] = str(programs[which])
            part.start()
            runs[part.name] = which
        time.sleep(args.seconds)
        times = clients.between(begin, time.monotonic())
        rows.append([name, count(), runs["gateway"], len(times)])
        row(*rows[-1])

    try:
        header(*COLUMNS)
        clients = Clients(cluster.port, scene.queries, count=3, rate=12)
        step("before")
        for worker in cluster.workers:
            step(f"{worker.name} is updated", worker, "new")
        step("the gateway is updated", cluster.gateway, "new")
        step("the gateway returns", cluster.gateway, "old")
        for worker in cluster.workers[:2]:
            step(f"{worker.name} returns", worker, "old")
        step("the gateway is updated first", cluster.gateway, "new")
    finally:
        if clients:
            clients.stop()
        cluster.stop()
    different = sum(len(poses) > 1 for poses in clients.poses.values())
    print(f"\naccepted {clients.accepted}, lost {clients.lost}, sent again {clients.retried}, "
          f"queries with different poses {different}")
    if args.csv:
        with args.csv.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])
    sys.exit(clients.lost > 0 or different > 0)


if __name__ == "__main__":
    main()
