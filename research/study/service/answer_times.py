#!/usr/bin/env python3
"""Measures whether the time of an answer shows if a query was localized (rule L12).

    VEILOC_DATA=../shared/data research/study/service/answer_times.py [--veiloc PROGRAM] [--csv docs/results/service/answer-times.csv]
        [--max-keypoints 1024 --json costs.json]

Queries of a place and as many images of another place are sent to the service, each several times in random order, one after
the other: with the camera as calibrated, and with an unknown focal length. Measured is the processor time of each answer, which
other programs disturb little; with a quantum it is rounded up to whole quanta, as the service does with the time since receipt.
`--json` writes the processor time of each query, the least of its rounds, for research/notes/scale_model.py --costs.
AUC: probability that an answer without a trusted pose comes later than one with a trusted pose; equal times count half.
"""

import csv
import http.client
import json
import math
import os
import pathlib
import random
import sys

from common import LOCALIZE, PROTOBUF, Program, Server, arguments, ask, first_words, wait_for

PLACES = {"redkitchen": "hololens-office", "herzjesu": "redkitchen"}
QUANTA = [0, 0.25, 0.5, 1]
COLUMNS = [
    "place", "focal length", "found", "not found", "found, median (ms)", "not found, median (ms)", "found, p99 (ms)",
    "not found, p99 (ms)", "AUC", *(f"AUC, quantum {quantum} s" for quantum in QUANTA[1:]),
]  # fmt: skip


class Place(Program):
    """The map of a place, its queries, and queries of another place."""

    def __init__(self, veiloc, data, name, other, images, keypoints):
        super().__init__(veiloc)
        own, away = data / name, data / other
        self.limit = ["--max-keypoints", keypoints] if keypoints else []
        self.map = self.work / "place.vmap"
        self.run("map", "build", "--posed", own / "posed", "--images", own / "images", "--list", own / "map.txt",
                 "-o", self.map)
        self.run("map", "profile", self.map, "-o", self.work / "profile")
        self.queries = {
            focal: [query for folder in (own, away) for query in self.seal(folder, images, focal)]
            for focal in ("calibrated", "unknown")
        }

    def seal(self, folder, images, focal):
        names = first_words(folder / "query.txt")
        names = [names[i * len(names) // min(images, len(names))] for i in range(min(images, len(names)))]
        lines = [line.split()[1:] for line in (folder / "posed" / "cameras.txt").read_text().splitlines()
                 if line and not line.startswith("#")]
        camera = ",".join(lines[0])
        sealed = []
        for name in names:
            out = self.work / "query.vquery"
            self.run("seal", folder / "images" / name, "--camera", camera, "--focal-known", focal, "--profile",
                     self.work / "profile", *self.limit, "-o", out)
            sealed.append(out.read_bytes())
            out.unlink()
        return sealed


def processor_ms(process):
    """Processor time of all threads so far."""
    tasks = pathlib.Path(f"/proc/{process}/task").iterdir()
    return sum(int((task / "schedstat").read_text().split()[0]) for task in tasks) / 1e6


def times(server, queries, rounds):
    """Whether each query was localized with trust, and the milliseconds of its answers."""
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=600)
    order = [i for i in range(len(queries)) for _ in range(rounds)]
    random.Random(1).shuffle(order)
    found, taken = {}, {i: [] for i in range(len(queries))}
    for i in order:
        before = processor_ms(server.process.pid)
        connection.request("POST", LOCALIZE, queries[i], {"content-type": PROTOBUF, "accept": "application/json"})
        found[i] = b'"trusted":true' in connection.getresponse().read().replace(b" ", b"")
        taken[i].append(processor_ms(server.process.pid) - before)
    connection.close()
    return found, taken


def auc(first, second):
    """Probability that a value of `second` is larger than one of `first`; equal values count half."""
    larger = sum((b > a) + 0.5 * (b == a) for a in first for b in second)
    return larger / (len(first) * len(second))


def quantile(values, share):
    return sorted(values)[min(len(values) - 1, int(share * len(values)))]


def main():
    parser = arguments(__doc__)
    parser.add_argument("--csv", type=pathlib.Path)
    parser.add_argument("--images", type=int, default=20, help="queries of each place")
    parser.add_argument("--rounds", type=int, default=5, help="answers to each query")
    parser.add_argument("--max-keypoints", type=int, help="keypoints of a query (default: as many as the profile wants)")
    parser.add_argument("--json", type=pathlib.Path, help="also write the processor time of each query there, milliseconds")
    parser.add_argument("--places", default=",".join(PLACES))
    args = parser.parse_args()
    if not os.environ.get("VEILOC_DATA"):
        sys.exit("set VEILOC_DATA to the folder of the real photographs")
    data = pathlib.Path(os.environ["VEILOC_DATA"]).resolve()
    rows, costs = [], {}
    for name in args.places.split(","):
        place = Place(args.veiloc, data, name, PLACES[name], args.images, args.max_keypoints)
        options = ["--answer-quantum", "0"] if "--answer-quantum" in place.options() else []
        server = Server(place, "--log", "error", *options)
        wait_for(lambda: ask(server.admin, "/readyz")[0] == 200, "readiness")
        for focal, queries in place.queries.items():
            found, taken = times(server, queries, args.rounds)
            yes = [ms for i, all_ms in taken.items() if found[i] for ms in all_ms]
            no = [ms for i, all_ms in taken.items() if not found[i] for ms in all_ms]
            for outcome in (True, False):
                least = [round(min(all_ms), 2) for i, all_ms in taken.items() if found[i] == outcome]
                costs[f"{name}, {focal}, {'found' if outcome else 'not found'}"] = sorted(least)
            whole = lambda values, quantum: [math.ceil(ms / 1e3 / quantum) if quantum else ms for ms in values]
            rows.append([
                name, focal, len(yes) // args.rounds, len(no) // args.rounds,
                *(f"{quantile(answers, q):.0f}" for q in (0.5, 0.99) for answers in (yes, no)),
                *(f"{auc(whole(yes, quantum), whole(no, quantum)):.2f}" for quantum in QUANTA),
            ])  # fmt: skip
            print(*rows[-1], sep="  ", flush=True)
        server.stop()
    if args.json:
        args.json.write_text(json.dumps(costs, indent=1))
    if args.csv:
        with args.csv.open("w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            writer.writerows(rows)


if __name__ == "__main__":
    main()
