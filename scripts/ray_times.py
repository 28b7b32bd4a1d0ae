#!/usr/bin/env python3
"""Compares a map build with Ray and in a single process on one machine: seconds of each stage, and equal maps.

    pip install ./bindings/python ray
    scripts/ray_times.py $VEILOC_DATA/redkitchen/posed $VEILOC_DATA/redkitchen/images --list $VEILOC_DATA/redkitchen/map.txt

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


def stage_list(stages):
    return ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in stages.items())


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("posed", help="folder of a COLMAP model")
    parser.add_argument("images", help="folder of its images")
    parser.add_argument("--list", help="file with the names of the images to use, one on each line (default: all images of the model)")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--shares", type=int, help="tasks per stage (default: four for each processor)")
    args = parser.parse_args()
    names = [line.strip() for line in Path(args.list).read_text().splitlines() if line.strip()] if args.list else None
    ray.init(log_to_driver=False, include_dashboard=False)
    with tempfile.TemporaryDirectory() as folder:
        one, other = Path(folder, "alone.vmap"), Path(folder, "many.vmap")
        rounds = []
        for _ in range(args.rounds):
            rounds.append((alone(args.posed, args.images, names, one), many(args.posed, args.images, names, other, args.shares)))
            if one.read_bytes() != other.read_bytes():
                sys.exit("the maps differ")
        images = len(veiloc.Map.open(one))
    (single, single_stages), (spread, spread_stages) = (min(side) for side in zip(*rounds))
    print(f"{images} images, {os.cpu_count()} processors, byte-identical maps in {args.rounds} rounds")
    print("| | s | stages, s |\n|---|--:|---|")
    print(f"| one process | {single:.1f} | {stage_list(single_stages)} |")
    print(f"| Ray | {spread:.1f} ({spread / single:.2f} times) | {stage_list(spread_stages)} |")


if __name__ == "__main__":
    main()
