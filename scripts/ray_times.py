#!/usr/bin/env python3
"""What handing a build to Ray costs and saves on one machine: seconds of each stage beside a single process, and equal maps.

    pip install ./bindings/python ray
    scripts/ray_times.py $VEILOC_DATA/redkitchen/posed $VEILOC_DATA/redkitchen/images --list $VEILOC_DATA/redkitchen/map.txt

Both have all processors: the single process as threads, Ray as processes of one thread each. Ray is started before the clock, once
for all rounds; its work folder is empty each time. Of --rounds, in turns, the fastest of each is printed. Fails when the maps differ.
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


def alone(posed, images, names, out):
    stages, began = {}, time.monotonic()
    last = [began, None]

    def told(stage, done, total):
        now = time.monotonic()
        if stage != last[1]:
            if last[1] is not None:
                stages[last[1]] = now - last[0]
            last[:] = [now, stage]

    veiloc.Map.build(posed, images, names=names, progress=told).save(out)
    stages[last[1]] = time.monotonic() - last[0]
    return time.monotonic() - began, stages


def many(posed, images, names, out, shares):
    with tempfile.TemporaryDirectory() as work:
        began = time.monotonic()
        built = veiloc.ray.build_map(posed, images, out, names=names, work=work, shares=shares)
        return time.monotonic() - began, built.seconds


def words(stages):
    return ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in stages.items())


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("posed", help="folder of a COLMAP model")
    parser.add_argument("images", help="folder of its images")
    parser.add_argument("--list", help="names of the images to use, one a line (default: all of the model)")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--shares", type=int, help="parts of each stage (default: four times as many as processors)")
    given = parser.parse_args()
    names = [line.strip() for line in Path(given.list).read_text().splitlines() if line.strip()] if given.list else None
    ray.init(log_to_driver=False, include_dashboard=False)
    with tempfile.TemporaryDirectory() as folder:
        one, other = Path(folder, "alone.vmap"), Path(folder, "many.vmap")
        rounds = []
        for _ in range(given.rounds):
            rounds.append((alone(given.posed, given.images, names, one), many(given.posed, given.images, names, other, given.shares)))
            if one.read_bytes() != other.read_bytes():
                sys.exit("the maps differ")
        images = len(veiloc.Map.open(one))
    (single, single_stages), (spread, spread_stages) = (min(side) for side in zip(*rounds))
    print(f"{images} images, {os.cpu_count()} processors, maps equal to the byte in {given.rounds} rounds")
    print("| | s | stages, s |\n|---|--:|---|")
    print(f"| one process | {single:.1f} | {words(single_stages)} |")
    print(f"| Ray | {spread:.1f} ({spread / single:.2f} times) | {words(spread_stages)} |")


if __name__ == "__main__":
    main()
