#!/usr/bin/env python3
"""Compares a map build with Ray and in a single process on one machine: seconds of each stage, and equal maps.

    pip install ./bindings/python ray
    research/study/ray_times.py --data $VEILOC_DATA --rounds 3 --csv docs/results/scale/build.csv

Both use all processors: the single process with threads, Ray with processes of one thread each. Ray starts once, before the timing;
its work folder is empty in each round. Prints the fastest of --rounds alternating rounds. Fails when the maps differ.
"""

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

import ray

import veiloc
import veiloc.ray

from places import write_csv

# Stages of the table, as both name them.
ALONE = ["Extracting features", "Matching first pairs", "Matching pairs", "Testing the map"]
MANY = ["features", "first-pairs", "pairs", "self-test"]


def alone(posed, images, names, out):
    stages, began = {}, time.monotonic()
    last = [began, None]

    def record(stage, done, total):
        now = time.monotonic()
        if stage != last[1]:
            if last[1] is not None:
                stages[last[1]] = now - last[0]
            last[:] = [now, stage]

    veiloc.Map.build(posed, images, names=names, progress=record).save(out)
    stages[last[1]] = time.monotonic() - last[0]
    return time.monotonic() - began, stages


def many(posed, images, names, out, shares):
    with tempfile.TemporaryDirectory() as work:
        began = time.monotonic()
        built = veiloc.ray.build_map(posed, images, out, names=names, work=work, shares=shares)
        return time.monotonic() - began, built.seconds


def row(name, total, stages, names):
    """Seconds of a build: the whole, features, first pairs, pairs, the rest, the self-test."""
    known = [stages[stage] for stage in names]
    *parts, self_test = known
    return [name, *(f"{seconds:.1f}" for seconds in (total, *parts, total - sum(known), self_test))]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--place", default="redkitchen", help="folder of the data")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--shares", type=int, help="tasks per stage (default: four for each processor)")
    parser.add_argument("--csv", type=Path)
    args = parser.parse_args()
    place = args.data / args.place
    posed, images = str(place / "posed"), str(place / "images")
    names = [line.strip() for line in (place / "map.txt").read_text().splitlines() if line.strip()]
    ray.init(log_to_driver=False, include_dashboard=False)
    with tempfile.TemporaryDirectory() as folder:
        one, other = Path(folder, "alone.vmap"), Path(folder, "many.vmap")
        rounds = []
        for _ in range(args.rounds):
            rounds.append((alone(posed, images, names, one), many(posed, images, names, other, args.shares)))
            if one.read_bytes() != other.read_bytes():
                sys.exit("the maps differ")
        count = len(veiloc.Map.open(one))
    (single, single_stages), (spread, spread_stages) = (min(side, key=lambda build: build[0]) for side in zip(*rounds))
    print(f"{count} images, {os.cpu_count()} processors, byte-identical maps in {args.rounds} rounds")
    rows = [row("one process", single, single_stages, ALONE), row("Ray", spread, spread_stages, MANY)]
    for cells in rows:
        print(*cells, sep="  ")
    columns = ["build", "total (s)", "features (s)", "first pairs (s)", "pairs (s)", "triangulation and the rest (s)", "self-test (s)"]
    write_csv(args.csv, columns, rows)


if __name__ == "__main__":
    main()
