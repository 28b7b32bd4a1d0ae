#!/usr/bin/env python3
"""Benchmarks the retrieval index of large maps against usearch (HNSW), on the same global descriptors and queries.

    pip install numpy usearch
    cargo build --release
    scripts/bench_search.py --map redkitchen.vmap --images redkitchen/images --query-list redkitchen/query.txt \
        --distractors training-photos --sizes 10000,100000,1000000 --csv search_index.csv

`veiloc eval retrieval --save` writes its descriptors and queries; usearch runs the same queries on one thread, in two ways: over the
descriptors (`i8`, cosine), and over their binary codes (`b1`, Hamming) with exact re-ranking of as many candidates as in veiloc's
index. `recall@10` is the share of the true 10 nearest (cosine over all descriptors) that is found.
"""

import argparse
import csv
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from usearch.index import Index, MetricKind, ScalarKind

WANTED = 10
CANDIDATES = 300  # candidates that veiloc's index re-ranks exactly


def unit(codes: np.ndarray) -> np.ndarray:
    """Rows normalized to length one, float32."""
    rows = codes.astype(np.float32)
    return rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-9)


def best(query: np.ndarray, searched: np.ndarray, among: np.ndarray) -> np.ndarray:
    """The 10 nearest of the given rows."""
    found = unit(searched[among]) @ query
    return among[np.argsort(-found, kind="stable")[:WANTED]]


def exact(queries: np.ndarray, searched: np.ndarray) -> list[set[int]]:
    """The true 10 nearest of each query."""
    parts = [unit(queries) @ unit(searched[at : at + 20000]).T for at in range(0, len(searched), 20000)]
    return [set(row) for row in np.argsort(-np.hstack(parts), axis=1, kind="stable")[:, :WANTED].tolist()]


def usearch(name: str, queries: np.ndarray, searched: np.ndarray, truth: list[set[int]], expansion: int) -> dict:
    """One row of the table."""
    binary = name.endswith("signs")
    options = dict(metric=MetricKind.Hamming, dtype=ScalarKind.B1) if binary else dict(metric=MetricKind.Cos, dtype=ScalarKind.I8)
    index = Index(ndim=searched.shape[1], expansion_search=expansion, **options)
    code = (lambda rows: np.packbits(rows > 0, axis=1)) if binary else (lambda rows: rows)
    started = time.perf_counter()
    for at in range(0, len(searched), 50000):
        part = searched[at : at + 50000]
        index.add(np.arange(at, at + len(part)), code(part))
    ready = time.perf_counter() - started
    coded, units, found, times = code(queries), unit(queries), [], []
    for row, query in zip(coded, units):
        started = time.perf_counter()
        keys = index.search(row, CANDIDATES if binary else WANTED, threads=1).keys.astype(np.int64)
        keys = best(query, searched, keys) if binary else keys
        times.append(1e3 * (time.perf_counter() - started))
        found.append(len(truth[len(found)] & set(keys.tolist())))
    beside = index.memory_usage - (0 if binary else searched.nbytes)
    return dict(images=len(searched), search=f"{name}, expansion {expansion}", ready_s=ready, mb_beside=beside / 1e6,
                median_ms=float(np.median(times)), recall_at_10=sum(found) / (WANTED * len(truth)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--veiloc", default="target/release/veiloc")
    parser.add_argument("--map", required=True)
    parser.add_argument("--images", required=True)
    parser.add_argument("--query-list")
    parser.add_argument("--distractors")
    parser.add_argument("--sizes", default="10000,100000")
    parser.add_argument("--usearch-up-to", type=int, default=1_000_000, help="run usearch only up to this size")
    parser.add_argument("--csv", help="also write the table to this file")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        command = [args.veiloc, "eval", "retrieval", "--map", args.map, "--images", args.images, "--sizes", args.sizes,
                   "--save", folder, "--json"]
        command += ["--query-list", args.query_list] if args.query_list else []
        command += ["--distractors", args.distractors] if args.distractors else []
        document = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
        everything = np.load(Path(folder) / "searched.npy", mmap_mode="r")
        queries = np.load(Path(folder) / "queries.npy")
        rows = []
        for row in document["rows"]:
            codes = row["images"] * everything.shape[1]
            rows.append(dict(images=row["images"], search=f"veiloc, {row['search']}", ready_s=row["build_seconds"],
                             mb_beside=(row["bytes"] - codes) / 1e6, median_ms=row["median_ms"], recall_at_10=row["recall"]))
        for size in sorted({row["images"] for row in rows}):
            if size > args.usearch_up_to:
                continue
            searched = np.array(everything[:size])
            truth = exact(queries, searched)
            for name in ("usearch, signs", "usearch, codes"):
                for expansion in (64, 512):
                    rows.append(usearch(name, queries, searched, truth, expansion))
                    print(rows[-1], file=sys.stderr)
    rows.sort(key=lambda row: row["images"])
    print(f"{'images':>9} {'search':<31} {'ready s':>9} {'MB beside':>10} {'median ms':>10} {'recall@10':>10}")
    for row in rows:
        print(f"{row['images']:>9} {row['search']:<31} {row['ready_s']:>9.2f} {row['mb_beside']:>10.1f} "
              f"{row['median_ms']:>10.3f} {100 * row['recall_at_10']:>9.1f}%")
    if args.csv:
        with open(args.csv, "w", newline="") as file:
            writer = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
