#!/usr/bin/env python3
"""Workers that join, leave and die under load: regions that move, against the least possible, and queries that are lost.

    VEILOC_DATA=../shared/data research/study/cluster/placement.py [--veiloc PROGRAM] [--seconds 12] [--csv FILE]
    research/study/cluster/placement.py --rendered --seconds 8       # without data: a rendered room

The map is cut into small regions, and workers run with `--replicas 2 --settle 3`. Three workers run; then, with clients that send
queries all the time, a fourth and a fifth join, one leaves (SIGTERM), one is killed, one is killed and started again at once, and two
join at the same time. After each step it waits until every region has two copies again.

*Moved* is the number of regions that workers loaded (`veiloc_object_loads_total`, without indexes), beside what any placement must
load to get two copies of each region again: the copies that were lost; for workers that join, their mean share, rounded down.
Fails when an accepted query is lost, a region does not get two copies, or more than half as many regions again move.
"""

import csv
import pathlib
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

from machines import Clients, Cluster, arguments, ask, counter, header, load_scene, row, wait_for  # noqa: E402

COPIES = 2
COLUMNS = ["step", "workers", "regions", "moved", "lost copies, or mean share of who joins", "two copies again after (s)", "queries", "lost"]


class PlacedCluster(Cluster):
    """A cluster whose workers divide the regions among them."""

    def worker(self, i, wait=True):
        part = super().worker(i, ["--replicas", COPIES, "--settle", 3, "--name", f"worker-{i}", "--drain-after", 1], wait)
        part.loaded_before = 0
        return part


def values(worker):
    text = ask(worker.admin, "/metrics")[1].decode()
    # The index is one of the objects of each worker.
    return counter(text, "veiloc_object_loads_total") - 1, counter(text, "veiloc_objects_loaded") - 1


def main():
    parser = arguments(__doc__)
    parser.add_argument("--rendered", action="store_true", help="a rendered room, which needs no data")
    parser.add_argument("--seconds", type=float, default=12.0, help="least seconds of each step")
    parser.add_argument("--images", type=int, default=4, help="images of a region")
    parser.add_argument("--csv", type=pathlib.Path, help="also write the table there")
    args = parser.parse_args()
    scene = load_scene(args)
    cluster = PlacedCluster(scene, scene.map, workers=3, images=args.images, nats=2)
    regions, rows, failed = cluster.regions, [], []

    def held():
        return [int(values(worker)[1]) for worker in cluster.workers]

    def is_settled():
        # Two copies of each: no worker holds more than what is placed on it, and the gateway sees two of the rarest.
        text = ask(cluster.admin, "/metrics")[1].decode()
        wanted = min(COPIES, len(cluster.workers))
        return counter(text, "veiloc_cluster_copies", 'map="place"') >= wanted and sum(held()) == wanted * regions

    def step(name, act, least):
        loads = {worker.name: values(worker)[0] for worker in cluster.workers}
        lost_before, begin = clients.lost, time.monotonic()
        must = act()
        wait_for(is_settled, "two copies of each region")
        settled = time.monotonic() - begin
        time.sleep(max(0.0, args.seconds - settled))
        # A worker that was started again counts from zero.
        moved = sum(int(values(worker)[0] - (0 if worker.name in must else loads.get(worker.name, 0))) for worker in cluster.workers)
        times = clients.between(begin, time.monotonic())
        least = least()
        rows.append([name, len(cluster.workers), regions, moved, least, f"{settled:.1f}", len(times), clients.lost - lost_before])
        row(*rows[-1])
        if moved > least * 1.5 + 1:
            failed.append(name)

    def join(*numbers):
        parts = [cluster.worker(number, wait=False) for number in numbers]
        for part in parts:
            part.wait()
        cluster.workers += parts
        return [part.name for part in parts]

    def leave(kill=False):
        worker = cluster.workers.pop(0)
        gone.append(int(values(worker)[1]))
        worker.kill() if kill else worker.stop()
        return []

    def restart():
        worker = cluster.workers[0]
        gone.append(int(values(worker)[1]))
        worker.kill()
        worker.start()
        return [worker.name]

    gone, clients = [], None
    try:
        wait_for(is_settled, "two copies of each region")
        header(*COLUMNS)
        clients = Clients(cluster.port, scene.queries, count=3, rate=9)
        share = lambda joined: lambda: joined * (COPIES * regions // len(cluster.workers))
        step("a worker joins", lambda: join(3), share(1))
        step("another one joins", lambda: join(4), share(1))
        step("a worker leaves (SIGTERM)", leave, lambda: gone[-1])
        step("a worker is killed", lambda: leave(kill=True), lambda: gone[-1])
        step("a worker is killed and started again", restart, lambda: gone[-1])
        step("two workers join", lambda: join(5, 6), share(2))
    finally:
        if clients:
            clients.stop()
        cluster.stop()
    print(f"\naccepted {clients.accepted}, lost {clients.lost}, sent again {clients.retried}")
    for name in failed:
        print(f"more regions moved than needed: {name}")
    if args.csv:
        with args.csv.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])
    sys.exit(clients.lost > 0 or bool(failed))


if __name__ == "__main__":
    main()
