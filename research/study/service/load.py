#!/usr/bin/env python3
"""Requests a second and times of answers of the service, by number of connections.

    cargo build --release -p veiloc-service --example load
    research/study/service/load.py --data $VEILOC_DATA --csv docs/results/service/load.csv [--veiloc PROGRAM]

The example `load` sends a `dcl` query of 1024 keypoints to RedKitchen's map: one worker a core, a queue of 32, and a fixed number of
requests for each row. Every connection sends its next query when the last one is answered. Client and service share the cores.
"""

import csv
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from common import RedKitchen, Server, arguments, ask, wait_for  # noqa: E402
from places import write_csv  # noqa: E402

COLUMNS = ["connections", "requests", "answered", "refused with 503", "other", "lost", "answers a second", "p50 (ms)", "p95 (ms)",
           "p99 (ms)", "slowest refusal (ms)"]  # fmt: skip


def main():
    parser = arguments(__doc__)
    parser.add_argument("--load", type=Path, help="the example `load` of veiloc-service (default: the release build of this repository)")
    parser.add_argument("--connections", default="1,4,16,64")
    parser.add_argument("--csv", type=Path)
    args = parser.parse_args()
    scene = RedKitchen(args.veiloc)
    load = args.load or scene.target / "release/examples/load"
    if not load.exists():
        sys.exit("build the client first: cargo build --release -p veiloc-service --example load")
    query = scene.work / "query"
    query.write_bytes(scene.query)
    server = Server(scene, "--queue", "32", "--log", "error")
    wait_for(lambda: ask(server.admin, "/readyz")[0] == 200, "readiness")
    command = [load, f"127.0.0.1:{server.port}", "place", query, *args.connections.split(",")]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    server.stop()
    print(printed, end="")
    write_csv(args.csv, COLUMNS, list(csv.reader(printed.splitlines()))[1:])


if __name__ == "__main__":
    main()
